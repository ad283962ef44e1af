r"""The table of the demo, on the real data, or on generated data where that cannot be had."""

import logging
import os
from dataclasses import replace
from pathlib import Path

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.datasets import BioTacSP, default_root
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.tables import Table
from torch_geometric_tactile.papers.load_table import load_table

_logger = logging.getLogger(__name__)
_GENERATED = {"num_samples": 2000, "num_test": 600, "num_objects": 20}


def grasp_table(root: PathLike | None = None, generated: bool = False) -> Table:
    r"""Returns the table :obj:`bts3` with its data found or downloaded, or with generated data,
    labelled so, if it cannot be downloaded.
    """
    table = load_table("bts3")
    reason = "generated data was asked for"
    if not generated:
        home = default_root("BioTacSP") if root is None else Path(os.path.expanduser(root))
        try:
            home = home if root is None else _find(home)
            source = table.data.with_arguments({"root": str(home)})
            source, _ = source.resolve()
        except ConnectionError as error:
            reason = str(error)
        else:
            return replace(table, data=source)
    _logger.warning("no real data: %s", reason)
    notice = "Data: GENERATED, not measured: no number below says anything about a real hand."
    arguments = {**_GENERATED, "pre_transform": table.data.arguments["pre_transform"]}
    class_path = "torch_geometric_tactile.datasets.FakeTactileDataset"
    return replace(table, data=DataSource(class_path, arguments, kind="generated", caption=notice))


def _find(folder: Path) -> Path:
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
