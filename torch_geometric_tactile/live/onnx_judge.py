r"""A model in ONNX, with numpy and onnxruntime alone."""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from time import perf_counter_ns
from typing import Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.live._session_statistics import cut_windows, session_statistics

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
            :obj:`"rest"` and more.
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
        states = [name for name in self.inputs if name.startswith("state_")]
        self._states = {name: np.zeros(self.inputs[name], np.float32) for name in states}
        self._outputs = ["probability", *(f"next_{name}" for name in states)]
        self._rest: dict[str, np.ndarray] = {}
        size = (self.info["num_taxels"], self.info["num_channels"])
        self._frames = np.zeros((2 * self.length, *size), np.float32)
        self._joints = np.zeros((2 * self.length, self.info["num_joints"]), np.float32)
        self._count = 0
        self.prepare_ns = self.model_ns = 0

    @property
    def length(self) -> int:
        r"""Number of frames of a window, one for a model of single frames."""
        window = self.info["window"]
        return 1 if window is None else int(window["length"])

    @property
    def needs_rest(self) -> bool:
        r"""Whether the session must be measured first, and was not."""
        return self.info["rest"] is not None and not self._rest

    def reset(self) -> None:
        r"""Forgets all frames, not the rest."""
        self._count = 0
        for name, state in self._states.items():
            self._states[name] = np.zeros_like(state)

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""Measures the session by some frames at rest.

        Args:
            frames (numpy.ndarray): The frames :math:`(T, N, C)`.
            time (numpy.ndarray): Their times in seconds :math:`(T,)`.
            joint (numpy.ndarray, optional): Joint angles :math:`(T, J)`.

        Raises:
            ValueError: If there are fewer frames than in a window, where these are measured.
        """
        rule = self.info["rest"]
        if rule is None:
            return
        length = self.length if rule["of_windows"] else 1
        if len(frames) < length:
            raise ValueError(
                f"a rest must have at least {length} frames, those of a window (got {len(frames)})"
            )
        hop = (self.info["window"]["hop"] or len(frames)) if rule["of_windows"] else 1
        if rule["from_output"]:
            samples = self._before_rest(frames, joint, length, hop)
        elif rule["of_windows"]:
            samples = cut_windows(frames, length, hop)
        else:
            samples = frames
        self.set_rest(*session_statistics(samples, time[length - 1 :: hop], rule, length))

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""Sets what was measured of the session.

        Args:
            center (numpy.ndarray): Readings at rest :math:`(N, C)`.
            scale (numpy.ndarray, optional): What they are divided by, if the model scales sessions.

        Raises:
            ValueError: If it has another shape, or the scale is missing.
        """
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
        there are not enough frames yet.

        Args:
            tactile (numpy.ndarray): Its readings :math:`(N, C)`.
            joint (numpy.ndarray, optional): Its joint angles :math:`(J,)`.
            wanted (bool): Whether an answer is wanted; a recurrent model computes it all the same.
        """
        start = perf_counter_ns()
        self._count += 1
        is_stepped = bool(self._states)
        if self.length > 1 and not is_stepped:
            self._push(tactile, joint)
        is_full = self._count >= self.length
        if not is_stepped and not (wanted and is_full):
            return None
        feed = self._feed(tactile, joint)
        ready = perf_counter_ns()
        probability, *states = self._session.run(self._outputs, feed)
        self._states = dict(zip(self._states, states, strict=True))
        self.model_ns = perf_counter_ns() - ready
        self.prepare_ns = ready - start
        return probability[0] if wanted and is_full else None

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

    def _push(self, tactile: np.ndarray, joint: np.ndarray | None) -> None:
        # Each frame is there twice, so that the last ones always lie in one piece.
        place = (self._count - 1) % self.length
        for at in (place, place + self.length):
            self._frames[at] = tactile
            if joint is not None and self.info["num_joints"]:
                self._joints[at] = joint

    def _feed(self, tactile: np.ndarray, joint: np.ndarray | None) -> dict[str, np.ndarray]:
        x, joints = np.ascontiguousarray(tactile, np.float32), joint
        if self.length > 1 and not self._states:
            start = self._count % self.length
            x = self._frames[start : start + self.length]
            if self.info["joint_of_frames"]:
                joints = self._joints[start : start + self.length]
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
    if _KEY not in entries:
        raise ValueError(f"'{path}' must be a model that 'tactile export' wrote (got another one)")
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
    return dict(info)
