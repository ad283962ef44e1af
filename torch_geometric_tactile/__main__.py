r"""``python -m torch_geometric_tactile`` is the ``tactile`` command."""

import sys

from torch_geometric_tactile.cli import main

if __name__ == "__main__":
    sys.exit(main())
