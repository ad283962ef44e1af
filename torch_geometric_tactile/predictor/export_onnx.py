r"""A predictor as one ONNX graph, from raw readings to probabilities."""

import copy
import hashlib
import json
import logging
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from os import fspath
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile import __version__
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import FrameInfo, Recording
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.nn.conv._static_adjacency import plain_products_when_traced
from torch_geometric_tactile.predictor._network import Network
from torch_geometric_tactile.predictor._onnx_graph import OnnxGraph
from torch_geometric_tactile.predictor._onnx_products import compute_in_blocks
from torch_geometric_tactile.predictor._onnx_quantization import (
    Agreement,
    compare_predictions,
    quantize_weights,
)
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.transforms import FittedTransform

#: The key of the metadata of a file, JSON.
_METADATA = "torch_geometric_tactile"
_FORMAT = 1
_OPSET = 18
_NO_DIGEST = "0" * 64
_EXTRAS = ("onnx", "onnxscript", "onnxruntime")
_TOLERANCE = 1e-5
_SEED = 0
_NUM_RANDOM_READINGS = 256  # readings on which eight-bit weights are compared, without recordings

_Example = tuple[np.ndarray, np.ndarray | None]  # frames (T, N, C) and angles (T, J)


class Exported(NamedTuple):
    r"""Properties of a file written by :func:`export_onnx`.

    Args:
        num_bytes (int): Size of the file in bytes.
        difference (float): Largest difference between the graph and the predictor.
        metadata (dict): The metadata of the file.
        agreement (Agreement, optional): If the graph is quantized, a comparison of the graphs with
            eight-bit weights and in single precision.
    """

    num_bytes: int
    difference: float
    metadata: dict[str, Any]
    agreement: Agreement | None = None


def export_onnx(
    predictor: Predictor,
    path: PathLike,
    *,
    unit: str | None = None,
    num_channels: int | None = None,
    quantize: bool = False,
    check: Sequence[Recording] = (),
    rest: float | None = None,
) -> Exported:
    r"""Writes a predictor as one ONNX graph from raw readings to probabilities. The graph includes
    scaling, kinematics, edge features and the network.

    The graph has these inputs:

    * :obj:`tactile` :math:`(1, N, C)`, or :math:`(1, T, N, C)` for a model that reads windows
    * :obj:`rest`, the readings at rest, if a transform measures sessions
      (:class:`~torch_geometric_tactile.transforms.Tare`)
    * :obj:`joint` :math:`(J,)` in radians, if the predictor reads joint angles
    * the state of a model that steps from frame to frame

    The outputs are :obj:`probability` :math:`(1, K)` and the next state.

    Before it is written, the graph is compared with the predictor on random readings, readings near
    rest and missing readings. If writing fails, no partial file is left.

    Args:
        predictor (Predictor): The predictor.
        path (str or PathLike): The file to write.
        unit (str, optional): Unit of the readings, for the metadata.
        num_channels (int, optional): Number of channels per taxel, if the predictor does not store
            it.
        quantize (bool): If :obj:`True`, large linear maps (with 524,288 weights or more) have
            eight-bit weights. The file is smaller and faster, and its predictions differ slightly.
            The attribute :obj:`agreement` and the metadata :obj:`"quantization"` contain the share
            of equal labels and the largest change of a probability.
        check (sequence of Recording): Recordings on which predictions with eight-bit weights are
            compared, such as validation recordings. By default, random readings are used.
        rest (float, optional): Seconds at the start of each recording in which nothing touches the
            sensor, for a transform that measures sessions. Defaults to the value in training.

    Raises:
        ImportError: If the extra is missing.
        NotImplementedError: If a transform or the model cannot be exported.
        ValueError: If the graph differs from the predictor, there is no large linear map to
            quantize, or a recording does not fit the predictor.
    """
    _require_export()
    need(quantize or not check, "'check' must be left out without 'quantize'", len(check))
    if unit not in (None, *UNITS):
        raise ValueError(f"'unit' must be one of {[*UNITS]} or None (got {unit!r})")
    graph = OnnxGraph(_copy_to_cpu(predictor), num_channels)
    program = _export_program(graph)
    program.ir_version = min(program.ir_version, 10)  # newer versions need a newer onnxruntime
    compute_in_blocks(program)
    reference = _copy_to_cpu(predictor)
    reference.contact = None  # the readers of the file apply the rule; the graph does not
    reference.preparation.info = FrameInfo()  # a graph takes selected frames, so none are skipped
    single_session = _open_session(program.SerializeToString())
    difference = _largest_difference(single_session, graph, reference)
    if not difference <= _TOLERANCE:
        raise ValueError(
            f"the graph of {predictor!r} must agree with it to {_TOLERANCE:g} (got a difference of "
            f"{difference:.2g}): nothing was written"
        )
    agreement = None
    metadata = _describe_graph(predictor, graph, unit)
    metadata["parity"], metadata["quantization"] = difference, None
    if quantize:
        program, num_weights = quantize_weights(program)
        quantized_session = _open_session(program.SerializeToString())
        agreement = _compare_sessions(
            (single_session, quantized_session), graph, predictor, check, rest
        )
        metadata["quantization"] = {"bits": 8, "weights": num_weights, **agreement._asdict()}
    entry = program.metadata_props.add()
    entry.key = _METADATA
    entry.value = json.dumps({**metadata, "sha256": _NO_DIGEST})
    content = _insert_digest(program.SerializeToString())
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return Exported(len(content), difference, metadata, agreement)


