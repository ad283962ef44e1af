r"""True classes or numbers of a recording, from its content or the name of its file."""

import os
from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.predictor._file_names import FileNameForm
from torch_geometric_tactile.visualization._truth import Truth, find_truth

_FILE_NAME = FileNameForm("{object}_{trial}", "object")  # the usual form, if none is known


def recording_truth(
    predictor: Predictor, path: PathLike, recording: Recording, names: Sequence[str]
) -> Truth | None:
    r"""Returns the true classes or numbers of the frames of a recording, or :obj:`None` if they are
    unknown.

    Args:
        predictor (Predictor): The predictor, which stores the form of the file names in training.
        path (str or PathLike): The file of the recording.
        recording (Recording): The recording.
        names (sequence of str): Names of the outputs of the model.
    """
    truth = find_truth(recording, names, predictor.task)
    label = None if truth is not None else class_in_name(predictor, path, names)
    return truth if label is None else Truth(np.full(recording.num_frames, label), "file name")


def class_in_name(predictor: Predictor, path: PathLike, names: Sequence[str]) -> str | None:
    r"""Returns the class in the name of a file, or :obj:`None` if the name contains no class."""
    if predictor.task != "multiclass":
        return None
    form = predictor.preparation.file_names or _FILE_NAME
    return form.find_class(os.fsdecode(path), names)
