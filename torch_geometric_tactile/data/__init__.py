r"""Recordings, and data sets whose samples share one topology.

The names are those of the stub beside this file. They load on first use, so that a live robot
needs no :obj:`torch` for what works without.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
