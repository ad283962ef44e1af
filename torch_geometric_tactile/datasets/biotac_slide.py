r"""The BioTac slide data set of 20 materials."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, trials_to_frames
from torch_geometric_tactile.datasets._trial import check_unique_trials
from torch_geometric_tactile.io import read_biotac_slide_csv
from torch_geometric_tactile.sensors import biotac

_URL = "https://github.com/dexrob/BioTac_slide_20_50"
_NAME = re.compile(r"mat(?P<material>[0-9]{1,9})_(?P<trial>[0-9]{1,9})_bio\.csv", re.ASCII)
_SIGNALS = ("pac", "pdc", "tac", "tdc")


class _Slide(NamedTuple):
    material: int
    number: int
    path: Path


class BioTacSlide(PlacedFiles):
    r"""The BioTac slides (`BioTac_slide_20_50 <https://github.com/dexrob/BioTac_slide_20_50>`_)
    from the "Supervised Autoencoder Joint Learning on Heterogeneous Tactile Sensory Data: Improving
    Material Classification Performance" paper (Gao et al., IROS 2020). A BioTac slides over each of
    20 materials 50 times, at about 100 frames per second.

    A sample is a frame of 19 electrodes with one channel. The other attributes are:

    * :obj:`y`: the material, ``mat1`` to ``mat20``;
    * :obj:`trial`: the slide, in the order of material and number;
    * :obj:`time`: seconds from the start of the slide;
    * :obj:`pac`: 22 samples of vibration :math:`(S, 22)`;
    * :obj:`pdc` (pressure), :obj:`tac` (change in temperature) and :obj:`tdc` (temperature).

    All signals are counts. They are never negative and are near zero at the end of a slide, so they
    are probably absolute differences from an unpublished reading at rest. The layout has no edges;
    add them with a :obj:`pre_transform`.

    .. warning::
        **The time of recording may reveal the material.** The slides over one material were
        recorded one after the other (slides 2, 10, 11 and 31 over ``mat1`` end within 32 minutes of
        one day, slides 2 and 39 over ``mat7`` within 38 minutes of the next), so that drift is
        confounded with the label. Inspect the temperatures :obj:`tdc` and :obj:`tac` first. Each
        class is one piece of material, so the data set cannot show whether another piece of the
        same material would be recognised. All frames of a slide belong on the same side of a split:
        hold out slides with ``Protocol("trial", folds=5, stratify="y")``.

    The authors publish their split as arrays in the folder ``compiled_data``, without slide
    numbers. This class does not read these arrays and has no attribute :obj:`part`.

    .. list-table:: STATS
        :header-rows: 1

        * - #trials
          - #graphs
          - #nodes
          - #features
          - #classes
        * - 1,000
          - 789,957
          - 19
          - 1
          - 20

    These numbers refer to commit ``c19638b``. There are 50 slides of 599 to 801 frames over each
    material.

    The repository names no licence. The files are therefore neither downloaded nor part of this
    package: get them with ``git clone``, and check whether you may use them.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its folders ``mat1`` to ``mat20``,
            with files ``mat<material>_<trial>_bio.csv``, are in the subfolder :obj:`raw_data` or
            :obj:`raw`, in the clone :obj:`BioTac_slide_20_50`, or directly in it. Other files are
            ignored. The default is :obj:`$TACTILE_DATA/BioTacSlide`, or a folder in the user's
            cache if that variable is not set.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no files.
        ValueError: If a file cannot be read or is in the folder of another material, or two files
            hold the same slide.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = BioTacSlide("BioTac_slide_20_50")  # doctest: +SKIP
        >>> Protocol("trial", folds=5, stratify="y").split(dataset)  # doctest: +SKIP
    """

    _folder = "BioTacSlide"
    _folders = ("raw", "raw_data", "BioTac_slide_20_50/raw_data", "BioTac_slide_20_50", ".")
    _processed_name = "biotac_slide.pt"

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = biotac()
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    def _files_in(self, folder: Path) -> list[Path]:
        return [slide.path for slide in _slides(folder)]

    def _no_files(self) -> str:
        return (
            f"there are no slides in '{self.raw_dir}' or '{self.root}': put the folders 'mat1' to "
            f"'mat20' of {_URL} there (git clone)"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all slides."""
        slides = _slides(Path(self.raw_dir))
        check_unique_trials(
            (s[:2], f"slide {s.number} over mat{s.material}", f"'{s.path}'") for s in slides
        )
        for slide in slides:
            if slide.path.parent.name != f"mat{slide.material}":
                raise ValueError(
                    f"'{slide.path}' must be in the folder 'mat{slide.material}' (got "
                    f"'{slide.path.parent.name}')"
                )
        materials = sorted({slide.material for slide in slides})
        recordings = [read_biotac_slide_csv(slide.path) for slide in slides]
        signals = {
            "x": [recording.tactile for recording in recordings],
            "time": [recording.time - recording.time[0] for recording in recordings],
            **{name: [recording.extra[name] for recording in recordings] for name in _SIGNALS},
        }
        data = StaticData(
            pos=self.layout.pos,
            normal=self.layout.normal,
            **{key: torch.from_numpy(np.concatenate(rows)) for key, rows in signals.items()},
            **trials_to_frames(
                [recording.num_frames for recording in recordings],
                y=[materials.index(slide.material) for slide in slides],
            ),
        )
        names = [slide.path.stem.removesuffix("_bio") for slide in slides]
        return data, {"class": [f"mat{number}" for number in materials], "trial": names}


def _slides(folder: Path) -> list[_Slide]:
    return sorted(
        _Slide(int(match["material"]), int(match["trial"]), path)
        for path in folder.glob("mat*/mat*_bio.csv")
        if (match := _NAME.fullmatch(path.name))
    )
