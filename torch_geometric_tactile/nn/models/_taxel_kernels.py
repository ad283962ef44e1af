r"""Convolutions whose weight of a neighbour is a function of its place: they run on any layout."""

import math
from collections.abc import Callable
from typing import Optional

import torch
from torch import Tensor
from torch.nn import GELU, LayerNorm, Linear, Module, Sequential
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._edge_cache import KeptTensor
from torch_geometric_tactile.nn.conv._edge_checks import Forgetful, is_traced
from torch_geometric_tactile.nn.conv._plain import any_global_hook, is_hooked
from torch_geometric_tactile.nn.models._taxel_levels import pooled_layouts
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._described import in_extents

_REACH = 2.2  # in pitches: 12 neighbours on a grid, 18 on a hexagonal layout
_NEAREST = 4  # taxels whose distances make the pitch
_KERNEL = 32  # width of the function of the place
_WAVES = (1, 2, 3)
PLACE = 3 + 2 * len(_WAVES)
_LEAST_SEEN = 0.1  # of a neighbourhood, below which what is seen is not blown up further


class Neighbourhood(Module):
    r"""The taxels of one layout around those of another of the same links; :obj:`zoom` times the
    pitch of the target is the unit.

    Shapes:
        - **index:** numbers of pairs in a matrix :math:`(M \cdot N)` :math:`(P,)`
        - **offset:** from each target, in its own frame :math:`(P, 3)`
        - **share:** part of each neighbour in its neighbourhood :math:`(M, N)`
    """

    index: Tensor
    offset: Tensor
    share: Tensor

    def __init__(self, target: TaxelLayout, source: TaxelLayout, zoom: float = 1.0) -> None:
        super().__init__()
        with torch.device("cpu"):  # on the meta device, places would lose their numbers
            pitch = zoom * _pitches(target)
            off = source.pos.double() - target.pos.double().unsqueeze(1)
            off = torch.einsum("mad,mnd->mna", target.axes(torch.double), off)
            off = off / pitch[:, None, None]
            far = torch.where(_are_of_one_link(target, source), off.norm(dim=-1), torch.inf)
            near = (far < _REACH) | ((far == far.amin(dim=1, keepdim=True)) & far.isfinite())
            window = torch.where(near, (1 - (far / _REACH).square()).clamp(min=0.05), 0.0)
            share = window / window.sum(dim=1, keepdim=True).clamp(min=1e-9)
            index = near.flatten().nonzero().squeeze(1)
            offset = off.flatten(0, 1)[index].clamp(-_REACH, _REACH)
        # Not in the state: they follow from the layouts.
        self.register_buffer("index", index, persistent=False)
        self.register_buffer("offset", offset.float(), persistent=False)
        self.register_buffer("share", share.float(), persistent=False)


def places(layout: TaxelLayout, whole: TaxelLayout) -> Tensor:
    r"""Returns where taxels are on the whole layout: their places on the link, in units of the
    largest extent, and waves over the numbers of the links, whose frames say nothing of each other.
    """
    assert layout.link is not None
    angle = 2 * math.pi * layout.link.double() / len(whole.link_names)
    waves = [wave for k in _WAVES for wave in ((k * angle).cos(), (k * angle).sin())]
    of_link = torch.stack(waves, dim=1) if len(whole.link_names) > 1 else torch.zeros(1, 1)
    pos = in_extents(layout.pos.double(), whole.pos.double())
    return torch.cat([pos, of_link.expand(len(pos), 2 * len(_WAVES))], dim=1).float()


def coarse_layout(layout: TaxelLayout, max_taxels: int) -> TaxelLayout:
    r"""Returns the layout, or one of joined taxels that has at most so many if it can."""
    pools = pooled_layouts(layout, max_taxels)
    return pools[-1].coarse if pools else layout


def _are_of_one_link(target: TaxelLayout, source: TaxelLayout) -> Tensor:
    assert target.link is not None
    assert source.link is not None
    return target.link.unsqueeze(1) == source.link


