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
    compare_answers,
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
_NUM_RANDOM = 256  # readings on which weights of eight bits are compared, without recordings

_Example = tuple[np.ndarray, np.ndarray | None]  # frames (T, N, C) and angles (T, J)


class Exported(NamedTuple):
    r"""What :func:`export_onnx` wrote."""

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
    r"""Writes a predictor as one ONNX graph: scaling, kinematics, edge features and network, from
    raw readings to probabilities.

    Inputs are :obj:`tactile` :math:`(1, N, C)`, or :math:`(1, T, N, C)` of a model of windows;
    :obj:`rest`, what was measured of the session, if a transform measures sessions
    (:class:`~torch_geometric_tactile.transforms.Tare`); :obj:`joint` :math:`(J,)` if they are
    needed; and the state of a model that steps from frame to frame. The output is
    :obj:`probability` :math:`(1, K)`, with the next state.

    The graph is compared with the predictor before it is written, on random readings, zeros and
    missing ones. The file is written whole or not at all.

    Args:
        predictor (Predictor): The predictor.
        path (str or PathLike): The file to write.
        unit (str, optional): Unit of the readings, for the metadata.
        num_channels (int, optional): Channels of a taxel, if the predictor does not know them.
        quantize (bool): Whether large linear maps (524,288 weights and more) have weights of eight
            bits. The file is smaller and faster, and its answers differ a little:
            :obj:`agreement` of the result, and :obj:`"quantization"` of the metadata, say on how
            many frames the labels are the same, and the largest change of a probability.
        check (sequence of Recording): Recordings on which the answers with weights of eight bits
            are compared, such as those of the validation; random readings if left out.
        rest (float, optional): How many seconds each of them begins with at rest, for a transform
            that measures sessions; as in training if left out.

    Raises:
        ImportError: If the extra is missing.
        NotImplementedError: If a transform or the model has no form in a graph.
        ValueError: If the graph differs from the predictor, there is no large linear map to
            quantize, or a recording does not fit.
    """
    _require_export()
    need(quantize or not check, "'check' must be left out without 'quantize'", len(check))
    if unit not in (None, *UNITS):
        raise ValueError(f"'unit' must be one of {[*UNITS]} or None (got {unit!r})")
    graph = OnnxGraph(_copy(predictor), num_channels)
    program = _program(graph)
    program.ir_version = min(program.ir_version, 10)  # read by every runtime that we support
    compute_in_blocks(program)
    checked = _copy(predictor)
    checked.contact = None  # which readers of the file apply, not the graph
    checked.preparation.info = FrameInfo()  # the frames of a window are those that a graph gets
    session = _open_session(program.SerializeToString())
    difference = _largest_difference(session, graph, checked)
    if not difference <= _TOLERANCE:
        raise ValueError(
            f"the graph of {predictor!r} must give its numbers to {_TOLERANCE:g} (got a difference "
            f"of {difference:.2g}): nothing was written"
        )
    agreement = None
    metadata = _describe(predictor, graph, unit)
    metadata["parity"], metadata["quantization"] = difference, None
    if quantize:
        program, num_weights = quantize_weights(program)
        quantized = _open_session(program.SerializeToString())
        agreement = _agreement((session, quantized), graph, predictor, check, rest)
        metadata["quantization"] = {"bits": 8, "weights": num_weights, **agreement._asdict()}
    entry = program.metadata_props.add()
    entry.key = _METADATA
    entry.value = json.dumps({**metadata, "sha256": _NO_DIGEST})
    content = _with_digest(program.SerializeToString())
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return Exported(len(content), difference, metadata, agreement)


def _with_digest(content: bytes) -> bytes:
    # Of the file with zeros in place of the digest, such that a reader needs no ONNX for it.
    field = f'"sha256": "{_NO_DIGEST}"'.encode()
    digest = hashlib.sha256(content).hexdigest()
    return content.replace(field, f'"sha256": "{digest}"'.encode())


def _require_export() -> None:
    r"""Raises an :class:`ImportError` that gives the pip line, if the extra is missing."""
    for name in _EXTRAS:
        try:
            import_module(name)
        except ImportError as error:
            raise ImportError(
                f"a graph needs {name}: pip install 'torch-geometric-tactile[export]'"
            ) from error


def _open_session(model: bytes | PathLike) -> Any:
    r"""Returns a session of onnxruntime in one thread."""
    runtime = import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    given = model if isinstance(model, bytes) else fspath(model)
    return runtime.InferenceSession(given, options, providers=["CPUExecutionProvider"])


