r"""A model in ONNX, with numpy and onnxruntime alone."""

import hashlib
import json
import os
import re
import warnings
from collections.abc import Mapping
from time import perf_counter_ns
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._column_order import in_column_order
from torch_geometric_tactile.data._contact_windows import ContactWindow
from torch_geometric_tactile.data._ring import Ring
from torch_geometric_tactile.data.contact_rule import ContactRule
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.live._frame_gate import frame_info

_KEY = "torch_geometric_tactile"
_FORMAT = 1
_DIGEST = re.compile(rb'"sha256": "([0-9a-f]{64})"')


class OnnxModel:
    r"""Runs a predictor that ``tactile export`` wrote as an ONNX file. It needs numpy and
    onnxruntime, and computes in one thread.

    Args:
        path (str or PathLike): The file.

    Attributes:
        info (dict): What the file says of itself: :obj:`"class_names"`, :obj:`"task"`,
            :obj:`"num_taxels"`, :obj:`"num_channels"`, :obj:`"num_joints"`, :obj:`"window"`,
            :obj:`"rest"` and more. :obj:`"quantization"` says how the answers of a file with
            weights of eight bits differ from those in single precision.
        frame_info (FrameInfo): How the frames of the training were made.
        contact (ContactRule, optional): What tells frames without contact, as of
            :class:`~torch_geometric_tactile.Predictor`; that of the file, and can be set.
        lacks_contact (bool): Whether the last frame or window lacks contact: its answer is NaN.
        inputs (dict): The shape of each input of the graph by name; :obj:`outputs` likewise.
        prepare_ns (int): How long preparing the last answer took in nanoseconds.
        model_ns (int): How long computing the last answer took.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If onnxruntime is missing.
        ValueError: If the file is no such model, or one of a later version.

    Examples:
        >>> model = OnnxModel("slip.onnx")  # doctest: +SKIP
        >>> model.info["class_names"]  # doctest: +SKIP
        ['stable', 'slip']
    """

    def __init__(self, path: PathLike) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ImportError(
                "a model in ONNX needs onnxruntime: pip install 'torch-geometric-tactile[export]'"
            ) from error
        if not os.path.isfile(path):
            raise FileNotFoundError(f"there is no model '{os.fspath(path)}'")
        content = _checked(path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of several classes that the runtime does not name
            raise ValueError(f"'{os.fspath(path)}' is not a model in ONNX ({error})") from error
        entries = self._session.get_modelmeta().custom_metadata_map
        self.info = _read_info(entries, os.fspath(path))
        self.inputs = {node.name: node.shape for node in self._session.get_inputs()}
        self.outputs = {node.name: node.shape for node in self._session.get_outputs()}
        self.frame_info = frame_info(self.info)
        self.contact = _contact_rule(self.info)
        self.lacks_contact = False
        window = self.info["window"]
        self._length = 1 if window is None else int(window["length"])
        states = [name for name in self.inputs if name.startswith("state_")]
        self._states = {name: np.zeros(self.inputs[name], np.float32) for name in states}
        self._is_windowed = self._length > 1 and not states
        self._outputs = ["probability", *(f"next_{name}" for name in states)]
        self._rest: dict[str, np.ndarray] = {}
        self._contacts = ContactWindow(self._length)
        num_taxels = self.info["num_taxels"]
        self._frames, self._joints = (
            Ring(np.zeros((2 * self._length, *size), np.float32))
            for size in ((num_taxels, self.info["num_channels"]), (self.info["num_joints"],))
        )
        self.prepare_ns = self.model_ns = 0

    @property
    def length(self) -> int:
        r"""Number of frames of a window, one for a model of single frames."""
        return self._length

    @property
    def is_quantized(self) -> bool:
        r"""Whether large linear maps have weights of eight bits."""
        return self.info.get("quantization") is not None

    def __repr__(self) -> str:
        info = self.info
        facts = f"'{info['layout']}', classes={info['class_names']}, task='{info['task']}'"
        if self.is_quantized:
            found = info["quantization"]
            labels = found["equal_labels"]
            same = "" if labels is None else f"{100 * labels:.2f} % same labels, "
            facts += (
                f", weights of 8 bits: {same}largest change {found['largest_change']:.2g} on "
                f"{found['num_answers']} "
                f"{'frames of recordings' if found['frames'] == 'recordings' else 'random frames'}"
            )
        return f"{type(self).__name__}({info['model']}, {facts})"

    @property
    def needs_rest(self) -> bool:
        r"""Whether the session must be measured first, and was not."""
        return self.info["rest"] is not None and not self._rest

    def reset(self) -> None:
        r"""Forgets all frames, not the rest."""
        self._frames.count = self._joints.count = 0
        for name, state in self._states.items():
            self._states[name] = np.zeros_like(state)

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""Measures the session by some frames at rest, for the model and for :attr:`contact`.

        Args:
            frames (numpy.ndarray): The frames :math:`(T, N, C)`.
            time (numpy.ndarray): Their times in seconds :math:`(T,)`.
            joint (numpy.ndarray, optional): Joint angles :math:`(T, J)`.

        Raises:
            ValueError: If there are fewer frames than in a window, where these are measured, or as
                :meth:`ContactRule.measured <torch_geometric_tactile.data.ContactRule>`.
        """
        if self.contact is not None:
            self.contact = self.contact.measured(frames)
        rule = self.info["rest"]
        if rule is None:
            return
        index = self.frame_info.selected_frames(time, len(frames))
        frames, time = frames[index], time[index]
        joint = None if joint is None else joint[index]
        length = self.length if rule["of_windows"] else 1
        if len(frames) < length:
            raise ValueError(
                f"a rest must have at least {length} frames, those of a window (got {len(frames)})"
            )
        hop = (self.info["window"]["hop"] or len(frames)) if rule["of_windows"] else 1
        if rule["from_output"]:
            samples = self._before_rest(frames, joint, length, hop)
        else:
            windows = np.lib.stride_tricks.sliding_window_view(frames, length, axis=0)[::hop]
            samples = windows.reshape(*windows.shape[:2], -1)
        self._set_session(*_session_statistics(samples, rule, length))

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""Sets what was measured of the session.

        Args:
            center (numpy.ndarray): Readings at rest :math:`(N, C)`.
            scale (numpy.ndarray, optional): What they are divided by, if the model scales sessions.

        Raises:
            ValueError: If it has another shape, or the scale is missing.
        """
        if self.contact is not None and center.shape[-1:] == (self.info["num_channels"],):
            self.contact = self.contact.with_rest(center)
        self._set_session(center, scale)

    def _set_session(self, center: np.ndarray, scale: np.ndarray | None) -> None:
        rule = self.info["rest"]
        if rule is None:
            return
        shape = tuple(rule["shape"])
        for name, value in (("rest", center), ("scale", scale)):
            if value is not None and value.shape != shape:
                raise ValueError(f"'{name}' must have shape {shape} (got {value.shape})")
        self._rest = {"rest": np.ascontiguousarray(center, np.float64)}
        if rule["has_scale"]:
            if scale is None:
                raise ValueError("'scale' must be given: the model scales each session (got None)")
            self._rest["rest_scale"] = np.ascontiguousarray(scale, np.float32)

    def add(self, tactile: np.ndarray, joint: np.ndarray | None, wanted: bool = True) -> Any:
        r"""Takes the next frame, and returns the probabilities :math:`(K,)`, or :obj:`None` if
        there are not enough frames yet. They are NaN without contact, if :attr:`contact` is set.

        Args:
            tactile (numpy.ndarray): Its readings :math:`(N, C)`.
            joint (numpy.ndarray, optional): Its joint angles :math:`(J,)`.
            wanted (bool): Whether an answer is wanted; a recurrent model computes it all the same.
        """
        start = perf_counter_ns()
        is_stepped = bool(self._states)
        if self.contact is not None:
            self.lacks_contact = self._contacts.push(self.contact, tactile)
        if self._is_windowed:
            self._frames.push(tactile)
            if joint is not None and self.info["num_joints"]:
                self._joints.push(joint)
        else:
            self._frames.count += 1
        is_full = self._frames.count >= self._length
        if not is_stepped and not (wanted and is_full):
            return None
        feed = self._feed(tactile, joint)
        ready = perf_counter_ns()
        probability, *states = self._session.run(self._outputs, feed)
        self._states = dict(zip(self._states, states, strict=True))
        self.model_ns = perf_counter_ns() - ready
        self.prepare_ns = ready - start
        if self.contact is not None and self.lacks_contact:
            probability = np.full_like(probability, np.nan)
        return probability[0] if wanted and is_full else None

    def recording(self, recording: Recording) -> np.ndarray:
        r"""Returns the probabilities of all frames of a recording :math:`(T, K)`, or of a model of
        windows those of its windows :math:`(W, K)`, thinned and cut as in training: what
        :meth:`Predictor.recording <torch_geometric_tactile.predictor.Predictor.recording>` returns.
        Frames that were added before are forgotten.

        Args:
            recording (Recording): The recording.

        Raises:
            ValueError: If it has another unit, rate or other names of columns than the training, or
                too few frames.
        """
        info, window = self.frame_info, self.info["window"]
        with_rate = bool(self.info.get("needs_rate", self.length > 1))
        info.require(recording.info, "a recording", with_rate=with_rate)
        recording = in_column_order(recording, info.columns)
        index, part = np.arange(recording.num_frames), np.zeros(recording.num_frames, np.int64)
        if window is not None:
            index = info.selected_frames(recording.time, recording.num_frames)
            if window["hop"]:
                part = info.part_numbers(recording.time, recording.num_frames)
        hop = 1 if window is None else window["hop"] or recording.num_frames
        answers: list[np.ndarray] = []
        number = 0
        last = -1
        for i in index.tolist():
            if part[i] != last:
                self.reset()
                last, number = int(part[i]), 0
            number += 1
            joint = None if recording.joint is None else recording.joint[i]
            is_end = number >= self.length and (number - self.length) % hop == 0
            answer = self.add(recording.tactile[i], joint, wanted=is_end)
            if answer is not None:
                answers.append(answer)
        self.reset()
        need(answers, f"a recording must have at least {self.length} frames without a gap", "fewer")
        return np.stack(answers)

    def typical_seconds(self, count: int = 200) -> float:
        r"""Returns how long one answer takes on this machine, the median of some.

        Args:
            count (int): Number of answers.
        """
        feed = {
            name: np.ones(size, np.float64 if name == "rest" else np.float32)
            for name, size in self.inputs.items()
        }
        taken = []
        for _ in range(count):
            start = perf_counter_ns()
            self._session.run(self._outputs, feed)
            taken.append(perf_counter_ns() - start)
        return float(np.median(taken)) * 1e-9

    def _feed(self, tactile: np.ndarray, joint: np.ndarray | None) -> dict[str, np.ndarray]:
        x, joints = np.ascontiguousarray(tactile, np.float32), joint
        if self._is_windowed:
            x = self._frames.last()
            joints = self._joints.last() if self.info["joint_of_frames"] else joint
        feed = {"tactile": x[None], **self._rest, **self._states}
        if self.info["num_joints"]:
            feed["joint"] = np.ascontiguousarray(joints, np.float32)
        return feed

    def _before_rest(
        self, frames: np.ndarray, joint: np.ndarray | None, length: int, hop: int
    ) -> np.ndarray:
        # Readings as the transform sees them that measures the session.
        shape = self.info["rest"]["shape"]
        rest = {"rest": np.zeros(shape), "rest_scale": np.ones(shape, np.float32)}
        given = {name: value for name, value in rest.items() if name in self.inputs}
        size = tuple(self.inputs["tactile"])
        out = []
        for start in range(0, len(frames) - length + 1, hop):
            part = frames[start : start + length]
            if length == 1 and len(size) == 4:  # a frame of a model of windows, as all of one
                part = np.repeat(part, self.length, axis=0)
            feed = {"tactile": part.reshape(size), **given, **self._states}
            if self.info["num_joints"] and joint is not None:
                angles = np.broadcast_to(joint[start + length - 1], self.inputs["joint"])
                feed["joint"] = angles.astype(np.float32)
            out.append(self._session.run(["before_rest"], feed)[0][0])
        return np.stack(out)


def _session_statistics(
    samples: np.ndarray, rule: Mapping[str, Any], num_frames: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns centre and scale of a session, with the numbers of
    :class:`~torch_geometric_tactile.transforms.Tare` and
    :class:`~torch_geometric_tactile.transforms.SessionZScore`. A reading that was never there has
    the centre NaN.

    Shapes:
        - **samples:** Readings :math:`(S, N, F)`.
        - **output:** :math:`(N, F)` each, double; :math:`(1, F)` of channels, :math:`(N, C)` of
          signals
    """
    values = samples.astype(np.float64)
    if rule["per"] == "signal":
        count, rows, _ = values.shape
        values = values.reshape(count, rows, -1, num_frames).transpose(0, 3, 1, 2)
        values = values.reshape(count * num_frames, rows, -1)
    elif rule["per"] == "channel":
        values = values.reshape(-1, 1, values.shape[-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of taxels that are missing throughout
        center = np.nanmean(values, axis=0)
        deviation = np.nanstd(values, axis=0)
    if not rule["has_scale"]:
        return center, np.ones_like(center)
    changes = deviation > 1e-6 * np.maximum(np.abs(center), 1e-6)
    return center, np.where(changes, deviation, 1.0)


def _checked(path: PathLike) -> bytes:
    # The file, unless it was damaged after it was written.
    with open(path, "rb") as file:
        content = file.read()
    found = _DIGEST.search(content)
    if found is None:
        return content  # which is told by what it lacks
    blank = content[: found.start(1)] + b"0" * 64 + content[found.end(1) :]
    if hashlib.sha256(blank).hexdigest().encode() != found[1]:
        raise ValueError(
            f"'{os.fspath(path)}' is damaged: its checksum differs; export the model again"
        )
    return content


def _read_info(entries: Mapping[str, str], path: str) -> dict[str, Any]:
    need(_KEY in entries, f"'{path}' must be a model that 'tactile export' wrote (got another one)")
    try:
        info = json.loads(entries[_KEY])
        if info["format"] != _FORMAT:
            raise ValueError(
                f"'{path}' must have format {_FORMAT} (got {info['format']}): export it again"
            )
        if not _DIGEST.fullmatch(f'"sha256": "{info["sha256"]}"'.encode()):
            raise TypeError("the checksum must be one")
        numbers = [info[name] for name in ("num_taxels", "num_channels", "num_joints")]
        if not all(isinstance(number, int) for number in numbers):
            raise TypeError("sizes must be whole numbers")
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"the metadata of '{path}' cannot be read ({error!r})") from error
    try:
        _contact_rule(info)
    except ValueError as error:
        raise ValueError(f"the metadata of '{path}' cannot be read ({error})") from error
    return dict(info)


def _contact_rule(facts: Mapping[str, Any]) -> ContactRule | None:
    r"""Returns the contact rule of a model; files of older versions have none."""
    content = facts.get("contact")
    return None if content is None else ContactRule.from_dict(content)
