r"""Simulation of dead patches."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.transforms._attributes import check_num_taxels
from torch_geometric_tactile.transforms._dead_taxels import DeadTaxels


@functional_transform("drop_patches")
class DropPatches(DeadTaxels):
    r"""Simulates dead patches, for example behind a broken cable (functional name:
    :obj:`drop_patches`). The readings of all taxels of a dead patch are set to a value, and the
    taxels are marked as :obj:`dropped`.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels and their patches: a layout, the name of
            a layout of this package, or a layout file.
        p (float, optional): Probability with which each patch of each sample is dropped. The
            default is 0.1 if :obj:`patches` is left out as well.
        patches (sequence of int or str, optional): Numbers or names of the patches to drop in every
            sample, in place of :obj:`p`.
        value (float): The reading of a dead taxel. Use NaN for a missing reading.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, and booleans :obj:`dropped` :math:`(N,)`, :math:`(B, N)` or
          :math:`(B \cdot N,)`, which include taxels that are already marked

    Raises:
        ValueError: If :obj:`p` is not a probability, both :obj:`p` and :obj:`patches` are given,
            the layout has no such patch, or a sample has the wrong number of taxels.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> data = DropPatches(allegro_uskin(), patches=[0, 3])(Data(x=torch.ones(384, 3)))
        >>> int(data.dropped.sum())
        40
    """

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        p: float | None = None,
        patches: Sequence[int | str] | Tensor | None = None,
        value: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(p, patches, "patches", value, generator)
        self.layout = as_layout(layout)
        self.patches = None if patches is None else self._patch_numbers(patches)

    def _patch_numbers(self, patches: Sequence[int | str] | Tensor) -> list[int]:
        if isinstance(patches, str):
            raise ValueError(f"'patches' must be a list of numbers or names (got '{patches}')")
        names = self.layout.patch_names
        numbers = set()
        for patch in patches:
            if isinstance(patch, str):
                if patch not in names:
                    raise ValueError(
                        f"'patches' must name patches of layout '{self.layout.name}': "
                        f"{', '.join(names)} (got '{patch}')"
                    )
                numbers.add(names.index(patch))
            elif isinstance(patch, bool | float) or not 0 <= int(patch) < len(names):
                raise ValueError(f"'patches' must be 0 to {len(names) - 1} (got {patch})")
            else:
                numbers.add(int(patch))
        return sorted(numbers)

    def dead(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns which taxels are dropped."""
        num_taxels, num_patches = self.layout.num_taxels, len(self.layout.patch_names)
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        num_samples = x.shape[:-1].numel() // num_taxels
        if self.patches is None:
            is_dropped = self.draw(num_samples * num_patches, x).view(num_samples, num_patches)
        else:
            is_dropped = torch.zeros(num_samples, num_patches, dtype=torch.bool, device=x.device)
            is_dropped[:, self.patches] = True
        assert self.layout.patch is not None
        return is_dropped[:, self.layout.patch.to(x.device)].reshape(x.shape[:-1])

    def __repr__(self) -> str:
        selection = f"p={self.p}"
        if self.patches is not None:
            selection = f"patches={[self.layout.patch_names[number] for number in self.patches]}"
        return f"{type(self).__name__}('{self.layout.name}', {selection}, value={self.value})"