def _describe(predictor: Predictor, graph: OnnxGraph, unit: str | None) -> dict[str, Any]:
    r"""Returns the metadata of a graph."""
    preparation, hand = predictor.preparation.facts(), predictor.preparation.hand
    if graph.rest is not None:
        part = graph.rest.part
        preparation["rest"] |= {
            "per": part.per,
            "has_scale": graph.rest.has_scale,
            "first": part.first,
            "seconds": getattr(part, "seconds", None),
            "of_windows": graph.rest.of_windows,
            "from_output": graph.shows_rest,
            "shape": list(graph.rest_shape()),
        }
    return {
        "format": _FORMAT,
        "package": __version__,
        "model": type(predictor.model).__name__,
        **predictor.network.facts(),
        **preparation,
        "num_channels": graph.num_channels,
        "num_joints": graph.num_joints,
        "joint_names": None if hand is None else list(hand.joint_names),
        "joint_of_frames": graph.joint_of_frames,
        "unit": unit,
        "is_stepped": graph.is_stepped,
    }


def _copy(predictor: Predictor) -> Predictor:
    # In single precision on the processor; what a trace leaves in caches stays in the copy.
    out = copy.deepcopy(predictor)
    network = Network(out.model.float(), out.class_names, out.task, out.threshold)
    return Predictor._of(out.preparation, network).to("cpu")


def _program(graph: OnnxGraph) -> Any:
    inputs = [*graph.blank().values(), *graph.state]
    graph.requires_grad_(False)
    products = plain_products_when_traced() if graph.needs_all_readings else nullcontext()
    try:
        with torch.no_grad(), _quiet(), products:
            graph(*inputs)  # fills what layers keep, so that it is constant
            # Traced here: PyTorch 2.8 traces a failing graph in other ways too, and `at` would be
            # where the last of them ended.
            traced = torch.export.export(graph, tuple(inputs), strict=False)
            program = torch.onnx.export(
                traced,
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
            f"{graph.at} cannot be exported: its operations have no ONNX form, or depend on values "
            f"({type(error).__name__}: {reason})"
        ) from error
    assert program is not None
    return program.model_proto


@contextmanager
def _quiet() -> Iterator[None]:
    # PyTorch warns of packages that are not needed, and of its own future.
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _examples(graph: OnnxGraph, predictor: Predictor, count: int = 4) -> Iterator[_Example]:
    r"""Yields frames like those that the predictor was fitted on, and others: hardly touched,
    one taxel without a reading, and many.
    """
    draw = np.random.default_rng(_SEED)
    size = (graph.length, graph.layout.num_taxels, graph.num_channels)
    center, scale = _usual(predictor, size)
    joints = (graph.length, graph.num_joints)
    for i in range(count + 3):
        frames = center + (1 + min(i, 6)) / 2 * scale * draw.standard_normal(size)
        angles = draw.uniform(-0.3, 0.9, joints)
        if i == count:  # hardly touched
            frames = center + 1e-1 * scale * draw.standard_normal(size)
            angles = np.zeros(joints)
        elif i == count + 1:
            frames[:, :1] = np.nan
        elif i == count + 2:
            frames[:, ::3] = np.nan
        joint = angles.astype(np.float32) if graph.num_joints else None
        yield frames.astype(np.float32), joint


def _agreement(
    sessions: tuple[Any, Any],
    graph: OnnxGraph,
    predictor: Predictor,
    recordings: Sequence[Recording],
    rest: float | None,
) -> Agreement:
    r"""Compares the answers of two sessions, on recordings or on random readings."""
    predictor = _copy(predictor)
    predictor.contact = None  # whose frames have no numbers
    pairs: Iterable[tuple[_Example, dict[str, np.ndarray]]]
    if recordings:
        pairs = (
            pair
            for recording in recordings
            for pair in _recorded_examples(graph, predictor, recording, rest)
        )
    else:
        drawn = _drawn_rest(graph, predictor)
        pairs = ((example, drawn) for example in _examples(graph, predictor, _NUM_RANDOM))
    answers = [[_answer(session, graph, *pair) for session in sessions] for pair in pairs]
    single, quantized = np.array(answers).swapaxes(0, 1)
    kind = "recordings" if recordings else "random"
    return compare_answers(single, quantized, predictor.network, kind)


