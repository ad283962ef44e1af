r"""Readers, writers and decoders of file and wire formats, one format per file.

The public names are listed in ``__init__.pyi``. They are imported on first use, so that a live
robot needs no :obj:`torch` for the functions that work without it.
"""

import lazy_loader

from torch_geometric_tactile._removed import removed_names

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = removed_names(__name__, __getattr__)