def _insert_digest(content: bytes) -> bytes:
    # The digest is computed with zeros in its place, so that a reader can check it without ONNX.
    field = f'"sha256": "{_NO_DIGEST}"'.encode()
    digest = hashlib.sha256(content).hexdigest()
    return content.replace(field, f'"sha256": "{digest}"'.encode())


def _require_export() -> None:
    r"""Raises an :class:`ImportError` with the pip command if the extra is missing."""
    for name in _EXTRAS:
        try:
            import_module(name)
        except ImportError as error:
            raise ImportError(
                f"a graph needs {name}: pip install 'torch-geometric-tactile[export]'"
            ) from error


def _open_session(model: bytes | PathLike) -> Any:
    r"""Returns a session of onnxruntime that uses one thread."""
    runtime = import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    source = model if isinstance(model, bytes) else fspath(model)
    return runtime.InferenceSession(source, options, providers=["CPUExecutionProvider"])


def _describe_graph(predictor: Predictor, graph: OnnxGraph, unit: str | None) -> dict[str, Any]:
    r"""Returns the metadata of a graph as JSON values."""
    preparation, hand = predictor.preparation.metadata(), predictor.preparation.hand
    if graph.rest is not None:
        part = graph.rest.part
        preparation["rest"] |= {
            "per": part.per,
            "has_scale": graph.rest.has_scale,
            "first": part.first,
            "seconds": getattr(part, "seconds", None),
            "of_windows": graph.rest.measures_windows,
            "from_output": graph.outputs_rest_readings,
            "shape": list(graph.rest_shape()),
        }
    return {
        "format": _FORMAT,
        "package": __version__,
        "model": type(predictor.model).__name__,
        **predictor.network.metadata(),
        **preparation,
        "num_channels": graph.num_channels,
        "num_joints": graph.num_joints,
        "joint_names": None if hand is None else list(hand.joint_names),
        "joint_of_frames": graph.joint_of_frames,
        "unit": unit,
        "is_stepped": graph.is_stepped,
    }


def _copy_to_cpu(predictor: Predictor) -> Predictor:
    # A copy in single precision is used, because tracing may leave tensors in caches of the model.
    out = copy.deepcopy(predictor)
    network = Network(out.model.float(), out.class_names, out.task, out.threshold)
    return Predictor._from_parts(out.preparation, network).to("cpu")


