r"""Objects in a hand with a tactile glove."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles
from torch_geometric_tactile.io import read_mat_variables
from torch_geometric_tactile.sensors import TaxelLayout, grid, select_taxels

_FILE = "metadata.mat"
_SIDE = 32  # rows and columns of the readout
_PITCH = 0.005  # m, of cells and not of places on the hand
_NAMES = {"objectId": "objects", "recordingId": "recordings", "splitId": "splits"}
_NUMBERS = ("ts", "hasValidLabel", "isBalanced", *_NAMES)
_PARTS = {"train": 0, "test": 2}


class TactileGlove(PlacedFiles):
    r"""The classification set of the `scalable tactile glove (STAG) <https://stag.csail.mit.edu>`_
    of the "Learning the signatures of the human grasp using a scalable tactile glove" paper
    (Sundaram et al., Nature 2019): a person with a knitted glove of 548 sensors handles 26 objects
    and, as a class of its own, nothing.

    A sample is a frame of the 32 x 32 readout with one channel, in raw counts; the authors take 500
    for nothing and 650 for the strongest touch. :obj:`y` and :obj:`group` number the objects,
    :obj:`session` and :obj:`trial` the recordings, :obj:`time` are seconds from the start of a
    recording, :obj:`balanced` is 1 for the frames that the authors train on, so that objects are
    even. Frames whose label the authors do not count as valid are left out. With :obj:`part`,
    ``Protocol("given")`` takes the authors' training and test frames.

    **Which of the 1,024 cells are sensors** is in a file of the authors that was not seen here: the
    layout is the grid of the readout, whose rows and columns are threads of the glove. Its edges
    join neighbours in the readout, and its positions are none of the hand. Name the cells that you
    know to be sensors by :obj:`taxels`, or those that change at all, as in the example.

    .. warning::
        Frames of a recording follow each other in time and are near copies, so that **a split by
        frame tests on what was trained on**. Hold out recordings,
        ``Protocol("session", folds=3, stratify="y")``; the paper is said to have three of each
        object, from three days. Whether the published parts share recordings was not seen here:
        compare the :obj:`session` of both sides. The file names no persons: no split of it tests
        another hand.

    .. list-table:: STATS, as published
        :header-rows: 1

        * - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - 135,187
          - 1,024 (548 sensors)
          - 3,968
          - 1
          - 27

    **What was read here**: the authors' program, from which names and meanings of the variables
    are, its licence, and the home page; not the file. It is used under the authors' terms (research
    only, no passing on, the paper to be cited), and is not downloaded: get
    :obj:`classification_lite.zip` from their page.

    Args:
        root (str or PathLike, optional): Folder of the data set; the file :obj:`metadata.mat` is in
            its folder :obj:`raw`, :obj:`classification_lite` or :obj:`classification` or in itself.
            If left out, :obj:`$TACTILE_DATA/TactileGlove` or a folder in the user's cache.
        taxels (sequence, optional): The cells that are sensors, by their numbers (row times 32 plus
            column) or as 1,024 truth values; all of them if left out.
        invalid (bool): Whether to keep the frames without a valid label.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw file anew.

    Raises:
        FileNotFoundError: If there is no file.
        ValueError: If the file cannot be read, its variables do not go together, no frame has a
            valid label, or a cell is unknown.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = TactileGlove("stag")  # doctest: +SKIP
        >>> changing = (dataset.x != dataset.x[0]).any(dim=0).view(-1)  # doctest: +SKIP
        >>> dataset = TactileGlove("stag", taxels=changing)  # doctest: +SKIP
        >>> Protocol("session", folds=3, stratify="y").split(dataset)  # doctest: +SKIP
    """

    group_kind = "object"
    _folder = "TactileGlove"
    _folders = ("raw", "classification_lite", "classification", ".")
    selection_args = ("taxels",)  # the layout tells them

    def __init__(
        self,
        root: PathLike | None = None,
        taxels: torch.Tensor | Sequence[int] | Sequence[bool] | None = None,
        *,
        invalid: bool = False,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = _layout(taxels)
        self.invalid = invalid
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    def _files_in(self, folder: Path) -> list[Path]:
        return [folder / _FILE] if (folder / _FILE).is_file() else []

    @property
    def processed_file_names(self) -> str:
        r"""One file for each number of cells, with and without frames of no valid label."""
        return f"tactile_glove_{len(self.layout)}{'_all' if self.invalid else ''}.pt"

    def _no_files(self) -> str:
        return (
            f"there is no '{_FILE}' in '{self.raw_dir}' or '{self.root}': put that of "
            "classification_lite.zip (https://stag.csail.mit.edu) there"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads the file."""
        path = self.raw_paths[0]
        pressure, columns, names = _checked(path)
        for name in names["splits"]:
            need(name in _PARTS, f"'{path}': 'splits' must be 'train' and 'test'", quoted(name))
        order = np.argsort(columns["recordingId"], kind="stable")
        if not self.invalid:
            order = order[columns["hasValidLabel"][order] != 0]
            need(len(order), f"'{path}' must have frames with a valid label (got none)")
        column = {key: torch.from_numpy(value[order]) for key, value in columns.items()}
        recording = column["recordingId"].long()
        _, counts = recording.unique_consecutive(return_counts=True)
        first = (counts.cumsum(0) - counts).repeat_interleave(counts)
        time = column["ts"]
        group = column["objectId"].long()
        part = torch.tensor([_PARTS[name] for name in names["splits"]])
        cells = self.layout.image_map
        assert cells is not None
        x = pressure[order[:, None], cells[:, 0].numpy(), cells[:, 1].numpy()]
        data = StaticData(
            x=torch.from_numpy(x.astype(np.float32))[..., None],
            edge_index=self.layout.edge_index("original"),
            y=group,
            group=group.clone(),
            session=recording,
            trial=recording.clone(),
            time=time - time[first],
            balanced=column["isBalanced"].long(),
            part=part[column["splitId"].long()],
        )
        objects, recordings = names["objects"], names["recordings"]
        known = {"class": objects, "group": objects, "session": recordings, "trial": recordings}
        return data, known


