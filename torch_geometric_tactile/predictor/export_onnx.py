r"""A predictor as one ONNX graph, from raw readings to probabilities."""

import copy
import hashlib
import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from os import fspath
from typing import Any, NamedTuple

import torch

from torch_geometric_tactile import __version__
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.predictor._onnx_check import TOLERANCE, largest_difference
from torch_geometric_tactile.predictor._onnx_graph import OnnxGraph
from torch_geometric_tactile.predictor.content import Content
from torch_geometric_tactile.predictor.predictor import Predictor

#: The key of the metadata of a file, JSON.
_METADATA = "torch_geometric_tactile"
_FORMAT = 1
_OPSET = 18
_NO_DIGEST = "0" * 64
_EXTRAS = ("onnx", "onnxscript", "onnxruntime")


class Exported(NamedTuple):
    r"""What :func:`export_onnx` wrote."""

    num_bytes: int
    difference: float
    metadata: dict[str, Any]


def export_onnx(
    predictor: Predictor,
    path: PathLike,
    *,
    unit: str | None = None,
    num_channels: int | None = None,
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
    """
    _require_export()
    if unit not in (None, *UNITS):
        raise ValueError(f"'unit' must be one of {[*UNITS]} or None (got {unit!r})")
    graph = OnnxGraph(_copy(predictor), num_channels)
    program = _program(graph)
    program.ir_version = min(program.ir_version, 10)  # read by every runtime that we support
    checked = _copy(predictor)
    metadata = _describe(predictor, graph, unit)
    metadata["parity"] = None
    entry = program.metadata_props.add()
    entry.key = _METADATA
    session = _open_session(program.SerializeToString())
    difference = largest_difference(session, graph, checked)
    if not difference <= TOLERANCE:
        raise ValueError(
            f"the graph of {predictor!r} must give its numbers to {TOLERANCE:g} (got a difference "
            f"of {difference:.2g}): nothing was written"
        )
    metadata["parity"] = difference
    entry.value = json.dumps({**metadata, "sha256": _NO_DIGEST})
    content = _with_digest(program.SerializeToString())
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return Exported(len(content), difference, metadata)


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
    window, rest = graph.window, None
    if graph.rest is not None:
        part = graph.rest.part
        rest = {
            "transform": repr(part),
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
        "task": predictor.task,
        "class_names": list(predictor.class_names),
        "threshold": predictor.threshold,
        "layout": predictor.layout.name,
        "layout_content": predictor.layout.to_dict(),
        "num_taxels": predictor.layout.num_taxels,
        "num_channels": graph.num_channels,
        "num_joints": graph.num_joints,
        "joint_names": _joint_names(predictor),
        "joint_of_frames": graph.joint_of_frames,
        "unit": unit,
        "window": None if window is None else window.to_dict(),
        "is_stepped": graph.is_stepped,
        "rest": rest,
    }


def _joint_names(predictor: Predictor) -> list[str] | None:
    preparation = predictor.preparation
    for part in (*preparation._frame_parts, *preparation._parts):
        hand = getattr(part, "kinematics", None)
        if hand is not None:
            return list(hand.joint_names)
    return None


def _copy(predictor: Predictor) -> Predictor:
    # In single precision on the processor; what a trace leaves in caches stays in the copy.
    preparation = copy.deepcopy(predictor.preparation)
    model = copy.deepcopy(predictor.model).float()
    names, task = predictor.class_names, predictor.task
    out = Predictor._of(Content(preparation, model, names, task, predictor.threshold))
    return out.to("cpu")


def _program(graph: OnnxGraph) -> Any:
    inputs = [*graph.blank().values(), *graph.state]
    graph.requires_grad_(False)
    try:
        with torch.no_grad(), _quiet():
            graph(*inputs)  # fills what layers keep, so that it is constant
            program = torch.onnx.export(
                graph,
                tuple(inputs),
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
