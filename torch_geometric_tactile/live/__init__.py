r"""Live sensors: reading, recording and showing their frames, and running models on them.

The stub beside this file lists the names. They are imported on first use, so that a robot needs
:obj:`torch` only for the parts that use it.
"""

import lazy_loader

from torch_geometric_tactile._removed import removed_names

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = removed_names(__name__, __getattr__)
