r"""Tells where a shorter way to the same numbers would pass by what is attached to a layer.

A forward hook, a pruned or reparametrised weight, an adapter in place of the linear map, a hook on
the messages: each has to see what it was attached for. Layers and models ask here before they merge
or reorder operations.
"""

from torch.nn import Module
from torch.nn.modules import module as torch_module
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.aggr import SumAggregation
from torch_geometric.nn.dense.linear import Linear

# Methods that decide what is passed along an edge.
MESSAGE_METHODS = ("propagate", "message", "aggregate", "message_and_aggregate", "update")
# What may be set on one instance; `propagate` is not among them: PyG itself sets it there.
_PATCHED = frozenset(MESSAGE_METHODS[1:])


def is_hooked(module: Module) -> bool:
    r"""Tells whether calling a module does more than run its :meth:`forward`.

    Args:
        module (torch.nn.Module): The module.
    """
    # PyTorch has no public way to ask for hooks.
    return bool(
        module._forward_hooks
        or module._forward_pre_hooks
        or module._backward_hooks
        or module._backward_pre_hooks
        or "forward" in module.__dict__
    )


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

    Args:
        lin (torch.nn.Module): The module.
    """
    return type(lin) is Linear and not is_hooked(lin) and not any_global_hook()


def sums_messages(conv: MessagePassing) -> bool:
    r"""Tells whether a layer adds up its messages, and nothing asks to see them.

    Args:
        conv (MessagePassing): The layer.
    """
    # PyG has no public way to ask for hooks either.
    return not (
        conv.explain
        or conv.node_dim != -2
        or conv.decomposed_layers != 1
        or type(conv.aggr_module) is not SumAggregation
        or is_hooked(conv.aggr_module)
        or any_global_hook()
        or conv._propagate_forward_pre_hooks
        or conv._propagate_forward_hooks
        or conv._message_forward_pre_hooks
        or conv._message_forward_hooks
        or conv._aggregate_forward_pre_hooks
        or conv._aggregate_forward_hooks
        or conv._message_and_aggregate_forward_pre_hooks
        or conv._message_and_aggregate_forward_hooks
        or not _PATCHED.isdisjoint(conv.__dict__)
    )
