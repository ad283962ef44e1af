r"""Simulation of dead taxels."""

from collections.abc import Callable, Sequence, Set

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._dead_taxels import DeadTaxels


@functional_transform("drop_taxels")
class DropTaxels(DeadTaxels):
    r"""Simulates dead taxels (functional name: :obj:`drop_taxels`). Their readings are set to a
    value, and the taxels are marked as :obj:`dropped`.

    Args:
        p (float, optional): Probability with which each taxel of each sample is dropped. The
            default is 0.1 if :obj:`taxels` is left out as well.
        taxels (sequence of int, optional): The taxels to drop in every sample, in place of
            :obj:`p`.
        value (float): The reading of a dead taxel. Use NaN for a missing reading.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, and booleans :obj:`dropped` :math:`(N,)`, :math:`(B, N)` or
          :math:`(B \cdot N,)`, which include taxels that are already marked

    Raises:
        ValueError: If :obj:`p` is not a probability, both :obj:`p` and :obj:`taxels` are given, a
            sample has no such taxel, or there are no readings.

    Examples:
        >>> data = DropTaxels(taxels=[1])(Data(x=torch.ones(3, 1)))
        >>> data.x.view(-1), data.dropped
        (tensor([1., 0., 1.]), tensor([False,  True, False]))
    """

    def __init__(
        self,
        p: float | None = None,
        taxels: Sequence[int] | Tensor | None = None,
        value: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(p, taxels, "taxels", value, generator)
        self.taxels: Tensor | None = None
        if taxels is not None:
            index = torch.as_tensor(taxels).cpu()
            is_integer = not (index.is_floating_point() or index.is_complex())
            if index.dim() != 1 or (len(index) and (not is_integer or index.dtype == torch.bool)):
                raise ValueError(f"'taxels' must be a list of indices (got {taxels})")
            self.taxels = index.long().unique()
            if len(index) and int(self.taxels[0]) < 0:
                raise ValueError(f"'taxels' must be numbered from 0 (got {int(self.taxels[0])})")

    def dead(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns which taxels are dropped."""
        if self.taxels is None:
            return self.draw(x.shape[:-1].numel(), x).view(x.shape[:-1])
        is_dead = torch.zeros(x.shape[:-1], dtype=torch.bool, device=x.device)
        taxels = self.taxels.to(x.device)
        if len(taxels) == 0:
            return is_dead
        last = int(self.taxels[-1])
        # The samples of a PyG batch may have different numbers of taxels.
        num_taxels = int(data.ptr.diff().min()) if isinstance(data, Batch) else x.size(-2)
        need(last < num_taxels, f"'taxels' must be below {num_taxels}", last)
        if isinstance(data, Batch):
            is_dead[(data.ptr[:-1, None] + taxels).view(-1)] = True
        else:
            is_dead[..., taxels] = True
        return is_dead

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a step with a fixed mask of the dead taxels, or this transform itself if the
        taxels are drawn at random.
        """
        return self if self.is_random else _DropStep(self, constants)

    def __repr__(self) -> str:
        selection = f"p={self.p}" if self.taxels is None else f"taxels={self.taxels.tolist()}"
        return f"{type(self).__name__}({selection}, value={self.value})"


class _DropStep:
    r"""The step of :class:`DropTaxels` in an exported graph, with the same taxels in all frames."""

    def __init__(self, part: DropTaxels, constants: StaticData) -> None:
        self.value = part.value
        self.is_dead = part.dead(constants, constants.x)[0]

    def __call__(self, data: StaticData) -> StaticData:
        data.x = data.x.masked_fill(self.is_dead.unsqueeze(-1), self.value)
        old_mark = getattr(data, "dropped", None)
        data.dropped = self.is_dead if old_mark is None else self.is_dead | old_mark.bool()
        return data
