r"""Pictures of predictions, beside their table."""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial
from torch_geometric_tactile.visualization._trial_figure import draw_trial
from torch_geometric_tactile.visualization._truth import Truth, find_truth
from torch_geometric_tactile.visualization.figure import save_figure

MOST_PICTURES = 20
_OBJECT = r"(?P<object>.+)_\d+"  # as the names of files in data sets of recordings


class PredictionPictures:
    r"""What is drawn of some recordings once their table is written: of the first
    :obj:`MOST_PICTURES`, without their readings.
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
    ) -> None:
        r"""Keeps what is drawn of a recording; one without frames is left out.

        Shapes:
            - **probability:** :math:`(R, C)`
            - **frames:** The last frame of each row :math:`(R,)`.
        """
        if recording.num_frames == 0:
            return
        if len(self._trials) == MOST_PICTURES:
            self.num_left_out += 1
            return
        name = Path(os.fsdecode(path)).stem
        names = predictor.names(probability.size(1))
        truth = find_truth(recording, names, predictor.task) or _truth_of_name(
            name, recording, names, predictor.task
        )
        trial = PredictedTrial.from_predictions(predictor, recording, probability, frames, truth)
        self._trials.append((name, trial))

    def write(self) -> list[Path]:
        r"""Draws the pictures, and returns their files: beside the table and called as it, of
        several recordings each with its name.
        """
        written: list[Path] = []
        for name, trial in self._trials:
            path = self._path(name, written)
            save_figure(draw_trial(trial), path)
            written.append(path)
        return written

    def _path(self, name: str, written: Sequence[Path]) -> Path:
        table = self._table
        start = table.name[:-4] if table.suffix.lower() == ".csv" else table.name
        if len(self._trials) == 1 and self.num_left_out == 0:
            return table.with_name(f"{start}.png")
        taken = {path.name.casefold() for path in written}
        names = [f"{start}-{name}.png", *(f"{start}-{name}-{i}.png" for i in range(2, 99))]
        return table.with_name(next(n for n in names if n.casefold() not in taken))


def _truth_of_name(
    name: str, recording: Recording, names: Sequence[str], task: str
) -> Truth | None:
    found = re.fullmatch(_OBJECT, name)
    if found is None or task != "multiclass":
        return None
    said = replace(recording, meta={"file name": found["object"]}, privileged={})
    return find_truth(said, names, task)
