r"""Data sets whose files may be in one of several folders, and attributes of their frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.datasets._raw_files import RawFiles


class PlacedFiles(RawFiles):
    r"""A data set whose files are in one of several folders in :obj:`root`. The first folder that
    contains any of the files is used. A subclass lists the files in a folder.
    """

    _folders: tuple[str, ...] = ("raw", ".")

    def _files_in(self, folder: Path) -> list[Path]:
        raise NotImplementedError

    @property
    def raw_dir(self) -> str:
        r"""The folder of the files: the first of the possible folders that contains any."""
        places = [Path(self.root, name) for name in self._folders]
        return str(next(filter(self._files_in, places), places[0]))

    @property
    def raw_file_names(self) -> list[str]:
        r"""The paths of the files relative to :obj:`raw_dir`, in order."""
        folder = Path(self.raw_dir)
        return [path.relative_to(folder).as_posix() for path in self._files_in(folder)]


def trials_to_frames(
    num_frames: Sequence[int], **values: Sequence[int] | Tensor
) -> dict[str, Tensor]:
    r"""Returns the trial index of each frame, :obj:`trial`, and the values of each trial repeated
    for its frames.

    Examples:
        >>> trials_to_frames([2, 1], y=[7, 5])
        {'trial': tensor([0, 0, 1]), 'y': tensor([7, 7, 5])}
    """
    trials: dict[str, Any] = {"trial": range(len(num_frames)), **values}
    counts = torch.tensor(num_frames)
    return {
        key: torch.as_tensor(column).repeat_interleave(counts) for key, column in trials.items()
    }
