r"""Checks that nothing is attached to a layer, so that a faster implementation may replace its
operations.

Forward hooks, message hooks, pruned or reparametrised weights, and adapters that replace the linear
map must all take effect. Layers and models call these functions before they merge or reorder
operations.
"""

from typing import Any

import torch
from torch import Tensor
from torch.nn import Module
from torch.nn.modules import module as torch_module
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.aggr import SumAggregation
from torch_geometric.nn.dense.linear import Linear

# Methods that determine the messages and their aggregation.
MESSAGE_METHODS = ("propagate", "message", "aggregate", "message_and_aggregate", "update")
# Methods that users may replace on an instance. `propagate` is set on instances by PyG itself.
_INSTANCE_METHODS = MESSAGE_METHODS[1:]
# Neither PyTorch nor PyG has a public function that returns hooks. Layers check for hooks at each
# call, so the hooks are looked up in the dictionaries of the modules, which is faster than
# attribute access.
_MODULE_HOOKS = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
_MESSAGE_HOOKS = tuple(
    f"_{method}_forward{kind}"
    for method in ("propagate", "message", "aggregate", "message_and_aggregate")
    for kind in ("_pre_hooks", "_hooks")
)


def is_static_batch(x: Tensor) -> bool:
    r"""Returns whether features are a batch of samples on one topology that the CPU operations of
    this package support. Returns :obj:`False` while a compiler is recording.

    Shapes:
        - **x:** Node features, :math:`(B, N, F)` for :obj:`True`.
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
    r"""Returns whether a module has hooks or a :meth:`forward` that was set on the instance."""
    attributes = module.__dict__
    return any(map(attributes.get, _MODULE_HOOKS)) or "forward" in attributes


def has_global_hooks() -> bool:
    r"""Returns whether hooks are registered globally for all modules."""
    return bool(
        torch_module._global_forward_hooks
        or torch_module._global_forward_pre_hooks
        or torch_module._global_backward_hooks
        or torch_module._global_backward_pre_hooks
    )


def is_plain_linear(lin: Module) -> bool:
    r"""Returns whether a module is exactly PyG's linear map and has no hooks, so that products may
    be reordered around it.
    """
    return type(lin) is Linear and not is_hooked(lin) and not has_global_hooks()


def sums_messages(conv: MessagePassing) -> bool:
    r"""Returns whether a layer sums its messages and no hook, explainer or replaced method needs
    them.
    """
    attributes = conv.__dict__
    aggr_module: Any = conv.aggr_module
    return (
        not any(map(attributes.get, _MESSAGE_HOOKS))
        and not any(map(attributes.get, _INSTANCE_METHODS))
        and not conv.explain
        and conv.node_dim == -2
        and conv.decomposed_layers == 1
        and type(aggr_module) is SumAggregation
        and not is_hooked(aggr_module)
        and not has_global_hooks()
    )
