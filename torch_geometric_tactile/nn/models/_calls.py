r"""How a network is called: one of ours, or one that is written for PyG's batches."""

import inspect
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.nn import MessagePassing

from torch_geometric_tactile.data import StaticData

_NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_KINDS = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@lru_cache(maxsize=256)
def _parameters(kind: Any) -> tuple[inspect.Parameter, ...]:
    # Those of `forward`, without the module itself.
    try:
        parameters = inspect.signature(kind.forward).parameters
    except (AttributeError, TypeError, ValueError):  # not written in Python
        return ()
    return tuple(parameters.values())[1:]


def _forward_parameters(model: Any) -> tuple[inspect.Parameter, ...]:
    model = getattr(model, "_orig_mod", model)  # of a compiled module
    kind: Any = model if isinstance(model, type) else type(model)
    return _parameters(kind)


def takes_batch(model: Any) -> bool:
    r"""Returns whether a network, or the class of one, is called with the sample of each taxel, as
    PyG's networks are: whether :obj:`forward` has an argument :obj:`batch`.
    """
    declared = getattr(model, "takes_batch", None)
    if declared is not None:
        return bool(declared)
    return any(parameter.name == "batch" for parameter in _forward_parameters(model))


def input_names(model: Any) -> tuple[str, ...]:
    r"""Returns the attributes that a network is given by keyword: those of its :obj:`modalities`,
    or if it has none, the arguments of :obj:`forward` behind the edges that have no default.
    """
    declared = getattr(model, "modalities", None)
    if declared is not None:
        return tuple(declared)
    further = [p for p in _forward_parameters(model) if p.kind in _NAMED][2:]
    return tuple(p.name for p in further if p.default is p.empty and p.name != "batch")


def _edge_parameter(model: Any) -> inspect.Parameter | None:
    # The second one: edges are given by position.
    positional = [p for p in _forward_parameters(model) if p.kind in _KINDS]
    return positional[1] if len(positional) > 1 else None


def _passes_messages(model: Any) -> bool:
    return any(isinstance(module, MessagePassing) for module in model.modules())


def needs_edges(model: Any) -> bool:
    r"""Returns whether a network cannot be called without edges: by its :obj:`needs_edges`, or if
    it does not say so, because it passes messages and the edges have no default.
    """
    declared = getattr(model, "needs_edges", None)
    if declared is not None:
        return bool(declared)
    edges = _edge_parameter(model)
    return edges is not None and edges.default is edges.empty and _passes_messages(model)


def is_graph_model(model: Any) -> bool:
    r"""Returns whether a network reads edges: it says so by :obj:`needs_edges`, or is given edges
    and passes messages.
    """
    if getattr(model, "needs_edges", False):
        return True
    return _edge_parameter(model) is not None and _passes_messages(model)


def call_model(model: Any, data: Data, inputs: Mapping[str, Any]) -> Tensor:
    r"""Returns the outputs of a network for samples :math:`(B, C)`. A network that takes
    :obj:`batch` gets static data as one PyG batch.

    Args:
        model (torch.nn.Module): The network.
        data (Data): The samples: static data, PyG's batch, or one sample.
        inputs (Mapping): The attributes of :obj:`data` that the network takes by keyword.
    """
    arguments = dict(inputs)
    if takes_batch(model):
        if isinstance(data, StaticData):
            is_one = data.num_samples == 1
            # An export stops at what keeps the edges of batches, which one sample does not need.
            data = data.sample(0) if is_one else data.to_batch()
            arguments = {name: data[name] for name in inputs}
            # So PyG names a single sample: its readouts take the number of samples from the values
            # of a vector, at which an export stops as well.
            arguments["batch"] = (
                None if is_one and torch.compiler.is_exporting() else batch_vector(data)
            )
        else:
            arguments["batch"] = batch_vector(data)
    out: Tensor = model(data.x, data.edge_index, **arguments)
    return out


def batch_vector(data: Data) -> Tensor:
    r"""Returns the number of the sample that each taxel belongs to, 0 for a single sample."""
    batch = getattr(data, "batch", None)
    if batch is None:
        assert data.x is not None
        batch = torch.zeros(len(data.x), dtype=torch.long, device=data.x.device)
    return batch