def _recorded_examples(
    graph: OnnxGraph, predictor: Predictor, recording: Recording, rest: float | None
) -> Iterator[tuple[_Example, dict[str, np.ndarray]]]:
    r"""Yields the frames or windows of a recording, with what is measured of its session."""
    preparation = predictor.preparation
    recording = preparation.matched(recording)
    measured: dict[str, np.ndarray] = {}
    if graph.rest is not None:
        preparation.session.adapt_recording(recording, rest=rest)
        (part,) = preparation.session.parts
        assert part.center is not None
        measured["rest"] = part.center[-1].double().numpy()
        if graph.rest.has_scale:
            assert part.scale is not None
            measured["rest_scale"] = part.scale[-1].float().numpy()
    count, length = recording.num_frames, graph.length
    index = last = np.arange(count)
    if graph.window is not None:
        index = preparation.info.selected_frames(recording.time, count)
        last = preparation.matched_windows(recording)[1].numpy()
    tactile = recording.tactile.astype(np.float32)
    joint = None if not graph.num_joints else recording.joint
    for end in np.searchsorted(index, last).tolist():
        frames = index[end - length + 1 : end + 1]
        angles = None if joint is None else joint[frames].astype(np.float32)
        yield (tactile[frames], angles), measured


def _usual(predictor: Predictor, size: tuple[int, ...]) -> tuple[Any, Any]:
    # Centre and scale of the readings, as far as a transform has measured them.
    preparation = predictor.preparation
    center, scale = np.zeros(size), np.ones(size)
    for part in preparation.parts:
        if not isinstance(part, FittedTransform) or part.attr != "x" or part.center is None:
            continue
        assert part.scale is not None
        found = [value[0].numpy() for value in (part.center, part.scale)]
        rows = found[0].shape[-1]
        if rows == size[2] * size[0] and size[0] > 1:  # of windows, channel outer, time inner
            found = [value.reshape(-1, size[2], size[0]).mean(axis=-1) for value in found]
        if found[0].shape[-1] != size[2]:
            break
        center = center + found[0]
        if not part.unit_scale:
            return center, found[1] + np.zeros(size)
    return center, scale


def _reference(predictor: Predictor, graph: OnnxGraph, example: _Example, rest: Any) -> np.ndarray:
    r"""Returns what the predictor itself says, without the graph."""
    frames, joint = example
    if rest:
        given = {name: torch.from_numpy(value) for name, value in rest.items()}
        predictor.preparation.session.give(given["rest"], given.get("rest_scale"))
    if graph.window is None:
        angles = None if joint is None else torch.from_numpy(joint[0])
        return predictor(torch.from_numpy(frames[0]), angles).numpy()
    recording = Recording(time=np.arange(len(frames)) / 100, tactile=frames, joint=joint)
    return predictor.recording(recording)[-1].numpy()


def _answer(session: Any, graph: OnnxGraph, example: _Example, rest: Any) -> np.ndarray:
    r"""Returns what the exported graph says."""
    frames, joint = example
    feed: dict[str, np.ndarray] = dict(rest)
    if not graph.is_stepped:
        feed["tactile"] = frames if graph.window is None else frames[None]
        if joint is not None:
            feed["joint"] = joint if graph.joint_of_frames else joint[-1]
        first: np.ndarray = session.run(["probability"], feed)[0][0]
        return first
    for i, state in enumerate(graph.state):
        feed[f"state_{i}"] = state.numpy()
    names = [name for name in graph.output_names if name != "before_rest"]
    for i, frame in enumerate(frames):
        feed["tactile"] = frame[None]
        if joint is not None:
            feed["joint"] = joint[i]
        probability, *states = session.run(names, feed)
        feed |= {f"state_{j}": state for j, state in enumerate(states)}
    last: np.ndarray = probability[0]
    return last


def _largest_difference(session: Any, graph: OnnxGraph, predictor: Predictor) -> float:
    r"""Returns the largest difference between graph and predictor, infinite if one of them alone
    has no answer (NaN).
    """
    worst = 0.0
    for example in _examples(graph, predictor):
        rest = _drawn_rest(graph, predictor)
        expected = _reference(predictor, graph, example, rest)
        found = _answer(session, graph, example, rest)
        if found.shape != expected.shape or not np.array_equal(np.isnan(found), np.isnan(expected)):
            return float("inf")
        # Of the numbers of a regression, in units of the largest.
        unit = max(1.0, float(np.nanmax(np.abs(expected), initial=0.0)))
        difference = np.nanmax(np.abs(found - expected), initial=0.0)
        worst = max(worst, float(difference) / unit)
    return worst


def _drawn_rest(graph: OnnxGraph, predictor: Predictor) -> dict[str, np.ndarray]:
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
