r"""Looks up, checks and concatenates inputs of models other than readings."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._calls import input_names, needs_edges

# Advice on how to add missing attributes to samples.
_ADVICE = {
    "edge_attr": "add GeometricEdgeAttr() to the transform",
    "absolute": "add AbsoluteMorphology() to the transform",
    "pos": "add TaxelPose() to the transform",
    "normal": "add TaxelPose() to the transform",
}


def needed_inputs(
    model: Any, data: Any, describe_data: Callable[[], str], **advice: str
) -> dict[str, Any]:
    r"""Returns the attributes of samples that are passed to a model by keyword.

    Args:
        model (torch.nn.Module): The model.
        data (Data): Samples.
        describe_data (callable): Returns a description of the samples for the error message.
        **advice: Advice for the error message, by name of the missing attribute.

    Raises:
        ValueError: If an attribute is missing, or if the model needs edges and there are none.
    """
    inputs = {name: getattr(data, name, None) for name in input_names(model)}
    missing = [name for name, value in inputs.items() if value is None]
    if data.edge_index is None and needs_edges(model):
        missing.insert(0, "edge_index")
    if missing:
        hint = {**_ADVICE, **advice}.get(missing[0], "add a transform that sets it")
        raise ValueError(f"the model needs '{missing[0]}' ({describe_data()}): {hint}")
    return inputs


def with_joints(rows: Tensor, joint: OptTensor, num_joints: int) -> Tensor:
    r"""Returns the features of each sample followed by its joint angles :math:`(B, F + J)`.

    Shapes:
        - **rows:** Features of each sample :math:`(B, F)`.
        - **joint:** Joint angles in radians :math:`(B, J)`.
        - **num_joints:** Number of joint angles :math:`J`. If it is 0, the features are returned
          unchanged.

    Raises:
        ValueError: If joint angles are missing or have the wrong shape.
    """
    if num_joints == 0:
        return rows
    if joint is None:
        raise ValueError(f"'joint' must be given: the model has num_joints={num_joints} (got None)")
    # An export would record `len` as a constant.
    if joint.numel() != rows.size(0) * num_joints or joint.size(-1) != num_joints:
        raise ValueError(
            f"'joint' must have shape ({rows.size(0)}, {num_joints}) (got {tuple(joint.shape)})"
        )
    return torch.cat([rows, joint.view(-1, num_joints).to(rows.dtype)], dim=1)


def concatenate_inputs(parts: Mapping[str, Tensor]) -> Tensor:
    r"""Returns the concatenated features of several inputs or threads
    :math:`(B, N, \sum_m F_m)`.

    Shapes:
        - **parts:** Features by name :math:`(B, N, F_m)`.
    """
    features = list(parts.values())
    return features[0] if len(features) == 1 else torch.cat(features, dim=-1)


def check_no_edges(inputs: Sequence[str]) -> None:
    r"""Checks that the inputs of a model without a graph do not include edge features."""
    if "edge" in inputs:
        raise ValueError(
            f"'inputs' must not have 'edge', since the model has no graph (got {tuple(inputs)})"
        )


def weight_like(edge_weight: OptTensor, x: Tensor) -> OptTensor:
    r"""Returns edge weights in the data type of the node features, so that all layers of a thread
    use the same type.
    """
    if edge_weight is None or not edge_weight.is_floating_point():
        return edge_weight
    return edge_weight.to(x.dtype)


def required_edges(edge_index: OptTensor) -> Tensor:
    r"""Returns edges that must not be :obj:`None`.

    Raises:
        ValueError: If there are no edges.
    """
    if edge_index is None:
        raise ValueError(
            "'edge_index' must be given (got None): add edges to the samples, with an adjacency of "
            "the layout or the transform KNNGraph"
        )
    return edge_index
