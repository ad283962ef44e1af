"""Imports every module of the core where no extra is installed; checks that extras are named."""

import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable

import torch_geometric_tactile as package

EXTRAS = {
    "cobs",
    "h5py",
    "huggingface_hub",
    "jsonargparse",
    "lightning",
    "matplotlib",
    "mcap",
    "mujoco",
    "onnx",
    "onnxruntime",
    "onnxscript",
    "orjson",
    "pyarrow",
    "tabulate",
    "tensorboard",
    "torchmetrics",
    "websockets",
}
NEEDS_EXTRA = tuple(
    f"torch_geometric_tactile.{module}"
    for module in (
        "training",
        "experiments",
        "papers",
        "reports._analysis",
        "reports._board",
        "reports._compare",
        "reports._demo",
        "reports._simulation",
        "visualization._notebook_figure",  # derives from a class of matplotlib
    )
)

installed = sorted(name for name in EXTRAS if importlib.util.find_spec(name))
if installed:
    sys.exit(f"this check needs an environment without extras (found {installed})")

count = 0
for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
    if module.name.startswith(NEEDS_EXTRA) or module.name.endswith("__main__"):
        continue
    importlib.import_module(module.name)
    count += 1


def check_named(extra: str, call: Callable[[], object]) -> None:
    """Calls something that needs a missing extra; it must say so."""
    try:
        call()
    except ImportError as error:
        if f"torch-geometric-tactile[{extra}]" not in str(error):
            sys.exit(f"the missing extra '{extra}' must be named with its pip line (got '{error}')")
    else:
        sys.exit(f"something must need the extra '{extra}'")


from torch_geometric_tactile import Predictor, io, sim  # noqa: E402

check_named("train", lambda: importlib.import_module("torch_geometric_tactile.training"))
check_named("sim", lambda: sim.simulate("nowhere"))
check_named("live", io.CobsDecoder)
check_named("io", lambda: io.read_hdf5(__file__))
check_named("hub", lambda: Predictor.from_pretrained("user/nothing"))
print(f"{count} core modules import without extras")
