r"""Pictures of what a model predicted over the time of a recording."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial
from torch_geometric_tactile.visualization._trial_figure import draw_trial
from torch_geometric_tactile.visualization._truth import Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_predictions(
    predictor: Predictor,
    recording: Recording,
    probability: torch.Tensor | np.ndarray | None = None,
    frames: Sequence[int] | None = None,
    truth: Sequence[str] | np.ndarray | None = None,
) -> "Figure":
    r"""Draws what a model predicts over the time of a recording: the probabilities, bands of the
    predicted and of the true class, the annotations, each label in a lane, the number of taxels in
    contact, and the total pressure.

    The answer of a model of windows stands from the last frame of its window to that of the next
    one. Where a probability is NaN, the line has a gap. If there are more classes than colours,
    those that were most often the most probable or the true ones are drawn, and the sum of all
    others in grey. Labels have a band each, below which a thin one is the truth; of a regression
    the predicted numbers are drawn, and pale the true ones. If there are more answers than
    pixels, lines show the least and the greatest value of each few, bands the most frequent class.

    The truth is the label of the recording, its annotations, a privileged signal or a text of the
    metadata, whichever comes first of those that hold names of classes and nothing else; frames
    outside of all annotations are of the class :obj:`"none"` if there is one, else unknown; of
    labels and numbers the metadata's :obj:`"labels"` and the signals and numbers of their names.
    The figure says which.

    A taxel is in contact if a channel is beyond the threshold of
    :class:`~torch_geometric_tactile.transforms.ContactCrop` for three frames, with its floor of 5
    where the unit is counts, or not told while all readings are whole numbers, and without a floor
    otherwise. The first half second, or a tenth of a shorter recording, but ten frames or more,
    counts as rest; a recording with fewer than three more has no contact. The total pressure is the
    sum of the Euclidean norms of all taxels, relative to the rest as in :func:`plot_recording`;
    missing readings count as rest.

    Args:
        predictor (Predictor): The predictor. If it measures sessions, adapt it first.
        recording (Recording): The recording.
        probability (torch.Tensor or numpy.ndarray, optional): What
            :meth:`~torch_geometric_tactile.predictor.Predictor.recording` returned of it
            :math:`(R, C)`; computed if left out.
        frames (sequence of int, optional): The last frame of each row of :obj:`probability`
            :math:`(R,)`; if left out, those of the predictor's windows, or all frames.
        truth (sequence of str or numpy.ndarray, optional): The true class of each frame
            :math:`(T,)`, an empty text where it is unknown; of labels or a regression numbers
            :math:`(T, C)`, NaN where they are unknown. Found in the recording if left out.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If the recording has no frame or does not fit the predictor, or
            :obj:`probability`, :obj:`frames` or :obj:`truth` has another shape or order.

    Examples:
        >>> from torch_geometric_tactile.nn import TactileFNN
        >>> from torch_geometric_tactile.sensors import grid
        >>> model = TactileFNN(4, 2, channels={"tactile": 1}, widths=(5,), pools=(1,))
        >>> predictor = Predictor(model, grid(2, 2, pitch=0.01), class_names=("hold", "slip"))
        >>> recording = Recording(np.arange(40) / 10, np.zeros((40, 4, 1)), label="hold")
        >>> figure = plot_predictions(predictor, recording)
        >>> [ax.get_ylabel() for ax in figure.axes][0]
        'probability'
    """
    need(
        recording.num_frames > 0, "'recording' must hold at least one frame to be drawn (got none)"
    )
    if frames is None:
        windows = None if predictor.window is None else predictor.windows(recording)
        frames = range(recording.num_frames) if windows is None else windows[1].tolist()
    if probability is None:
        probability = predictor.recording(recording)
    rows = torch.as_tensor(probability)
    last = np.asarray(frames)
    if rows.dim() != 2 or rows.size(1) == 0 or last.shape != (len(rows),):
        raise ValueError(
            f"'probability' must have shape (num_answers, num_classes), a row for each of the "
            f"{len(last)} 'frames' (got {tuple(rows.shape)})"
        )
    inside = (last >= 0) & (last < recording.num_frames)
    if len(last) and (
        last.dtype.kind not in "iu" or not inside.all() or (np.diff(last) <= 0).any()
    ):
        raise ValueError(
            f"'frames' must be increasing whole numbers from 0 to {recording.num_frames - 1}, "
            f"frames of the recording (got {last.tolist()!r:.60})"
        )
    given = None if truth is None else _checked_truth(truth, predictor, recording, rows.size(1))
    return draw_trial(PredictedTrial.of(predictor, recording, rows, last.tolist(), given))


def _checked_truth(
    truth: Sequence[str] | np.ndarray, predictor: Predictor, recording: Recording, size: int
) -> Truth:
    value = np.asarray(truth)
    if predictor.task == "multiclass":
        is_right = value.shape == (recording.num_frames,) and value.dtype.kind == "U"
        wanted = f"the name of a class for each of the {recording.num_frames} frames"
    else:
        is_right = value.shape == (recording.num_frames, size) and value.dtype.kind in "biuf"
        wanted = f"numbers of shape {(recording.num_frames, size)}"
    need(is_right, f"'truth' must be {wanted}", f"{value.dtype} of shape {value.shape}")
    return Truth(value if value.dtype.kind == "U" else value.astype(np.float64), "given")
