r"""A data set of people who lie on a pressure mat."""

from typing import Literal

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import trials_to_frames
from torch_geometric_tactile.datasets._raw_files import PublishedFiles
from torch_geometric_tactile.io._pressure_mat_zip import pressure_mat_hash, read_pressure_mat_zip
from torch_geometric_tactile.sensors import grid

_SIDES = ("supine", "left", "right")
# The sides of the postures, from the tables in experiment-info.docx of the data set.
_SIDE_I = {"2": "right", "3": "left", "4": "right", "5": "right", "6": "left", "7": "left"}
_SIDE_I |= {"13": "right", "14": "left"}
_SIDE_II = {"C": "right", "D": "left", "E1": "right", "E2": "right", "E3": "left", "E4": "left"}
_SIDE_II |= {"E5": "right", "E6": "left"}
_NAMED_SECTIONS = "BCDEF"  # sections of experiment II whose postures the description names
_NUM_SKIPPED_FRAMES = 3  # at the start of each file of experiment I, where there are glitches
_PITCH = 0.0254  # metres
_NUM_COLUMNS = {"i": 32, "ii": 27}
# The checksum of the list of checksums in the zip file, since the archive may be packed again.
_SHA256 = {"pmd-1.0.0.zip": "ef1511cd7dfde50b2c2438022ab486c264ad93e93263a63852a3a9884d086262"}


class PressureMat(PublishedFiles):
    r"""The pressure mat data from the "A Pressure Map Dataset for Posture and Subject Analytics"
    paper (Pouyan, Birjandtalab, Heydarzadeh, Nourani and Ostadabbas, 2017), `PhysioNet's pmd 1.0.0
    <https://physionet.org/content/pmd/1.0.0/>`_. People lie on a bed in prescribed postures.

    A sample is a frame of pressures in raw counts of the mat. :obj:`group` is the person, and
    :obj:`trial` the file.

    * **Experiment I** has 13 people in 17 postures on 64 x 32 cells, with 1 frame per second for
      about two minutes per posture. **The first three frames of each file are left out**: the first
      is nearly empty, the second is a glitch, and the third is sometimes a glitch. :obj:`step` and
      :obj:`time` count from the fourth frame. According to the description, readings range from 0
      to 1,000, but 0.1 % of the readings are higher, up to 4,095.
    * **Experiment II** has 8 people in 29 postures on an air and a sponge mattress
      (:obj:`session`), on 64 x 27 cells of another mat. Each posture has one frame, the mean of
      about twenty. Three frames of one person are left out, since the description does not name
      their postures.

    Frames are oriented as published: the head is at the first row in experiment I and at the last
    row in experiment II. The cells of the layout are 2.54 cm apart, a common size of such mats; the
    data set does not state the size.

    .. warning::
        Frames of one file are nearly identical, and a system in use meets new *people*: hold out
        :obj:`group`. In five random folds of frames, a random forest recognises 99.9 % of the
        postures; for new people, it recognises 85.6 % of the postures and 98.2 % of the sides
        (experiment I, every eighth frame, thirteen folds, one seed; ``studies/split_traps.py``).

    .. list-table:: STATS
        :header-rows: 1

        * - experiment
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - I
          - 19,361
          - 2,048
          - 8,000
          - 1
          - 17
        * - II
          - 462
          - 1,728
          - 6,730
          - 1
          - 29

    The licence is reported to be the Open Data Commons Attribution licence 1.0: check the page of
    the data set.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its zip file
            :obj:`pmd-1.0.0.zip` is directly in it or in the subfolder :obj:`raw`, or is downloaded
            there (31 MB). The default is :obj:`$TACTILE_DATA/PressureMat`, or a folder in the
            user's cache if that variable is not set.
        experiment (str): :obj:`"i"` or :obj:`"ii"`.
        target (str): The label :obj:`y`: :obj:`"posture"`, or :obj:`"side"` (supine, left or
            right).
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw file again.
        checksum (bool): Whether to verify the published checksums in the zip file.

    Raises:
        ValueError: If an argument is invalid, or the file cannot be read or differs from the
            published one.
        ConnectionError: If the file is missing and cannot be downloaded.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = PressureMat("pressure_mat", target="side")  # doctest: +SKIP
        >>> Protocol("group", leave_one_out=True).split(dataset, fold=0)  # doctest: +SKIP
    """

    group_kind = "person"
    url = "https://physionet.org/content/pmd/get-zip"
    _folder = "PressureMat"
    _sha256 = _SHA256

    def __init__(
        self,
        root: PathLike | None = None,
        experiment: Literal["i", "ii"] = "i",
        target: Literal["posture", "side"] = "posture",
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
        checksum: bool = True,
    ) -> None:
        need(experiment in _NUM_COLUMNS, "'experiment' must be 'i' or 'ii'", repr(experiment))
        need(target in ("posture", "side"), "'target' must be 'posture' or 'side'", repr(target))
        self.experiment, self.target, self.checksum = experiment, target, checksum
        self.layout = grid(64, _NUM_COLUMNS[experiment], _PITCH)
        self._processed_name = f"pressure_mat_{experiment}_{target}"
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def class_names(self) -> list[str]:
        r"""The names of the postures or sides, in the order of their class indices."""
        return list(_SIDES) if self.target == "side" else self._names["class"]

    def _path_at_url(self, name: str) -> str:
        return "1.0.0/"

    def _hash(self, path: PathLike) -> str:
        # The bytes of the zip file may change from download to download.
        return pressure_mat_hash(path)

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads the files of the experiment."""
        self._verify()
        files = read_pressure_mat_zip(self.raw_paths[0], self.experiment)
        if self.experiment == "i":
            frames = [file.reading[_NUM_SKIPPED_FRAMES:] for file in files]
        else:
            files = [file for file in files if file.posture[0] in _NAMED_SECTIONS]
            frames = [file.reading for file in files]
        persons = list(dict.fromkeys(file.person for file in files))
        mattresses = [file.mattress or "" for file in files]
        sides = [_side(file.posture, self.experiment) for file in files]
        postures = list(dict.fromkeys(file.posture for file in files))
        classes, labels = (postures, [f.posture for f in files])
        if self.target == "side":
            classes, labels = list(_SIDES), sides
        num_frames = [len(file_frames) for file_frames in frames]
        step = torch.cat([torch.arange(count) for count in num_frames])
        columns = {
            "y": [classes.index(label) for label in labels],
            "group": [persons.index(file.person) for file in files],
        }
        names = {"class": classes, "group": persons}
        if self.experiment == "ii":
            names["session"] = ["air", "sponge"]
            columns["session"] = [names["session"].index(m) for m in mattresses]
        names["trial"] = ["_".join(filter(None, f[:3])) for f in files]
        data = StaticData(
            x=torch.from_numpy(np.concatenate(frames).reshape(len(step), -1, 1)),
            edge_index=self.layout.edge_index("original"),
            pos=self.layout.pos,
            normal=self.layout.normal,
            **trials_to_frames(num_frames, **columns),
        )
        if self.experiment == "i":
            data.step, data.time = step, step.double()
        return data, names


def _side(posture: str, experiment: str) -> str:
    if experiment == "i":
        return _SIDE_I.get(posture, "supine")
    return _SIDE_II.get(posture, _SIDE_II.get(posture[0], "supine"))
