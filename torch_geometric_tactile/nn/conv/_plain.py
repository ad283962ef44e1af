r"""Tells where a shorter way to the same numbers would pass by what is attached to a layer.

A forward hook, a pruned or reparametrised weight, an adapter in place of the linear map, a hook on
the messages: each has to see what it was attached for. Layers and models ask here before they merge
or reorder operations.
"""

from typing import Any

import torch
from torch import Tensor
from torch.nn import Module
from torch.nn.modules import module as torch_module
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.aggr import SumAggregation
from torch_geometric.nn.dense.linear import Linear

# Methods that decide what is passed along an edge.
MESSAGE_METHODS = ("propagate", "message", "aggregate", "message_and_aggregate", "update")
# What may be set on one instance; `propagate` is not among them: PyG itself sets it there.
_PATCHED = MESSAGE_METHODS[1:]
# Neither PyTorch nor PyG has a public way to ask for hooks. Looked up in the dictionaries of the
# modules, since a layer asks at each call.
_MODULE_HOOKS = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
_MESSAGE_HOOKS = tuple(
    f"_{method}_forward{kind}"
    for method in ("propagate", "message", "aggregate", "message_and_aggregate")
    for kind in ("_pre_hooks", "_hooks")
)


def is_static_batch(x: Tensor) -> bool:
    r"""Tells whether features are those of samples on one topology on a processor, of a kind that
    own operations are made for; never while a compiler records.
    """
    return (
        not torch.compiler.is_compiling()  # first: an export must not depend on the batch size
        and not torch.jit.is_tracing()
        and x.dim() == 3
        and x.size(0) > 0
        and x.device.type == "cpu"
        and x.dtype in (torch.float32, torch.float64)
    )


def is_hooked(module: Module) -> bool:
    r"""Tells whether calling a module does more than run its :meth:`forward`."""
    own = module.__dict__
    return any(map(own.get, _MODULE_HOOKS)) or "forward" in own


def any_global_hook() -> bool:
    r"""Tells whether hooks are registered on all modules at once."""
    return bool(
        torch_module._global_forward_hooks
        or torch_module._global_forward_pre_hooks
        or torch_module._global_backward_hooks
        or torch_module._global_backward_pre_hooks
    )


def is_plain_linear(lin: Module) -> bool:
    r"""Tells whether a module is PyG's linear map and nothing else, so that products may change
    their order around it.
    """
    return type(lin) is Linear and not is_hooked(lin) and not any_global_hook()


def sums_messages(conv: MessagePassing) -> bool:
    r"""Tells whether a layer adds up its messages, and nothing asks to see them."""
    own = conv.__dict__
    aggr_module: Any = conv.aggr_module
    return (
        not any(map(own.get, _MESSAGE_HOOKS))
        and not any(map(own.get, _PATCHED))
        and not conv.explain
        and conv.node_dim == -2
        and conv.decomposed_layers == 1
        and type(aggr_module) is SumAggregation
        and not is_hooked(aggr_module)
        and not any_global_hook()
    )
