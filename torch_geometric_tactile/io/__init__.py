r"""Readers, writers and decoders of file and wire formats, one format per file.

The names are those of the stub beside this file. They load on first use, so that a live robot
needs no :obj:`torch` for what works without.
"""

import lazy_loader

from torch_geometric_tactile._removed import removed_names

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = removed_names(__name__, __getattr__)
