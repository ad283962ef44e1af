r"""Pictures of predictions, in the folder of their table."""

import os
from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial
from torch_geometric_tactile.visualization._trial_figure import draw_trial
from torch_geometric_tactile.visualization._truth import Truth
from torch_geometric_tactile.visualization.figure import save_figure

MAX_PICTURES = 20  # limits the time of drawing; further recordings are only counted


class PredictionPictures:
    r"""The pictures of the first :obj:`MAX_PICTURES` recordings.

    The pictures are drawn after the table is written. The readings are not stored, so that memory
    use does not grow.
    """

    def __init__(self, table: PathLike) -> None:
        self._table = Path(table)
        self._trials: list[tuple[str, PredictedTrial]] = []
        self.num_left_out = 0

    def add(
        self,
        predictor: Predictor,
        path: PathLike,
        recording: Recording,
        probability: Tensor,
        frames: Sequence[int],
        truth: Truth | None,
    ) -> None:
        r"""Stores the predictions of a recording, and its true classes or numbers. Recordings
        without frames are skipped.

        Shapes:
            - **probability:** :math:`(R, C)`
            - **frames:** The last frame of each row :math:`(R,)`.
        """
        if recording.num_frames == 0:
            return
        if len(self._trials) == MAX_PICTURES:
            self.num_left_out += 1
            return
        name = Path(os.fsdecode(path)).stem
        trial = PredictedTrial.from_predictions(predictor, recording, probability, frames, truth)
        self._trials.append((name, trial))

    def write(self) -> list[Path]:
        r"""Draws the pictures and returns their paths. Pictures are named after the table and, if
        there are several recordings, after the recording.
        """
        paths: list[Path] = []
        for name, trial in self._trials:
            path = self._path(name, paths)
            save_figure(draw_trial(trial), path)
            paths.append(path)
        return paths

    def _path(self, name: str, paths: Sequence[Path]) -> Path:
        table = self._table
        stem = table.name[:-4] if table.suffix.lower() == ".csv" else table.name
        if len(self._trials) == 1 and self.num_left_out == 0:
            return table.with_name(f"{stem}.png")
        used_names = {path.name.casefold() for path in paths}
        names = [f"{stem}-{name}.png", *(f"{stem}-{name}-{i}.png" for i in range(2, 99))]
        return table.with_name(next(n for n in names if n.casefold() not in used_names))
