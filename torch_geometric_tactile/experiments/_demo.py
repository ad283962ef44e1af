r"""The comparisons of ``tactile demo``: will an object slip, by what is held out."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.datasets import BioTacSP, default_root
from torch_geometric_tactile.experiments.comparison import ComparisonSettings, comparison_plan
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.experiments.source import DataSource

_logger = logging.getLogger(__name__)
_DATASETS = "torch_geometric_tactile.datasets."
_TRANSFORMS = "torch_geometric_tactile.transforms."
_NUM_GENERATED: dict[str, Any] = {"num_samples": 2000, "num_test": 600, "num_objects": 20}
_MODELS = ("taxel_net", "svm_rbf", "svm_linear", "constant")
_NEIGHBOURS = {"class_path": f"{_TRANSFORMS}KNNGraph", "init_args": {"k": 2}}
RANDOM_GRASPS, OFFICIAL_TEST = "random grasps", "official test"
RAW, COMMON_MODE = "raw, all fingers", "common mode, middle + thumb"


class HeldOut(NamedTuple):
    r"""A kind of test samples: its name, :obj:`by` of :class:`ComparisonSettings`, and the part of
    the data set that is split.
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
    r"""One comparison of the demo: how readings are prepared, what is held out, and its runs."""

    readings: str
    held_out: str
    plan: Plan


def demo_data(root: PathLike | None = None, generated: bool = False) -> DataSource:
    r"""Returns the BioTac SP stability set, found or downloaded, or generated grasps, labelled so,
    if it cannot be downloaded.

    Args:
        root (str or PathLike, optional): Folder with its six CSV files, or the parent folder.
        generated (bool): Whether to generate grasps in any case.

    Raises:
        FileNotFoundError: If :obj:`root` is no folder.
        ValueError: If a file is damaged.
    """
    reason = "generated data was asked for"
    if not generated:
        home = default_root("BioTacSP") if root is None else _root_in(Path(root).expanduser())
        caption = (
            "Data: real. BioTac SP stability set v2 (BTS3), "
            "github.com/3dperceptionlab/biotacsp-stability-set-v2, checksums verified."
        )
        arguments = {"root": str(home), "split": "train", "pre_transform": _NEIGHBOURS}
        source = DataSource(f"{_DATASETS}BioTacSP", arguments, kind="measured", caption=caption)
        try:
            return source.resolve()[0]
        except ConnectionError as error:
            reason = str(error)
    _logger.warning("no real data: %s", reason)
    caption = "Data: GENERATED, not measured: no number below says anything about a real hand."
    arguments = {**_NUM_GENERATED, "split": "train", "pre_transform": _NEIGHBOURS}
    path = f"{_DATASETS}FakeTactileDataset"
    return DataSource(path, arguments, kind="generated", caption=caption)


def demo_plans(source: DataSource, folds: int, seeds: int, epochs: int) -> Iterator[DemoPlan]:
    r"""Yields the comparisons of the demo. The official test, which is one part, is tested by as
    many trainings as the others have folds.
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
                folds=max(folds, 3) if by == "session" else folds,  # each of three is left out
                seeds=seeds * folds if by == "given" else seeds,
                epochs=epochs,
            )
            samples = source.with_arguments(
                {"split": split} | ({"transform": transform} if steps else {})
            )
            yield DemoPlan(readings, name, comparison_plan(samples, settings, name=name))


def _root_in(folder: Path) -> Path:
    # The root of the data set; loose files are copied out of a folder that may not be ours to
    # write to.
    if not folder.is_dir():
        raise FileNotFoundError(f"'--root' must be a folder (got '{folder}')")
    for home in (folder, folder / "BioTacSP"):
        if (home / "raw").is_dir():
            return home
    home = default_root("BioTacSP")
    if home.parent.resolve() == folder.resolve():  # $TACTILE_DATA itself
        BioTacSP.import_raw(folder, home)
        return home
    return home if BioTacSP.import_raw(folder, home) else folder / "BioTacSP"
