r"""The eFlesh data set of slip on a magnetic skin."""

from pathlib import Path
from typing import Any

import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._torch_file import read_torch_file, tensor_form
from torch_geometric_tactile.datasets._placed_files import trials_to_frames
from torch_geometric_tactile.datasets._raw_files import PublishedFiles
from torch_geometric_tactile.sensors import TaxelLayout, stock_layout

_RATE = 100.0  # frames per second
_BOARDS, _NUM_MAGNETOMETERS = ("first", "second"), 5


def _published_hashes() -> dict[str, str]:
    # Read from the file eflesh_slip.sha256 beside this file, in the format of "sha256sum".
    lines = Path(__file__).with_suffix(".sha256").read_text("ascii").splitlines()
    return {name: checksum for checksum, name in map(str.split, lines)}


class EFleshSlip(PublishedFiles):
    r"""The slip sequences from the "eFlesh: Highly customizable Magnetic Touch Sensing using
    Cut-Cell Microstructures" paper (Pattabiraman et al., 2025). A gripper has a magnetic skin over
    five magnetometers on each of its two fingers. The object between them is pulled until it slips,
    or is held.

    A sample is a frame of ten magnetometers with three channels, as sent by the boards (the files
    name no unit). The other attributes are:

    * :obj:`y`: 0 for hold and 1 for slip, the same for all frames of a sequence;
    * :obj:`trial`: one of the 137 sequences of 300 frames;
    * :obj:`step`: the index of the frame in its sequence;
    * :obj:`time`: seconds from the start of the sequence, at the nominal 100 Hz;
    * :obj:`session`: the run in which a sequence was recorded;
    * :obj:`part`: 0 for training and 2 for test, see the warning.

    ``Trials(dataset)`` has one sample for each sequence.

    The positions of the magnetometers are not published with the data. The layout is an assumption
    of this package: two :obj:`"anyskin"` boards, in the order of the columns.

    .. warning::
        The sequences were recorded in three runs with **one label each**: 86 slip, 34 hold, 17
        slip. Drift reveals the run, and with it the label. In random folds by sequence, a random
        forest that sees only the *first* frame, before any slip, is correct in 98.8 % of the
        sequences (5 folds, 3 seeds; ``studies/split_traps.py``).

        ``Protocol("given")`` uses :obj:`part`: it trains on the first run of slip and the first
        half of the holds, and tests on the remaining sequences, so that training and test share no
        run of slip. In this split, the first frame alone reaches 50.0 %. With the mean of the first
        ten frames subtracted, a random forest on the mean and deviation of each channel reaches
        98.0 % (34 test sequences, 3 seeds). With a single run of hold, no stricter split exists.
        The task is too easy to rank models; use it to test pipelines of windows.

    .. list-table:: STATS
        :header-rows: 1

        * - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - 137
          - 41,100
          - 10
          - 16
          - 3
          - 2

    The files are under the MIT licence.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its files :obj:`labels` and
            :obj:`seq_0.pt` to :obj:`seq_136.pt` are directly in it or in the subfolder :obj:`raw`,
            or are downloaded there. The default is :obj:`$TACTILE_DATA/EFleshSlip`, or a folder in
            the user's cache if that variable is not set.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.
        checksum (bool): Whether to verify the published checksums of the raw files.

    Raises:
        ValueError: If a raw file cannot be read or differs from the published one.
        ConnectionError: If a raw file is missing and cannot be downloaded.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol, Trials
        >>> dataset = EFleshSlip("eflesh_slip")  # doctest: +SKIP
        >>> Protocol("given").split(Trials(dataset))  # doctest: +SKIP
    """

    url = (
        "https://raw.githubusercontent.com/notvenky/eFlesh/"
        "db477233a6810b9e0c2ac94c4786e63746820b6e/slip_detection/data"
    )
    _folder = "EFleshSlip"
    _processed_name = "eflesh_slip"
    _sha256 = _published_hashes()

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
        checksum: bool = True,
    ) -> None:
        board = stock_layout("anyskin")
        self.layout = TaxelLayout.join([board] * len(_BOARDS), _BOARDS, name="eflesh_gripper")
        self.checksum = checksum
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def class_names(self) -> list[str]:
        r"""The names of the labels."""
        return ["hold", "slip"]

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all sequences."""
        self._verify()
        labels_path, *paths = self.raw_paths
        lines = Path(labels_path).read_text("ascii", errors="replace").split()
        if len(lines) != len(paths) or not {*lines} <= {"0", "1"}:
            raise ValueError(
                f"'{labels_path}' must hold {len(paths)} labels, 0 or 1 (got {len(lines)}, of "
                f"{sorted({*lines})[:5]})"
            )
        label = torch.tensor([int(line) for line in lines])
        sequences = [_read_sequence(path) for path in paths]
        num_frames = [len(sequence) for sequence in sequences]
        session = torch.zeros_like(label)
        session[1:] = (label[1:] != label[:-1]).cumsum(0)
        # The training part is the first run and the first half of the second, the only run of hold.
        is_second_run = (session == 1).long()
        is_train = (session == 0) | (
            (is_second_run == 1) & (is_second_run.cumsum(0) <= is_second_run.sum() // 2)
        )
        step = torch.cat([torch.arange(count) for count in num_frames])
        data = StaticData(
            x=torch.cat(sequences),
            edge_index=self.layout.edge_index("original"),
            pos=self.layout.pos,
            normal=self.layout.normal,
            step=step,
            time=step.double() / _RATE,
            **trials_to_frames(num_frames, y=label, session=session, part=2 * (~is_train).long()),
        )
        runs = [("hold", "slip")[int(label[session == run][0])] for run in session.unique()]
        return data, {
            "class": self.class_names,
            "trial": [Path(path).stem for path in paths],
            "session": [f"{i + 1}_{name}" for i, name in enumerate(runs)],
        }


def _read_sequence(path: str) -> torch.Tensor:
    values = read_torch_file(path)
    width = 3 * len(_BOARDS) * _NUM_MAGNETOMETERS
    need(
        _is_dense(values) and values.dim() == 2 and len(values) > 0 and values.shape[1] == width,
        f"'{path}' must hold a dense tensor of real numbers (num_frames, {width})",
        tensor_form(values),
    )
    readings = values.detach().float()
    need(bool(readings.isfinite().all()), f"'{path}' must hold finite readings (got NaN or inf)")
    return readings.view(len(readings), -1, 3)


def _is_dense(value: Any) -> bool:
    if not isinstance(value, torch.Tensor) or value.is_nested:
        return False
    return value.layout == torch.strided and not value.is_complex()
