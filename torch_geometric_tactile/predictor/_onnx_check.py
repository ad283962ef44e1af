r"""Whether an exported graph gives the numbers of its predictor."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.predictor._onnx_graph import OnnxGraph
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.transforms import FittedTransform

TOLERANCE = 1e-5
_SEED = 0

Example = tuple[np.ndarray, np.ndarray | None]  # frames (T, N, C) and angles (T, J)


def examples(graph: OnnxGraph, predictor: Predictor, count: int = 4) -> Iterator[Example]:
    r"""Yields frames like those that the predictor was fitted on, and others: hardly touched,
    one taxel without a reading, and many.
    """
    draw = np.random.default_rng(_SEED)
    size = (graph.length, graph.layout.num_taxels, graph.num_channels)
    center, scale = _usual(predictor, size)
    joints = (graph.length, graph.num_joints)
    for i in range(count + 3):
        frames = center + (1 + i) / 2 * scale * draw.standard_normal(size)
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


def _usual(predictor: Predictor, size: tuple[int, ...]) -> tuple[Any, Any]:
    # Centre and scale of the readings, as far as a transform has measured them.
    preparation = predictor.preparation
    center, scale = np.zeros(size), np.ones(size)
    for part in (*preparation._frame_parts, *preparation._parts):
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


def reference(predictor: Predictor, graph: OnnxGraph, example: Example, rest: Any) -> np.ndarray:
    r"""Returns what the predictor itself says, without the graph."""
    frames, joint = example
    if rest:
        _set_rest(predictor, rest)
    if graph.window is None:
        angles = None if joint is None else torch.from_numpy(joint[0])
        return predictor(torch.from_numpy(frames[0]), angles).numpy()
    recording = Recording(time=np.arange(len(frames)) / 100, tactile=frames, joint=joint)
    return predictor.recording(recording)[-1].numpy()


def _set_rest(predictor: Predictor, rest: dict[str, np.ndarray]) -> None:
    (part,) = (part for part in predictor.preparation.fitted if part.key is not None)
    center = torch.from_numpy(rest["rest"]).unsqueeze(0)
    scale = torch.from_numpy(rest["rest_scale"]) if "rest_scale" in rest else None
    part.center = center
    part.scale = torch.ones_like(center).float() if scale is None else scale.unsqueeze(0)
    part.key_values = torch.zeros(1, dtype=torch.long)
    predictor.preparation.session = 0


def answer(session: Any, graph: OnnxGraph, example: Example, rest: Any) -> np.ndarray:
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


def largest_difference(session: Any, graph: OnnxGraph, predictor: Predictor) -> float:
    r"""Returns the largest difference between graph and predictor, infinite if one of them alone
    has no answer (NaN).
    """
    worst = 0.0
    for example in examples(graph, predictor):
        rest = _drawn_rest(graph, predictor)
        expected = reference(predictor, graph, example, rest)
        found = answer(session, graph, example, rest)
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