def _export_program(graph: OnnxGraph) -> Any:
    inputs = [*graph.zero_inputs().values(), *graph.state]
    graph.requires_grad_(False)
    products = plain_products_when_traced() if graph.needs_all_readings else nullcontext()
    try:
        with torch.no_grad(), _without_warnings(), products:
            graph(*inputs)  # fills the caches of layers, whose content is then constant
            # The graph is traced here, because `torch.onnx.export` of PyTorch 2.8 tries several
            # ways to trace a graph, and `current_step` would belong to the last attempt.
            exported_program = torch.export.export(graph, tuple(inputs), strict=False)
            program = torch.onnx.export(
                exported_program,
                dynamo=True,
                opset_version=_OPSET,
                input_names=graph.input_names,
                output_names=graph.output_names,
                verbose=False,
            )
    except NotImplementedError:
        raise
    except Exception as error:
        reason = " ".join(str(error.__cause__ or error).split())[:200]
        raise NotImplementedError(
            f"{graph.current_step} cannot be exported: its operations have no ONNX equivalent, or "
            f"depend on values ({type(error).__name__}: {reason})"
        ) from error
    assert program is not None
    return program.model_proto


@contextmanager
def _without_warnings() -> Iterator[None]:
    # PyTorch warns about optional packages and about deprecations in its own code.
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _random_examples(graph: OnnxGraph, predictor: Predictor, count: int = 4) -> Iterator[_Example]:
    r"""Yields random readings on the scale of the fitted predictor, then readings near rest,
    readings with one missing taxel and readings with many missing taxels.
    """
    draw = np.random.default_rng(_SEED)
    size = (graph.length, graph.layout.num_taxels, graph.num_channels)
    center, scale = _usual_readings(predictor, size)
    joints = (graph.length, graph.num_joints)
    for i in range(count + 3):
        frames = center + (1 + min(i, 6)) / 2 * scale * draw.standard_normal(size)
        angles = draw.uniform(-0.3, 0.9, joints)
        if i == count:  # near rest
            frames = center + 1e-1 * scale * draw.standard_normal(size)
            angles = np.zeros(joints)
        elif i == count + 1:
            frames[:, :1] = np.nan
        elif i == count + 2:
            frames[:, ::3] = np.nan
        joint = angles.astype(np.float32) if graph.num_joints else None
        yield frames.astype(np.float32), joint


def _compare_sessions(
    sessions: tuple[Any, Any],
    graph: OnnxGraph,
    predictor: Predictor,
    recordings: Sequence[Recording],
    rest: float | None,
) -> Agreement:
    r"""Compares the predictions of two graphs, on recordings or on random readings."""
    predictor = _copy_to_cpu(predictor)
    predictor.contact = None  # frames without contact would have no numbers to compare
    pairs: Iterable[tuple[_Example, dict[str, np.ndarray]]]
    if recordings:
        pairs = (
            pair
            for recording in recordings
            for pair in _recorded_examples(graph, predictor, recording, rest)
        )
    else:
        rest_inputs = _shifted_rest(graph, predictor)
        pairs = (
            (example, rest_inputs)
            for example in _random_examples(graph, predictor, _NUM_RANDOM_READINGS)
        )
    answers = [[_run_graph(session, graph, *pair) for session in sessions] for pair in pairs]
    single, quantized = np.array(answers).swapaxes(0, 1)
    source = "recordings" if recordings else "random"
    return compare_predictions(single, quantized, predictor.network, source)


def _recorded_examples(
    graph: OnnxGraph, predictor: Predictor, recording: Recording, rest: float | None
) -> Iterator[tuple[_Example, dict[str, np.ndarray]]]:
    r"""Yields the frames or windows of a recording with the measured readings at rest of its
    session.
    """
    preparation = predictor.preparation
    recording = preparation.match_recording(recording)
    rest_inputs: dict[str, np.ndarray] = {}
    if graph.rest is not None:
        preparation.session.adapt_recording(recording, rest=rest)
        (part,) = preparation.session.transforms
        assert part.center is not None
        rest_inputs["rest"] = part.center[-1].double().numpy()
        if graph.rest.has_scale:
            assert part.scale is not None
            rest_inputs["rest_scale"] = part.scale[-1].float().numpy()
    num_frames, length = recording.num_frames, graph.length
    selected = last = np.arange(num_frames)
    if graph.window is not None:
        selected = preparation.info.selected_frames(recording.time, num_frames)
        last = preparation.cut_recording(recording)[1].numpy()
    tactile = recording.tactile.astype(np.float32)
    joint = None if not graph.num_joints else recording.joint
    for position in np.searchsorted(selected, last).tolist():
        frames = selected[position - length + 1 : position + 1]
        angles = None if joint is None else joint[frames].astype(np.float32)
        yield (tactile[frames], angles), rest_inputs