def _pitches(layout: TaxelLayout) -> Tensor:
    # The median distance of a taxel to its nearest ones; that of all for one that is alone.
    pos = layout.pos.double()
    far = torch.where(_are_of_one_link(layout, layout), torch.cdist(pos, pos), torch.inf)
    far.fill_diagonal_(torch.inf)
    near = far.sort(dim=1).values[:, :_NEAREST]
    own = torch.where(near.isfinite() & (near > 0), near, torch.nan).nanmedian(dim=1).values
    usual = own.nanmedian() if own.isfinite().any() else own.new_tensor(1.0)
    return torch.where(own.isfinite(), own, usual)


class KernelConv(Module):
    r"""Weights each neighbour and channel by a function of the neighbour's place in the frame of
    the taxel, and adds up.

    .. math::
        \mathbf{x}'_i = \sum_j a_{ij} \,
        \mathbf{w}(\mathbf{R}_i (\mathbf{p}_j - \mathbf{p}_i) / d_i) \odot \mathbf{x}_j

    with the shares :math:`a_{ij}` of a neighbourhood, the frame :math:`\mathbf{R}_i` and the pitch
    :math:`d_i`. Taxels that are not seen leave their shares to the others.

    Shapes:
        - **input:** features :math:`(B, N, F)`, and which are seen :math:`(B, N)`
        - **output:** :math:`(B, M, F)`
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.place = Sequential(Linear(3, _KERNEL), GELU(), Linear(_KERNEL, channels))
        self._kept = _KernelCache()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        reset(self.place)

    def kernel(self, near: Neighbourhood) -> Tensor:
        r"""Returns the weight of each taxel :math:`(F, M, N)`, which follows from layout and
        weights alone, and is kept where nothing is trained.
        """
        if self._may_keep(near):
            return self._kept.get(near, self.place, self._kernel)
        return self._kernel(near)

    def _kernel(self, near: Neighbourhood) -> Tensor:
        found = self.place(near.offset).t()
        whole = found.new_zeros(self.channels, near.share.numel())
        whole = whole.index_copy(1, near.index, found)
        return whole.view(self.channels, *near.share.shape) * near.share

    def _may_keep(self, near: Neighbourhood) -> bool:
        return (
            not torch.is_grad_enabled()
            and not is_traced()
            and near.share.device.type == "cpu"
            and not any_global_hook()
            and not any(map(is_hooked, self.place.modules()))
        )

    def forward(self, x: Tensor, near: Neighbourhood, seen: OptTensor = None) -> Tensor:
        r"""Convolves features."""
        out = torch.einsum("fmn,bnf->bmf", self.kernel(near), x)
        if seen is None:
            return out
        part = seen.to(x.dtype) @ near.share.t()
        return out / part.clamp(min=_LEAST_SEEN).unsqueeze(-1)


class _KernelCache(Forgetful):
    # The last kernel, for as long as the same numbers make it.
    def __init__(self) -> None:
        self._entry: Optional[tuple[Neighbourhood, list[KeptTensor], Tensor]] = None

    def get(
        self, near: Neighbourhood, place: Module, make: Callable[[Neighbourhood], Tensor]
    ) -> Tensor:
        numbers = [t.detach() for t in (near.share, *place.parameters(), *place.buffers())]
        entry = self._entry
        if (
            entry is None
            or entry[0] is not near
            or len(entry[1]) != len(numbers)
            or not all(kept.equals(t) for kept, t in zip(entry[1], numbers, strict=True))
        ):
            with torch.inference_mode(False), torch.no_grad():
                entry = (near, [KeptTensor(t) for t in numbers], make(near))
            self._entry = entry  # as a whole: threads may share it
        return entry[2]


class KernelBlock(Module):
    r"""A convolution, normalisation of each taxel's features, and two layers, added to what came
    in.

    Shapes:
        - **input:** features :math:`(B, N, F)`
        - **output:** likewise
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = KernelConv(channels)
        self.norm = LayerNorm(channels)
        self.lins = Sequential(
            Linear(channels, 2 * channels), GELU(), Linear(2 * channels, channels)
        )

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        for part in (self.conv, self.norm, self.lins):
            reset(part)

    def forward(self, x: Tensor, near: Neighbourhood) -> Tensor:
        r"""Convolves features."""
        out: Tensor = x + self.lins(self.norm(self.conv(x, near)))
        return out
