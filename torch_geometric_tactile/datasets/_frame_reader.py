r"""Recordings one after the other, as frames and trials."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._column_order import column_names, in_column_order
from torch_geometric_tactile.datasets._frame_files import FrameFiles
from torch_geometric_tactile.datasets._trial import Trial, check_together, make_trial
from torch_geometric_tactile.sensors import TaxelLayout

SUFFIXES = (".h5", ".hdf5", ".npz", ".mcap", ".csv")
_logger = logging.getLogger(__name__)


def trial_files(folder: Path, pattern: str, suffixes: Sequence[str] = SUFFIXES) -> list[str]:
    r"""Returns the names of the recordings in a folder, in order; also those in its subfolders,
    with their names in front, if the pattern has a :obj:`"/"`.
    """
    if not folder.is_dir():
        return []
    found = list(folder.rglob("*") if "/" in pattern else folder.iterdir())
    for path in found:
        if path.suffix.lower() in suffixes and path.is_symlink() and not path.exists():
            raise FileNotFoundError(f"'{path}' is a link to a file that is not there: remove it")
    names = [
        path.relative_to(folder)
        for path in found
        if path.suffix.lower() in suffixes and path.is_file()
    ]
    return sorted(
        name.as_posix()
        for name in names
        if name.parts[0] != "processed" and not any(part.startswith(".") for part in name.parts)
    )


def trial_folder(root: Path, pattern: str, suffixes: Sequence[str] = SUFFIXES) -> Path:
    r"""Returns the folder of the recordings: :obj:`root/raw`, or :obj:`root` where only that has
    some.
    """
    inner = root / "raw"
    if not trial_files(inner, pattern, suffixes) and trial_files(root, pattern, suffixes):
        return root
    return inner


def opened_files(
    folder: Path, paths: Sequence[str], read: Callable[[str], Recording]
) -> Iterator[tuple[str, str, Recording]]:
    r"""Yields what to call each recording in messages, its name, and the recording."""
    for path in paths:
        name = Path(path).relative_to(folder).with_suffix("").as_posix()
        yield f"'{path}'", name, read(path)


def opened_recordings(
    recordings: Sequence[Recording],
) -> Iterator[tuple[str, str, Recording]]:
    r"""Yields what to call each recording in messages, its name, and the recording."""
    for i, recording in enumerate(recordings):
        yield f"recording {i}", str(i), recording


def no_trials(root: PathLike) -> str:
    r"""Returns the message of an error about a data set without recordings."""
    return (
        f"there are no trials in '{Path(root, 'raw')}' or '{root}': put recordings there, "
        f"<object>_<number> with one of {', '.join(SUFFIXES)}"
    )


@dataclass(frozen=True)
class FrameReader:
    r"""What recordings must be to be read as frames."""

    layout: TaxelLayout
    pattern: str
    needs: tuple[str, ...] = ()
    num_channels: int | None = None
    num_joints: int | None = None
    unit: str | None = None

    def read(
        self, recordings: Iterable[tuple[str, str, Recording]], folder: Path | None
    ) -> tuple[Tensor, list[Trial]]:
        r"""Returns the readings of all frames, mapped from a temporary file, and the trials.
        Columns with names are in the order of the first recording that knows them.

        Shapes:
            - **output:** readings :math:`(S, N, C)`
        """
        trials: list[Trial] = []
        num_missing, num_channels = 0, self.num_channels
        columns: dict[str, list[str]] = {}
        with FrameFiles(folder) as files:
            for where, name, given in recordings:
                try:
                    recording = in_column_order(given, columns)
                    columns = {**column_names(recording), **columns}
                except ValueError as error:
                    raise ValueError(f"{where}: {error}") from error
                trials.append(self._trial(where, name, recording))
                num_channels = num_channels or recording.num_channels
                if recording.num_channels != num_channels:
                    raise ValueError(
                        f"{where} must have {num_channels} channels a taxel, as {trials[0].where} "
                        f"(got {recording.num_channels})"
                    )
                files.add("x", recording.tactile)
                num_missing += int(recording.missing.sum())
            if not trials:
                raise ValueError("'recordings' must hold at least one recording (got none)")
            num_frames = sum(trial.num_frames for trial in trials)
            x = files.tensor("x")
        if num_missing:
            _logger.warning(
                "%d of %d readings of taxels are missing (NaN); see FillMissing and DropTaxels",
                num_missing,
                num_frames * self.layout.num_taxels,
            )
        check_together(trials, self.unit)
        return x, trials

    def _trial(self, where: str, name: str, recording: Recording) -> Trial:
        trial = make_trial(
            recording,
            self.layout,
            where=where,
            name=name,
            pattern=self.pattern,
            needs=self.needs,
        )
        for what, count, expected in (
            ("channels a taxel", recording.num_channels, self.num_channels),
            ("joint angles a frame, in 'joint'", recording.num_joints, self.num_joints),
        ):
            if expected not in (None, count):
                raise ValueError(f"{where} must have {expected} {what} (got {count or 'none'})")
        return trial
