r"""Runs the ``tactile`` command for ``python -m torch_geometric_tactile``."""

import sys

from torch_geometric_tactile.cli import main

if __name__ == "__main__":
    sys.exit(main())
