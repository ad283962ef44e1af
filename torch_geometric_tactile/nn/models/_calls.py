r"""Calls networks from this package and from users with the inputs that they declare."""

import inspect
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.nn import MessagePassing

from torch_geometric_tactile.data import StaticData

_KEYWORD_KINDS = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_POSITIONAL_KINDS = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@lru_cache(maxsize=256)
def _class_parameters(cls: Any) -> tuple[inspect.Parameter, ...]:
    # Returns the parameters of `forward` without `self`.
    try:
        parameters = inspect.signature(cls.forward).parameters
    except (AttributeError, TypeError, ValueError):  # not written in Python
        return ()
    return tuple(parameters.values())[1:]


def _forward_parameters(model: Any) -> tuple[inspect.Parameter, ...]:
    model = getattr(model, "_orig_mod", model)  # the original of a compiled module
    cls: Any = model if isinstance(model, type) else type(model)
    return _class_parameters(cls)


def takes_batch(model: Any) -> bool:
    r"""Returns whether a network or class takes the sample index of each taxel, as PyG's networks
    do. This is the value of the attribute :obj:`takes_batch`. Without this attribute, a network
    takes the sample index if :obj:`forward` has an argument :obj:`batch`.
    """
    declared = getattr(model, "takes_batch", None)
    if declared is not None:
        return bool(declared)
    return any(parameter.name == "batch" for parameter in _forward_parameters(model))


def input_names(model: Any) -> tuple[str, ...]:
    r"""Returns the names of the attributes that are passed to a network by keyword. These are its
    :obj:`modalities`. Without this attribute, they are the arguments of :obj:`forward` that follow
    readings and edges and have no default.
    """
    declared = getattr(model, "modalities", None)
    if declared is not None:
        return tuple(declared)
    named_parameters = [p for p in _forward_parameters(model) if p.kind in _KEYWORD_KINDS]
    return tuple(p.name for p in named_parameters[2:] if p.default is p.empty and p.name != "batch")


def _edge_parameter(model: Any) -> inspect.Parameter | None:
    # Readings and edges are passed by position, so the edges are the second positional parameter.
    positional = [p for p in _forward_parameters(model) if p.kind in _POSITIONAL_KINDS]
    return positional[1] if len(positional) > 1 else None


def _passes_messages(model: Any) -> bool:
    return any(isinstance(module, MessagePassing) for module in model.modules())


def needs_edges(model: Any) -> bool:
    r"""Returns whether a network requires edges. This is the value of the attribute
    :obj:`needs_edges`. Without this attribute, a network requires edges if it passes messages and
    its argument for edges has no default.
    """
    declared = getattr(model, "needs_edges", None)
    if declared is not None:
        return bool(declared)
    edges = _edge_parameter(model)
    return edges is not None and edges.default is edges.empty and _passes_messages(model)


def is_graph_model(model: Any) -> bool:
    r"""Returns whether a network uses edges. It does if its attribute :obj:`needs_edges` is true,
    or if it has an argument for edges and passes messages.
    """
    if getattr(model, "needs_edges", False):
        return True
    return _edge_parameter(model) is not None and _passes_messages(model)


def call_model(model: Any, data: Data, inputs: Mapping[str, Any]) -> Tensor:
    r"""Returns the output of a network :math:`(B, C)` for samples. Static data are converted to a
    PyG batch if the network takes :obj:`batch`.

    Args:
        model (torch.nn.Module): The network.
        data (Data): Samples, as static data, a PyG batch or a single sample.
        inputs (Mapping): Attributes of :obj:`data` that the network takes by keyword.
    """
    arguments = dict(inputs)
    if takes_batch(model):
        if isinstance(data, StaticData):
            is_single = data.num_samples == 1
            # The cache of batched edges cannot be exported, and a single sample does not need it.
            data = data.sample(0) if is_single else data.to_batch()
            arguments = {name: data[name] for name in inputs}
            # If `batch` is a vector, PyG's readouts compute the number of samples from its values,
            # which cannot be exported. For a single sample, PyG passes None.
            arguments["batch"] = (
                None if is_single and torch.compiler.is_exporting() else batch_vector(data)
            )
        else:
            arguments["batch"] = batch_vector(data)
    out: Tensor = model(data.x, data.edge_index, **arguments)
    return out


def batch_vector(data: Data) -> Tensor:
    r"""Returns the sample index of each taxel :math:`(B \cdot N,)`, which is zero for a single
    sample.
    """
    batch = getattr(data, "batch", None)
    if batch is None:
        assert data.x is not None
        batch = torch.zeros(len(data.x), dtype=torch.long, device=data.x.device)
    return batch
