"""Imports every module of the core where no extra is installed; checks that extras are named."""

import importlib
import importlib.util
import pkgutil
import sys

import torch_geometric_tactile as package

EXTRAS = {"lightning", "jsonargparse", "torchmetrics", "tensorboard", "matplotlib", "tabulate"}
NEEDS_EXTRA = ("torch_geometric_tactile.training",)

installed = sorted(name for name in EXTRAS if importlib.util.find_spec(name))
if installed:
    sys.exit(f"this check needs an environment without extras (found {installed})")

count = 0
for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
    if module.name.startswith(NEEDS_EXTRA) or module.name.endswith("__main__"):
        continue
    importlib.import_module(module.name)
    count += 1

try:
    importlib.import_module("torch_geometric_tactile.training")
except ImportError as error:
    if "torch-geometric-tactile[train]" not in str(error):
        sys.exit(f"a missing extra must be named with its pip line (got '{error}')")
else:
    sys.exit("'torch_geometric_tactile.training' must need the extra 'train'")
print(f"{count} core modules import without extras")
