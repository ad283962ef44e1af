r"""Published data sets, one per file, and a generated one."""

from torch_geometric_tactile.datasets.allegro_uskin import AllegroUSkin
from torch_geometric_tactile.datasets.biotac_sp import BioTacSP
from torch_geometric_tactile.datasets.fake import FakeTactileDataset
from torch_geometric_tactile.datasets.root import default_root

__all__ = ["AllegroUSkin", "BioTacSP", "FakeTactileDataset", "default_root"]
