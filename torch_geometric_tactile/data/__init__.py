r"""Recordings, and data sets whose samples share one topology.

The stub beside this file lists the names. They load on first use, so that a live robot needs
:obj:`torch` only for the classes that use it.
"""

import lazy_loader

from torch_geometric_tactile._removed import removed_names

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = removed_names(__name__, __getattr__)
