r"""The STAG data set of objects handled with a tactile glove."""

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
from torch_geometric_tactile.io._matrix_mat import read_mat_variables
from torch_geometric_tactile.sensors import TaxelLayout, grid, select_taxels

_FILE = "metadata.mat"
_SIDE = 32  # rows and columns of the readout
_PITCH = 0.005  # metres between cells of the layout, not between sensors on the hand
_NAMES = {"objectId": "objects", "recordingId": "recordings", "splitId": "splits"}
_NUMERIC_COLUMNS = ("ts", "hasValidLabel", "isBalanced", *_NAMES)
_PARTS = {"train": 0, "test": 2}


class TactileGlove(PlacedFiles):
    r"""The classification set of the `scalable tactile glove (STAG) <https://stag.csail.mit.edu>`_
    from the "Learning the signatures of the human grasp using a scalable tactile glove" paper
    (Sundaram et al., Nature 2019). A person wearing a knitted glove with 548 sensors handles 26
    objects. The empty hand is the 27th class.

    A sample is a frame of the 32 x 32 readout with one channel in raw counts. The authors use 500
    as the reading without touch and 650 as the strongest touch. Frames whose label is marked as
    invalid are left out. The other attributes are:

    * :obj:`y`, :obj:`group`: the object;
    * :obj:`session`, :obj:`trial`: the recording;
    * :obj:`time`: seconds from the start of the recording;
    * :obj:`balanced`: 1 for the frames that the authors train on, the same number for each object;
    * :obj:`part`: the authors' training and test frames, used by ``Protocol("given")``.

    **Only 548 of the 1,024 cells are sensors.** The authors' file that lists them was not available
    for this class. The layout is therefore the grid of the readout, whose rows and columns are
    threads of the glove. Its edges connect neighbours in the readout, and its positions are not
    positions on the hand. If you know the cells that are sensors, pass them as :obj:`taxels`;
    otherwise, pass the cells whose readings change, as in the example.

    .. warning::
        Consecutive frames of a recording are near copies, so **a split by frame tests on training
        data**. Hold out recordings with ``Protocol("session", folds=3, stratify="y")``. The paper
        reportedly has three recordings of each object, from three days. It is unknown whether the
        published parts share recordings: compare the :obj:`session` of both sides. The file does
        not identify people, so no split tests another hand.

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

    **This class was written without access to the file.** The names and meanings of the variables
    are taken from the authors' program. The file is under the authors' terms (research only, no
    redistribution, citation of the paper) and is not downloaded: get
    :obj:`classification_lite.zip` from their page.

    Args:
        root (str or PathLike, optional): Folder of the data set. The file :obj:`metadata.mat` is in
            its subfolder :obj:`raw`, :obj:`classification_lite` or :obj:`classification`, or
            directly in it. The default is :obj:`$TACTILE_DATA/TactileGlove`, or a folder in the
            user's cache if that variable is not set.
        taxels (sequence, optional): The cells that are sensors, as indices (row times 32 plus
            column) or as 1,024 booleans. The default is all cells.
        invalid (bool): Whether to keep the frames without a valid label.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw file again.

    Raises:
        FileNotFoundError: If there is no file.
        ValueError: If the file cannot be read, its variables have different numbers of frames or
            unknown codes, no frame has a valid label, or a cell is unknown.

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
    selection_args = ("taxels",)  # recorded in the layout

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
        self.layout = _glove_layout(taxels)
        self.invalid = invalid
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    def _files_in(self, folder: Path) -> list[Path]:
        return [folder / _FILE] if (folder / _FILE).is_file() else []

    @property
    def processed_file_names(self) -> str:
        r"""The processed file. Each number of cells has separate files with and without frames
        whose labels are invalid.
        """
        return f"tactile_glove_{len(self.layout)}{'_all' if self.invalid else ''}.pt"

    def _no_files(self) -> str:
        return (
            f"there is no '{_FILE}' in '{self.raw_dir}' or '{self.root}': put the file from "
            "classification_lite.zip (https://stag.csail.mit.edu) there"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads the file."""
        path = self.raw_paths[0]
        pressure, columns, names = _read_variables(path)
        for name in names["splits"]:
            need(name in _PARTS, f"'{path}': 'splits' must be 'train' and 'test'", quoted(name))
        # The frames of a trial must be consecutive.
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
        attribute_names = {
            "class": objects,
            "group": objects,
            "session": recordings,
            "trial": recordings,
        }
        return data, attribute_names


def _glove_layout(taxels: torch.Tensor | Sequence[int] | Sequence[bool] | None) -> TaxelLayout:
    layout = replace(
        grid(_SIDE, _SIDE, _PITCH),
        name="tactile_glove",
        source="Cells of the 32 x 32 readout of the scalable tactile glove (STAG), row by row. "
        "Positions are those of cells, not of places on a hand.",
    )
    return layout if taxels is None else select_taxels(layout, taxels)


def _read_variables(path: str) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, list[str]]]:
    # Returns the readings (S, 32, 32), the numeric columns (S,), and the names of the codes in
    # _NAMES.
    content = read_mat_variables(path, ["pressure", *_NUMERIC_COLUMNS, *_NAMES.values()])
    pressure = np.asarray(content["pressure"])
    if pressure.shape[1:] != (_SIDE, _SIDE) or not len(pressure):
        raise ValueError(
            f"'{path}': 'pressure' must be frames of {_SIDE} x {_SIDE} (got shape {pressure.shape})"
        )
    columns = {}
    for key in _NUMERIC_COLUMNS:
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
    for key, variable in _NAMES.items():
        texts, codes = content[variable], columns[key]
        need(isinstance(texts, list), f"'{path}': '{variable}' must be a cell array of names")
        names[variable] = [str(text) for text in texts]
        is_unknown = (codes != np.round(codes)) | (codes < 0) | (codes >= len(texts))
        message = f"'{path}': '{key}' must be the index of one of {len(texts)} '{variable}'"
        need(not is_unknown.any(), message, *codes[is_unknown][:1].tolist())
    return pressure, columns, names
