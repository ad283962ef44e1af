r"""Layers and models.

All classes of the subpackages can be imported from here, as in
:obj:`from torch_geometric_tactile.nn import MTGCN, StaticGCNConv`.
"""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.nn import conv, models, pool
from torch_geometric_tactile.nn.conv import *  # noqa: F403
from torch_geometric_tactile.nn.models import *  # noqa: F403
from torch_geometric_tactile.nn.pool import *  # noqa: F403

# Only classes, so that `torch_geometric.resolver` finds each of them by its name.
__all__: list[str] = []
__all__ += conv.__all__
__all__ += pool.__all__
__all__ += models.__all__

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
