r"""Robot touch for PyTorch Geometric.

Submodules are imported on first use, so that ``import torch_geometric_tactile`` is fast and the
command line responds before :obj:`torch` is imported.
"""

import sys

import lazy_loader

from torch_geometric_tactile._removed import RemovedNames

__version__ = "0.3.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
sys.meta_path.append(RemovedNames())
