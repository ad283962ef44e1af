r"""What models are given besides readings, and features of several inputs side by side."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._calls import input_names, needs_edges

# What gives a sample the attributes that models ask for.
_SOURCES = {
    "edge_attr": "add GeometricEdgeAttr() to the transform",
    "absolute": "add AbsoluteMorphology() to the transform",
    "pos": "add TaxelPose() to the transform",
    "normal": "add TaxelPose() to the transform",
}


def needed_inputs(
    model: Any, data: Any, there: Callable[[], str], **sources: str
) -> dict[str, Any]:
    r"""Returns the attributes of samples that a model takes by keyword. Of a missing one, and of
    edges, an error says what the samples have and where it comes from.
    """
    inputs = {name: getattr(data, name, None) for name in input_names(model)}
    lacking = [name for name, value in inputs.items() if value is None]
    if data.edge_index is None and needs_edges(model):
        lacking.insert(0, "edge_index")
    if lacking:
        source = {**_SOURCES, **sources}.get(lacking[0], "add a transform that sets it")
        raise ValueError(f"the model needs '{lacking[0]}' ({there()}): {source}")
    return inputs


def with_joints(rows: Tensor, joint: OptTensor, num_joints: int) -> Tensor:
    r"""Returns the features of each sample with its joint angles.

    Shapes:
        - **rows:** Features of each sample :math:`(B, F)`.
        - **joint:** Joint angles in radians :math:`(B, J)`.
        - **num_joints:** Number of joint angles :math:`J`; with 0, features stay as they are.
    """
    if num_joints == 0:
        return rows
    if joint is None:
        raise ValueError(f"'joint' must be given: the model has num_joints={num_joints} (got None)")
    # Not `len`: an export would take it for a constant.
    if joint.numel() != rows.size(0) * num_joints or joint.size(-1) != num_joints:
        raise ValueError(
            f"'joint' must have shape ({rows.size(0)}, {num_joints}) (got {tuple(joint.shape)})"
        )
    return torch.cat([rows, joint.view(-1, num_joints).to(rows.dtype)], dim=1)


def side_by_side(parts: Mapping[str, Tensor]) -> Tensor:
    r"""Returns the features of several inputs or threads as one.

    Shapes:
        - **parts:** The features by name :math:`(B, N, F_m)`.
    """
    values = list(parts.values())
    return values[0] if len(values) == 1 else torch.cat(values, dim=-1)


def check_no_edges(inputs: Sequence[str]) -> None:
    r"""Checks the inputs of a model without a graph."""
    if "edge" in inputs:
        raise ValueError(f"'inputs' must not have 'edge': there is no graph (got {tuple(inputs)})")


def weight_like(edge_weight: OptTensor, x: Tensor) -> OptTensor:
    r"""Returns edge weights in the precision of the node features, in which several layers
    compute.
    """
    if edge_weight is None or not edge_weight.is_floating_point():
        return edge_weight
    return edge_weight.to(x.dtype)


def given_edges(edge_index: OptTensor) -> Tensor:
    r"""Returns edges, which a graph convolution needs."""
    if edge_index is None:
        raise ValueError(
            "'edge_index' must be given (got None): the samples need edges, of an adjacency of the "
            "layout or of the transform KNNGraph"
        )
    return edge_index