def _usual_readings(predictor: Predictor, size: tuple[int, ...]) -> tuple[Any, Any]:
    # The centre and scale of the readings, from the fitted transforms up to the first that scales.
    preparation = predictor.preparation
    center, scale = np.zeros(size), np.ones(size)
    for part in preparation.transforms:
        if not isinstance(part, FittedTransform) or part.attr != "x" or part.center is None:
            continue
        assert part.scale is not None
        statistics = [value[0].numpy() for value in (part.center, part.scale)]
        num_columns = statistics[0].shape[-1]
        if (
            num_columns == size[2] * size[0] and size[0] > 1
        ):  # windows hold all frames of a channel side by side
            statistics = [value.reshape(-1, size[2], size[0]).mean(axis=-1) for value in statistics]
        if statistics[0].shape[-1] != size[2]:
            break
        center = center + statistics[0]
        if not part.unit_scale:
            return center, statistics[1] + np.zeros(size)
    return center, scale


def _predict(predictor: Predictor, graph: OnnxGraph, example: _Example, rest: Any) -> np.ndarray:
    r"""Returns the probabilities of the predictor for an example."""
    frames, joint = example
    if rest:
        tensors = {name: torch.from_numpy(value) for name, value in rest.items()}
        predictor.preparation.session.set_rest(tensors["rest"], tensors.get("rest_scale"))
    if graph.window is None:
        angles = None if joint is None else torch.from_numpy(joint[0])
        return predictor(torch.from_numpy(frames[0]), angles).numpy()
    recording = Recording(time=np.arange(len(frames)) / 100, tactile=frames, joint=joint)
    return predictor.recording(recording)[-1].numpy()


def _run_graph(session: Any, graph: OnnxGraph, example: _Example, rest: Any) -> np.ndarray:
    r"""Returns the probabilities of an exported graph for an example."""
    frames, joint = example
    inputs: dict[str, np.ndarray] = dict(rest)
    if not graph.is_stepped:
        inputs["tactile"] = frames if graph.window is None else frames[None]
        if joint is not None:
            inputs["joint"] = joint if graph.joint_of_frames else joint[-1]
        window_probability: np.ndarray = session.run(["probability"], inputs)[0][0]
        return window_probability
    for i, state in enumerate(graph.state):
        inputs[f"state_{i}"] = state.numpy()
    names = [name for name in graph.output_names if name != "before_rest"]
    for i, frame in enumerate(frames):
        inputs["tactile"] = frame[None]
        if joint is not None:
            inputs["joint"] = joint[i]
        probability, *states = session.run(names, inputs)
        inputs |= {f"state_{j}": state for j, state in enumerate(states)}
    last_probability: np.ndarray = probability[0]
    return last_probability


def _largest_difference(session: Any, graph: OnnxGraph, predictor: Predictor) -> float:
    r"""Returns the largest difference between a graph and its predictor. It is infinite if only one
    of them is NaN.
    """
    largest = 0.0
    for example in _random_examples(graph, predictor):
        rest = _shifted_rest(graph, predictor)
        expected = _predict(predictor, graph, example, rest)
        predicted = _run_graph(session, graph, example, rest)
        if predicted.shape != expected.shape or not np.array_equal(
            np.isnan(predicted), np.isnan(expected)
        ):
            return float("inf")
        # Relative to the largest number of a regression; probabilities are at most one.
        unit = max(1.0, float(np.nanmax(np.abs(expected), initial=0.0)))
        difference = np.nanmax(np.abs(predicted - expected), initial=0.0)
        largest = max(largest, float(difference) / unit)
    return largest


def _shifted_rest(graph: OnnxGraph, predictor: Predictor) -> dict[str, np.ndarray]:
    if graph.rest is None:
        return {}
    part = graph.rest.part
    shape = graph.rest_shape()
    center = np.zeros(shape) if part.center is None else part.center[0].numpy()
    rest = {"rest": center + 0.123456789}
    if graph.rest.has_scale:
        scale = np.ones(shape) if part.scale is None else 1.1 * part.scale[0].numpy()
        rest["rest_scale"] = scale.astype(np.float32)
    return rest
