r"""A predictor in an ONNX file, computed by onnxruntime."""

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

_METADATA_KEY = "torch_geometric_tactile"
_FORMAT = 1
_DIGEST = re.compile(rb'"sha256": "([0-9a-f]{64})"')


class OnnxModel:
    r"""Runs a predictor that ``tactile export`` wrote as an ONNX file. It needs numpy and
    onnxruntime, and computes in one thread.

    Args:
        path (str or PathLike): The file.

    Attributes:
        info (dict): The metadata of the file: :obj:`"class_names"`, :obj:`"task"`,
            :obj:`"num_taxels"`, :obj:`"num_channels"`, :obj:`"num_joints"`, :obj:`"window"`,
            :obj:`"rest"` and more. In a file with 8-bit weights, :obj:`"quantization"` holds
            the differences from single precision.
        frame_info (FrameInfo): Unit, columns, rate and thinning of the training frames.
        contact (ContactRule, optional): The rule that detects frames without contact (see
            :class:`~torch_geometric_tactile.Predictor`). By default the rule of the file. It can be
            set.
        lacks_contact (bool): Whether the last frame or window lacks contact. Its probabilities are
            then NaN.
        inputs (dict): Shapes of the inputs of the graph by name.
        outputs (dict): Shapes of the outputs of the graph by name.
        prepare_ns (int): Duration of the preparation of the last prediction in nanoseconds.
        model_ns (int): Duration of the computation of the last prediction in nanoseconds.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If onnxruntime is missing.
        ValueError: If the file is not such a model, or a later version wrote it.

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
                "an ONNX model needs onnxruntime: pip install 'torch-geometric-tactile[export]'"
            ) from error
        if not os.path.isfile(path):
            raise FileNotFoundError(f"there is no model '{os.fspath(path)}'")
        content = _read_checked(path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
        # A spinning thread would keep a core of the robot busy while no frame arrives.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # the runtime does not export its error classes
            raise ValueError(f"'{os.fspath(path)}' is not an ONNX model ({error})") from error
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
        self._contact_window = ContactWindow(self._length)
        num_taxels = self.info["num_taxels"]
        # A ring holds each row twice, so that every window is contiguous.
        self._frames, self._joints = (
            Ring(np.zeros((2 * self._length, *size), np.float32))
            for size in ((num_taxels, self.info["num_channels"]), (self.info["num_joints"],))
        )
        self.prepare_ns = self.model_ns = 0

    @property
    def length(self) -> int:
        r"""Number of frames in a window; 1 for a single-frame model."""
        return self._length

    @property
    def is_quantized(self) -> bool:
        r"""Whether large linear layers have 8-bit weights."""
        return self.info.get("quantization") is not None

    def __repr__(self) -> str:
        info = self.info
        description = f"'{info['layout']}', classes={info['class_names']}, task='{info['task']}'"
        if self.is_quantized:
            agreement = info["quantization"]
            labels = agreement["equal_labels"]
            same_labels = "" if labels is None else f"{100 * labels:.2f} % same labels, "
            description += (
                f", weights of 8 bits: {same_labels}largest change "
                f"{agreement['largest_change']:.2g} on {agreement['num_answers']} "
                f"{'recorded' if agreement['frames'] == 'recordings' else 'random'} frames"
            )
        return f"{type(self).__name__}({info['model']}, {description})"

    @property
    def needs_rest(self) -> bool:
        r"""Whether the model needs a rest that has not been measured yet."""
        return self.info["rest"] is not None and not self._rest

    def reset(self) -> None:
        r"""Forgets all frames, but not the rest."""
        self._frames.count = self._joints.count = 0
        for name, state in self._states.items():
            self._states[name] = np.zeros_like(state)

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""Measures the session from frames at rest, for the model and for :attr:`contact`.

        Args:
            frames (numpy.ndarray): Readings of the frames :math:`(T, N, C)`.
            time (numpy.ndarray): Times of the frames in seconds :math:`(T,)`.
            joint (numpy.ndarray, optional): Joint angles in radians :math:`(T, J)`.

        Raises:
            ValueError: If a model that measures windows gets fewer frames than a window has, or
                :meth:`ContactRule.measured <torch_geometric_tactile.data.ContactRule>` raises it.
        """
        if self.contact is not None:
            self.contact = self.contact.measured(frames)
        settings = self.info["rest"]
        if settings is None:
            return
        selected = self.frame_info.selected_frames(time, len(frames))
        frames, time = frames[selected], time[selected]
        joint = None if joint is None else joint[selected]
        length = self.length if settings["of_windows"] else 1
        if len(frames) < length:
            raise ValueError(
                f"a rest must have at least {length} frames, one window (got {len(frames)})"
            )
        hop = (self.info["window"]["hop"] or len(frames)) if settings["of_windows"] else 1
        if settings["from_output"]:
            samples = self._rest_samples(frames, joint, length, hop)
        else:
            windows = np.lib.stride_tricks.sliding_window_view(frames, length, axis=0)[::hop]
            samples = windows.reshape(*windows.shape[:2], -1)
        self._set_session(*_session_statistics(samples, settings, length))

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""Sets the centre and scale of the session.

        Args:
            center (numpy.ndarray): Readings at rest :math:`(N, C)`.
            scale (numpy.ndarray, optional): Divisor of the readings, if the model scales sessions.

        Raises:
            ValueError: If a shape is wrong, or the scale is missing.
        """
        if self.contact is not None and center.shape[-1:] == (self.info["num_channels"],):
            self.contact = self.contact.with_rest(center)
        self._set_session(center, scale)

    def _set_session(self, center: np.ndarray, scale: np.ndarray | None) -> None:
        settings = self.info["rest"]
        if settings is None:
            return
        shape = tuple(settings["shape"])
        for name, value in (("rest", center), ("scale", scale)):
            if value is not None and value.shape != shape:
                raise ValueError(f"'{name}' must have shape {shape} (got {value.shape})")
        self._rest = {"rest": np.ascontiguousarray(center, np.float64)}
        if settings["has_scale"]:
            if scale is None:
                raise ValueError(
                    "'scale' must be given, since the model scales each session (got None)"
                )
            self._rest["rest_scale"] = np.ascontiguousarray(scale, np.float32)

    def add(self, tactile: np.ndarray, joint: np.ndarray | None, predict: bool = True) -> Any:
        r"""Adds the next frame, and returns the probabilities :math:`(K,)`, or :obj:`None` if there
        are not enough frames yet. Without contact they are NaN, if :attr:`contact` is set.

        Args:
            tactile (numpy.ndarray): Readings :math:`(N, C)`.
            joint (numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
            predict (bool): Whether to return probabilities. A recurrent model always computes them.
        """
        start = perf_counter_ns()
        is_stepped = bool(self._states)
        if self.contact is not None:
            self.lacks_contact = self._contact_window.push(self.contact, tactile)
        if self._is_windowed:
            self._frames.push(tactile)
            if joint is not None and self.info["num_joints"]:
                self._joints.push(joint)
        else:
            self._frames.count += 1
        is_full = self._frames.count >= self._length
        if not is_stepped and not (predict and is_full):
            return None
        inputs = self._graph_inputs(tactile, joint)
        model_start = perf_counter_ns()
        probability, *states = self._session.run(self._outputs, inputs)
        self._states = dict(zip(self._states, states, strict=True))
        self.model_ns = perf_counter_ns() - model_start
        self.prepare_ns = model_start - start
        if self.contact is not None and self.lacks_contact:
            probability = np.full_like(probability, np.nan)
        return probability[0] if predict and is_full else None

    def recording(self, recording: Recording) -> np.ndarray:
        r"""Returns the probabilities of all frames of a recording :math:`(T, K)`, as
        :meth:`Predictor.recording <torch_geometric_tactile.predictor.Predictor.recording>` does.
        For a windowed model, returns the probabilities of its windows :math:`(W, K)`, selected
        and cut as in training. Earlier frames are forgotten.

        Args:
            recording (Recording): The recording.

        Raises:
            ValueError: If the unit, rate or column names of the recording differ from training, or
                it has too few frames.
        """
        info, window = self.frame_info, self.info["window"]
        with_rate = bool(self.info.get("needs_rate", self.length > 1))
        info.require(recording.info, "a recording", with_rate=with_rate)
        recording = in_column_order(recording, info.columns)
        selected, part = np.arange(recording.num_frames), np.zeros(recording.num_frames, np.int64)
        if window is not None:
            selected = info.selected_frames(recording.time, recording.num_frames)
            if window["hop"]:
                part = info.part_numbers(recording.time, recording.num_frames)
        hop = 1 if window is None else window["hop"] or recording.num_frames
        answers: list[np.ndarray] = []
        num_frames = 0
        last_part = -1
        for i in selected.tolist():
            if part[i] != last_part:
                self.reset()
                last_part, num_frames = int(part[i]), 0
            num_frames += 1
            joint = None if recording.joint is None else recording.joint[i]
            is_end = num_frames >= self.length and (num_frames - self.length) % hop == 0
            answer = self.add(recording.tactile[i], joint, predict=is_end)
            if answer is not None:
                answers.append(answer)
        self.reset()
        need(answers, f"a recording must have at least {self.length} frames without a gap", "fewer")
        return np.stack(answers)

    def typical_seconds(self, count: int = 200) -> float:
        r"""Returns the median duration of a prediction on this machine in seconds.

        Args:
            count (int): Number of measured predictions.
        """
        inputs = {
            name: np.ones(size, np.float64 if name == "rest" else np.float32)
            for name, size in self.inputs.items()
        }
        durations = []
        for _ in range(count):
            start = perf_counter_ns()
            self._session.run(self._outputs, inputs)
            durations.append(perf_counter_ns() - start)
        return float(np.median(durations)) * 1e-9

    def _graph_inputs(self, tactile: np.ndarray, joint: np.ndarray | None) -> dict[str, np.ndarray]:
        x, joints = np.ascontiguousarray(tactile, np.float32), joint
        if self._is_windowed:
            x = self._frames.last()
            joints = self._joints.last() if self.info["joint_of_frames"] else joint
        inputs = {"tactile": x[None], **self._rest, **self._states}
        if self.info["num_joints"]:
            inputs["joint"] = np.ascontiguousarray(joints, np.float32)
        return inputs

    def _rest_samples(
        self, frames: np.ndarray, joint: np.ndarray | None, length: int, hop: int
    ) -> np.ndarray:
        # Readings at the input of the transform that measures the session. The graph returns them
        # as an output.
        shape = self.info["rest"]["shape"]
        rest = {"rest": np.zeros(shape), "rest_scale": np.ones(shape, np.float32)}
        rest_inputs = {name: value for name, value in rest.items() if name in self.inputs}
        size = tuple(self.inputs["tactile"])
        samples = []
        for start in range(0, len(frames) - length + 1, hop):
            window = frames[start : start + length]
            if length == 1 and len(size) == 4:  # the graph takes windows: one frame fills it
                window = np.repeat(window, self.length, axis=0)
            inputs = {"tactile": window.reshape(size), **rest_inputs, **self._states}
            if self.info["num_joints"] and joint is not None:
                angles = np.broadcast_to(joint[start + length - 1], self.inputs["joint"])
                inputs["joint"] = angles.astype(np.float32)
            samples.append(self._session.run(["before_rest"], inputs)[0][0])
        return np.stack(samples)


def _session_statistics(
    samples: np.ndarray, settings: Mapping[str, Any], num_frames: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns the centre and scale of a session, as computed by
    :class:`~torch_geometric_tactile.transforms.Tare` and
    :class:`~torch_geometric_tactile.transforms.SessionZScore`. The centre of a reading that is
    missing in all samples is NaN.

    Shapes:
        - **samples:** readings :math:`(S, N, F)`
        - **output:** :math:`(N, F)` each, double; :math:`(1, F)` by channel, :math:`(N, C)` by
          signal
    """
    values = samples.astype(np.float64)
    if settings["per"] == "signal":
        num_samples, rows, _ = values.shape
        values = values.reshape(num_samples, rows, -1, num_frames).transpose(0, 3, 1, 2)
        values = values.reshape(num_samples * num_frames, rows, -1)
    elif settings["per"] == "channel":
        values = values.reshape(-1, 1, values.shape[-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of taxels without readings
        center = np.nanmean(values, axis=0)
        deviation = np.nanstd(values, axis=0)
    if not settings["has_scale"]:
        return center, np.ones_like(center)
    is_varying = deviation > 1e-6 * np.maximum(np.abs(center), 1e-6)
    return center, np.where(is_varying, deviation, 1.0)


def _read_checked(path: PathLike) -> bytes:
    # Raises an error if the file was damaged after it was written.
    with open(path, "rb") as file:
        content = file.read()
    match = _DIGEST.search(content)
    if match is None:
        return content  # not an exported model: reading the metadata raises the error
    blanked = content[: match.start(1)] + b"0" * 64 + content[match.end(1) :]
    if hashlib.sha256(blanked).hexdigest().encode() != match[1]:
        raise ValueError(
            f"'{os.fspath(path)}' is damaged (its checksum differs): export the model again"
        )
    return content


def _read_info(entries: Mapping[str, str], path: str) -> dict[str, Any]:
    need(
        _METADATA_KEY in entries,
        f"'{path}' must be a model that 'tactile export' wrote (got another file)",
    )
    try:
        info = json.loads(entries[_METADATA_KEY])
        if info["format"] != _FORMAT:
            raise ValueError(
                f"'{path}' must have format {_FORMAT} (got {info['format']}): export it again"
            )
        if not _DIGEST.fullmatch(f'"sha256": "{info["sha256"]}"'.encode()):
            raise TypeError("the checksum must be a SHA-256 digest")
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


def _contact_rule(metadata: Mapping[str, Any]) -> ContactRule | None:
    r"""Returns the contact rule of a model, or :obj:`None`; files of older versions have none."""
    content = metadata.get("contact")
    return None if content is None else ContactRule.from_dict(content)
