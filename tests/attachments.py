"""What users attach to a convolution: wrapped and pruned weights, adapters and hooks.

Each function attaches one thing to one layer and notes in a list when it is called. It works on our
layers and on PyG's.
"""

import functools

import torch
from small_models import NUM_EDGES
from torch.nn.utils import parametrizations, prune, weight_norm

from torch_geometric_tactile.nn.conv import SegmentedGCNConv


class Adapter(torch.nn.Module):
    """A linear map with a correction of low rank, as LoRA has."""

    def __init__(self, base, calls):
        super().__init__()
        self.base, self.calls = base, calls
        generator = torch.Generator().manual_seed(1)
        width = base.weight.shape
        self.down = torch.nn.Parameter(torch.randn(2, width[1], generator=generator))
        self.up = torch.nn.Parameter(torch.randn(width[0], 2, generator=generator))

    def forward(self, x):
        self.calls.append("adapter")
        return self.base(x) + x @ self.down.to(x).t() @ self.up.to(x).t()


class Twice(torch.nn.Module):
    def forward(self, weight):
        return 2 * weight


def holder(conv):
    """The module with the weight."""
    return conv if isinstance(conv, SegmentedGCNConv) else conv.lin


def old_weight_norm(conv, calls):
    module = holder(conv)
    weight_norm(module, "weight")
    with torch.no_grad():
        module.weight_g.mul_(3)


def new_weight_norm(conv, calls):
    module = holder(conv)
    parametrizations.weight_norm(module, "weight")
    with torch.no_grad():
        module.parametrizations.weight.original0.mul_(3)


def spectral_norm(conv, calls):
    parametrizations.spectral_norm(holder(conv), "weight")


def parametrized(conv, calls):
    torch.nn.utils.parametrize.register_parametrization(holder(conv), "weight", Twice())


def parametrized_bias(conv, calls):
    torch.nn.utils.parametrize.register_parametrization(conv, "bias", Twice())


def pruned(conv, calls):
    prune.l1_unstructured(holder(conv), "weight", 0.6)


def adapter(conv, calls):
    conv.lin = Adapter(conv.lin, calls)


def noted(calls, name, change=None):
    def hook(*args):
        calls.append(name)
        return None if change is None else change(args)

    return hook


def plus_one(args):
    return args[-1] + 1


def forward_hook(conv, calls):
    conv.register_forward_hook(noted(calls, "conv", plus_one))


def forward_pre_hook(conv, calls):
    conv.register_forward_pre_hook(noted(calls, "conv", lambda a: (2 * a[1][0], *a[1][1:])))


def backward_hook(conv, calls):
    conv.register_full_backward_hook(noted(calls, "back", lambda a: (3 * a[1][0], *a[1][1:])))


def backward_pre_hook(conv, calls):
    conv.register_full_backward_pre_hook(noted(calls, "back", lambda a: (3 * a[1][0],)))


def linear_hook(conv, calls):
    conv.lin.register_forward_hook(noted(calls, "lin", plus_one))


def linear_pre_hook(conv, calls):
    conv.lin.register_forward_pre_hook(noted(calls, "lin", lambda a: (2 * a[1][0],)))


def linear_backward_hook(conv, calls):
    conv.lin.register_full_backward_hook(noted(calls, "back", lambda a: (3 * a[1][0],)))


def patched_linear(conv, calls):
    forward = conv.lin.forward

    def patched(x):
        calls.append("lin")
        return 2 * forward(x)

    conv.lin.forward = patched


def patched_forward(conv, calls):
    forward = conv.forward

    def patched(*args):
        calls.append("conv")
        return 2 * forward(*args)

    conv.forward = patched


def propagate_pre_hook(conv, calls):
    conv.register_propagate_forward_pre_hook(noted(calls, "propagate"))


def propagate_hook(conv, calls):
    conv.register_propagate_forward_hook(noted(calls, "propagate", plus_one))


def message_pre_hook(conv, calls):
    def double(args):
        return ({**args[1][0], "x_j": 2 * args[1][0]["x_j"]},)

    conv.register_message_forward_pre_hook(noted(calls, "message", double))


def message_hook(conv, calls):
    conv.register_message_forward_hook(noted(calls, "message", plus_one))


def aggregate_pre_hook(conv, calls):
    conv.register_aggregate_forward_pre_hook(noted(calls, "aggregate"))


def aggregate_hook(conv, calls):
    conv.register_aggregate_forward_hook(noted(calls, "aggregate", plus_one))


def aggregation_hook(conv, calls):
    conv.aggr_module.register_forward_hook(noted(calls, "aggregation", plus_one))


def patched_message(conv, calls):
    message = conv.message

    @functools.wraps(message)
    def patched(*args, **kwargs):
        calls.append("message")
        return 2 * message(*args, **kwargs)

    conv.message = patched


def explained(conv, calls):
    conv.explain = True
    conv._edge_mask = torch.linspace(0, 1, NUM_EDGES)
    conv._loop_mask = torch.ones(NUM_EDGES, dtype=torch.bool)
    conv._apply_sigmoid = False


ATTACHMENTS = {
    function.__name__: function
    for function in (
        old_weight_norm,
        new_weight_norm,
        spectral_norm,
        parametrized,
        parametrized_bias,
        pruned,
        adapter,
        forward_hook,
        forward_pre_hook,
        backward_hook,
        backward_pre_hook,
        linear_hook,
        linear_pre_hook,
        linear_backward_hook,
        patched_linear,
        patched_forward,
        propagate_pre_hook,
        propagate_hook,
        message_pre_hook,
        message_hook,
        aggregate_pre_hook,
        aggregate_hook,
        aggregation_hook,
        patched_message,
        explained,
    )
}
# Those that need the linear map of its own that a segmented convolution does not have.
OF_LINEAR = [name for name in ATTACHMENTS if "linear" in name or name == "adapter"]
# Those that only watch, or change gradients alone.
WITHOUT_EFFECT = [
    *(name for name in ATTACHMENTS if "backward" in name),
    "propagate_pre_hook",
    "aggregate_pre_hook",
]