def _layout(taxels: torch.Tensor | Sequence[int] | Sequence[bool] | None) -> TaxelLayout:
    layout = replace(
        grid(_SIDE, _SIDE, _PITCH),
        name="tactile_glove",
        source="Cells of the 32 x 32 readout of the scalable tactile glove (STAG), row by row. "
        "Positions are those of cells, not of places on a hand.",
    )
    return layout if taxels is None else select_taxels(layout, taxels)


def _checked(path: str) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, list[str]]]:
    # The readings, a number for each frame, and the names behind some of them.
    content = read_mat_variables(path, ["pressure", *_NUMBERS, *_NAMES.values()])
    pressure = np.asarray(content["pressure"])
    if pressure.shape[1:] != (_SIDE, _SIDE) or not len(pressure):
        raise ValueError(
            f"'{path}': 'pressure' must be frames of {_SIDE} x {_SIDE} (got shape {pressure.shape})"
        )
    columns = {}
    for key in _NUMBERS:
        numbers = np.asarray(content[key])
        if numbers.size != len(pressure) or numbers.dtype.kind not in "iuf":
            raise ValueError(
                f"'{path}': '{key}' must have a number for each of {len(pressure)} frames (got "
                f"shape {numbers.shape})"
            )
        columns[key] = numbers.reshape(-1).astype(np.float64)
        finite = np.isfinite(columns[key]).all()
        need(finite, f"'{path}': '{key}' must be finite")
    names = {}
    for key, named in _NAMES.items():
        texts, numbers = content[named], columns[key]
        need(isinstance(texts, list), f"'{path}': '{named}' must be a cell array of names")
        names[named] = [str(text) for text in texts]
        wrong = (numbers != np.round(numbers)) | (numbers < 0) | (numbers >= len(texts))
        rule = f"'{path}': '{key}' must be one of {len(texts)} '{named}', from 0 on"
        need(not wrong.any(), rule, *numbers[wrong][:1].tolist())
    return pressure, columns, names
