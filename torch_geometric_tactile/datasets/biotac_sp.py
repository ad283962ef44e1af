r"""The BioTac SP grasp stability data set."""

import os
import shutil
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.datasets._raw_files import PublishedFiles
from torch_geometric_tactile.datasets._splits import checked_split
from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_csv
from torch_geometric_tactile.sensors import biotac_sp

_Palm = Literal["down", "side", "45"]
_PALMS = ("down", "side", "45")
_SHA256 = {
    "bts3v2_palm_down.csv": "7abe522411416909f6c71adc37eabc17d3ee62bed5073da1297757bea951715f",
    "bts3v2_palm_side.csv": "79d8ce7220317f9df4061a2b983eb62bdaae56e2b4428a69a7d3369de2457a87",
    "bts3v2_palm_45.csv": "6e94f40cd6d4e33fd53fb0a3179c948d0144b57d325d7e8761365d6c4c0ae4cb",
    "bts3v2_palm_down_test.csv": "e38555bc8381b7151b1d0c507141d35b06b02ec7efbdabaaa92007e205bf9c44",
    "bts3v2_palm_side_test.csv": "763da1d8512f33d2cbe3d7444691fe689b5517b8ee29a30c92dad7d567e1c3ef",
    "bts3v2_palm_45_test.csv": "a9f42a68e6fee3153ae15833ba81180444e9cc46d238a7b191af2d7509b18678",
}


class BioTacSP(PublishedFiles):
    r"""The BioTac SP stability set v2 (BTS3) from the `"TactileGCN: A Graph Convolutional Network
    for Predicting Grasp Stability with Tactile Sensors" <https://arxiv.org/abs/1901.06181>`_ paper:
    real grasps with a Shadow hand. Each grasp has one reading of three BioTac SP fingertips, taken
    before the lift that showed whether the object slips.

    A sample has 24 electrodes with three channels in raw counts. The channels are the index finger,
    the middle finger and the thumb. The other attributes are:

    * :obj:`y`: 1 if the object slipped;
    * :obj:`group`: one of the 51 objects;
    * :obj:`session`: one of the six files (a palm pose for training or test);
    * :obj:`trial`: the grasp.

    The layout has no edges. To add edges, use a :obj:`pre_transform` such as
    :class:`~torch_geometric_tactile.transforms.KNNGraph`.

    .. list-table:: STATS
        :header-rows: 1

        * - split
          - #graphs
          - #nodes
          - #features
          - #classes
          - #objects
        * - train
          - 4,682
          - 24
          - 3
          - 2
          - 41
        * - test
          - 1,149
          - 24
          - 3
          - 2
          - 10

    Args:
        root (str or PathLike, optional): Folder of the data set. The CSV files are in its subfolder
            :obj:`raw`, or are downloaded there. The default is :obj:`$TACTILE_DATA/BioTacSP`, or a
            folder in the user's cache if that variable is not set.
        split (str, optional): :obj:`"train"`, :obj:`"test"` (objects that are not in the training
            split), or :obj:`None` for all samples.
        palm (str, optional): Selects the grasps with this palm pose: :obj:`"down"`, :obj:`"side"`
            or :obj:`"45"`.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.
        checksum (bool): Whether to verify the published checksums of the raw files.

    Raises:
        ValueError: If :obj:`split` or :obj:`palm` is unknown, or a raw file differs from the
            published one.
        ConnectionError: If a raw file is missing and cannot be downloaded.

    Examples:
        >>> from torch_geometric_tactile.transforms import KNNGraph
        >>> dataset = BioTacSP(pre_transform=KNNGraph(k=2))  # doctest: +SKIP
        >>> dataset[0]  # doctest: +SKIP
        Data(x=[24, 3], y=[1], pos=[24, 3], ..., edge_index=[2, 62])
    """

    group_kind = "object"
    url = "https://raw.githubusercontent.com/3dperceptionlab/biotacsp-stability-set-v2/master"
    selection_args = ("split", "palm")
    _folder = "BioTacSP"
    _processed_name = "biotac_sp"
    _sha256 = _SHA256
    num_classes = StaticDataset.num_classes  # counts the selected samples, which may have one class

    def __init__(
        self,
        root: PathLike | None = None,
        split: Literal["train", "test"] | None = "train",
        palm: _Palm | None = None,
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
        checksum: bool = True,
    ) -> None:
        self.split = checked_split(split, ("train", "test"))
        if palm is not None and palm not in _PALMS:
            raise ValueError(f"'palm' must be 'down', 'side', '45' or None (got '{palm}')")
        self.layout = biotac_sp()
        self.palm = palm
        self.checksum = checksum
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        sessions = [
            i
            for i, name in enumerate(self.session_names)
            if self.split in (None, "test" if name.endswith("_test") else "train")
            and palm in (None, name.removesuffix("_test").removeprefix("palm_"))
        ]
        if len(sessions) < len(self.session_names):
            mask = torch.isin(self._data.session, torch.tensor(sessions))
            self._data = self._data.index_select(mask)

    @property
    def part(self) -> torch.Tensor:
        r"""The published part of each sample of this selection :math:`(S,)`, 0 for training and 2
        for test, for :class:`Protocol("given") <torch_geometric_tactile.data.Protocol>`.
        """
        is_test = torch.tensor([name.endswith("_test") for name in self.session_names])
        session = self.column("session")
        assert session is not None
        return 2 * is_test[session].long()

    def download(self) -> None:
        r"""Copies raw files from :obj:`root` or from a folder :obj:`biotacsp` beside it, downloads
        missing files, and verifies the checksums.
        """
        for folder in (Path(self.root), Path(self.root).parent):
            self.import_raw(folder, self.root)
        super().download()

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads the six files."""
        self._verify()
        tables = [read_biotac_sp_csv(path) for path in self.raw_paths]
        objects = sorted({name for table in tables for name in table.object_names})
        number = {name: i for i, name in enumerate(objects)}
        group = [number[name] for table in tables for name in table.object_names]
        sizes = torch.tensor([len(table.slipped) for table in tables])
        data = StaticData(
            x=torch.from_numpy(np.concatenate([table.reading for table in tables])),
            y=torch.from_numpy(np.concatenate([table.slipped for table in tables])),
            pos=self.layout.pos,
            normal=self.layout.normal,
            trial=torch.arange(len(group)),
            group=torch.tensor(group),
            session=torch.arange(len(tables)).repeat_interleave(sizes),
        )
        sessions = [Path(name).stem.removeprefix("bts3v2_") for name in _SHA256]
        return data, {"class": ["stable", "slip"], "group": objects, "session": sessions}

    @staticmethod
    def import_raw(folder: PathLike, root: PathLike) -> bool:
        r"""Copies the raw files in a folder to :obj:`root/raw`. Existing files are not overwritten.

        Args:
            folder (str or PathLike): A folder that contains raw files, directly or in a subfolder
                :obj:`raw`, :obj:`BioTacSP/raw` or :obj:`biotacsp`.
            root (str or PathLike): Root of the data set.

        Returns:
            bool: Whether the folder contains any raw file.
        """
        folder, root = (Path(os.path.expanduser(path)) for path in (folder, root))
        for inner in (".", "raw", "BioTacSP/raw", "biotacsp"):
            sources = [path for name in _SHA256 if (path := Path(folder, inner, name)).is_file()]
            for path in sources:
                target = Path(root, "raw", path.name)
                if not target.exists():
                    with atomic_path(target) as temporary:
                        shutil.copyfile(path, temporary)
            if sources:
                return True
        return False
