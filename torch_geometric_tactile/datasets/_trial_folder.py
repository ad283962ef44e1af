r"""A folder with one trial a file."""

from collections.abc import Sequence
from pathlib import Path

from torch_geometric_tactile.data._file_state import file_state
from torch_geometric_tactile.datasets._frame_reader import (
    SUFFIXES,
    no_trials,
    trial_files,
    trial_folder,
)
from torch_geometric_tactile.datasets._selected_frames import SelectedFrames


class TrialFolder(SelectedFrames):
    r"""A data set whose raw files are a folder of trials. Base class of
    :class:`~torch_geometric_tactile.datasets.RecordingFrames` and
    :class:`~torch_geometric_tactile.datasets.BiGS`, which set :obj:`pattern`.
    """

    force_reload: bool
    pattern: str
    suffixes: Sequence[str] = SUFFIXES
    _content = "content=5"  # to be raised when the processed file gets other columns

    @property
    def raw_dir(self) -> str:
        r"""The folder of the trials: :obj:`root/raw`, or :obj:`root` where that has none."""
        return str(trial_folder(Path(self.root), self.pattern, self.suffixes))

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of the trials, in order."""
        return trial_files(Path(self.raw_dir), self.pattern, self.suffixes)

    @property
    def raw_paths(self) -> list[str]:
        r"""Their paths."""
        folder = Path(self.raw_dir)  # looked up once for all
        return [str(folder / name) for name in trial_files(folder, self.pattern, self.suffixes)]

    def raw_state(self) -> list[str]:
        r"""Returns the files of the trials with what their contents are known by, see
        :func:`~torch_geometric_tactile.data._file_state.file_state`.
        """
        folder = Path(self.raw_dir)
        files = trial_files(folder, self.pattern, self.suffixes)
        return [self._content, *(f"{name}={file_state(folder / name)}" for name in files)]

    def _process(self) -> None:
        is_processed = Path(self.processed_paths[0]).is_file() and not self.force_reload
        if not self.raw_paths and not is_processed:
            raise FileNotFoundError(self._no_trials())
        super()._process()

    def _no_trials(self) -> str:
        return no_trials(self.root)
