r"""The comparisons of ``tactile demo``: slip prediction with several kinds of test parts."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.datasets._root import default_root
from torch_geometric_tactile.experiments.comparison import ComparisonSettings, comparison_plan
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.experiments.source import DataSource

_logger = logging.getLogger(__name__)
_DATASETS = "torch_geometric_tactile.datasets."
_TRANSFORMS = "torch_geometric_tactile.transforms."
_GENERATED_ARGUMENTS: dict[str, Any] = {"num_samples": 2000, "num_test": 600, "num_objects": 20}
_MODELS = ("taxel_net", "svm_rbf", "svm_linear", "constant")
_KNN_GRAPH = {"class_path": f"{_TRANSFORMS}KNNGraph", "init_args": {"k": 2}}
RANDOM_GRASPS, OFFICIAL_TEST = "random grasps", "official test"
RAW, COMMON_MODE = "raw, all fingers", "common mode, middle + thumb"


class HeldOut(NamedTuple):
    r"""A kind of test part.

    Args:
        name (str): Name in the report.
        by (str): As in :class:`ComparisonSettings`.
        split (str, optional): The part of the data set that is split. Defaults to all samples.
    """

    name: str
    by: str
    split: str | None


HELD_OUT = (
    HeldOut(RANDOM_GRASPS, "frame", "train"),
    HeldOut("new objects", "group", "train"),
    HeldOut("new session", "session", "train"),
    HeldOut(OFFICIAL_TEST, "given", None),
)
READINGS: dict[str, Sequence[dict[str, Any]]] = {
    RAW: (),
    COMMON_MODE: (
        {"class_path": f"{_TRANSFORMS}CommonMode"},
        {"class_path": f"{_TRANSFORMS}SelectChannels", "init_args": {"channels": [1, 2]}},
    ),
}


class DemoPlan(NamedTuple):
    r"""One comparison of the demo.

    Args:
        readings (str): Name of the preparation of the readings, a key of :obj:`READINGS`.
        held_out (str): Name of the kind of test part.
        plan (Plan): The experiments.
    """

    readings: str
    held_out: str
    plan: Plan


def demo_data(root: PathLike | None = None, generated: bool = False) -> DataSource:
    r"""Returns the BioTac SP stability set, and downloads it if it is not on disk. If the download
    fails, returns generated grasps with a caption that says so.

    Args:
        root (str or PathLike, optional): Folder with the six CSV files, or its parent folder.
        generated (bool): If :obj:`True`, generates grasps even if the recordings are available.

    Raises:
        FileNotFoundError: If :obj:`root` is not a folder.
        ValueError: If a file is damaged.
    """
    reason = "generated data was requested"
    if not generated:
        path = default_root("BioTacSP") if root is None else _find_root(Path(root).expanduser())
        caption = (
            "Data: real. BioTac SP stability set v2 (BTS3), "
            "github.com/3dperceptionlab/biotacsp-stability-set-v2, checksums verified."
        )
        arguments = {"root": str(path), "split": "train", "pre_transform": _KNN_GRAPH}
        source = DataSource(f"{_DATASETS}BioTacSP", arguments, kind="measured", caption=caption)
        try:
            return source.resolve()[0]
        except ConnectionError as error:
            reason = str(error)
    _logger.warning("no real data: %s", reason)
    caption = "Data: GENERATED, not measured. No number below says anything about a real hand."
    arguments = {**_GENERATED_ARGUMENTS, "split": "train", "pre_transform": _KNN_GRAPH}
    class_path = f"{_DATASETS}FakeTactileDataset"
    return DataSource(class_path, arguments, kind="generated", caption=caption)


def demo_plans(source: DataSource, folds: int, seeds: int, epochs: int) -> Iterator[DemoPlan]:
    r"""Yields the comparisons of the demo. The official test has a single test part, so its models
    are trained as often as the other comparisons have folds, each time with a different seed.
    """
    for readings, steps in READINGS.items():
        transform = {
            "class_path": "torch_geometric.transforms.Compose",
            "init_args": {"transforms": list(steps)},
        }
        for name, by, split in HELD_OUT:
            settings = ComparisonSettings(
                models=_MODELS,
                by=by,
                folds=max(folds, 3) if by == "session" else folds,  # one fold for each session
                seeds=seeds * folds if by == "given" else seeds,
                epochs=epochs,
            )
            samples = source.with_arguments(
                {"split": split} | ({"transform": transform} if steps else {})
            )
            yield DemoPlan(readings, name, comparison_plan(samples, settings, name=name))


def _find_root(folder: Path) -> Path:
    # Returns the root of the data set. CSV files outside a 'raw' folder are copied to the default
    # root, since the folder of the user may be read-only.
    if not folder.is_dir():
        raise FileNotFoundError(f"'--root' must be a folder (got '{folder}')")
    for root in (folder, folder / "BioTacSP"):
        if (root / "raw").is_dir():
            return root
    root = default_root("BioTacSP")
    if root.parent.resolve() == folder.resolve():  # $TACTILE_DATA itself
        BioTacSP.import_raw(folder, root)
        return root
    return root if BioTacSP.import_raw(folder, root) else folder / "BioTacSP"
