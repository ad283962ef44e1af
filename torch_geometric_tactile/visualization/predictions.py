r"""Pictures of model predictions over the time of a recording."""

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
    r"""Draws the predictions of a model over the time of a recording: probabilities, lanes of the
    predicted and the true class, annotations, number of taxels in contact, and total pressure.

    **Predictions.** The prediction for a window is drawn from the last frame of the window to the
    last frame of the next window. Lines have gaps where a probability is NaN. If there are more
    classes than colours, the most frequent predicted and true classes are drawn, and the sum of all
    other classes is grey. In a multilabel task, each label has a lane with a thin bar for the
    truth. A regression has lines for the predicted numbers and pale lines for the true numbers. If
    there are more predictions than pixels, lines show the smallest and the largest value of each
    pixel, and lanes show the most frequent class.

    **Truth.** The true class comes from the first of these sources that contains only class names:
    the label of the recording, its annotations, a privileged signal, a text in the metadata. Frames
    outside of all annotations have the class :obj:`"none"` if it exists; otherwise their class is
    unknown. True labels and numbers come from :obj:`"labels"` in the metadata, and from signals and
    numbers with the same names. The figure names the source.

    **Contact.** A taxel is in contact if a channel is beyond the threshold of
    :class:`~torch_geometric_tactile.transforms.ContactCrop` for three frames. The threshold is at
    least 5 if the unit is counts, or if it is unknown and all readings are whole numbers. Rest is
    the first half second, or a tenth of a shorter recording, but at least ten frames. A recording
    with fewer than three further frames has no contact.

    **Total pressure.** The total pressure is the sum of the Euclidean norms of all taxels, relative
    to the rest as in :func:`plot_recording`. Missing readings count as rest.

    Args:
        predictor (Predictor): The predictor. If it measures sessions, adapt it first.
        recording (Recording): The recording.
        probability (torch.Tensor or numpy.ndarray, optional): Output of
            :meth:`~torch_geometric_tactile.predictor.Predictor.recording` for the recording
            :math:`(R, C)`. Computed if left out.
        frames (sequence of int, optional): Index of the last frame of each row of
            :obj:`probability` :math:`(R,)` (default: the last frames of the predictor's windows, or
            all frames).
        truth (sequence of str or numpy.ndarray, optional): The true class of each frame
            :math:`(T,)`, or an empty text where it is unknown. For labels or a regression, numbers
            :math:`(T, C)`, which are NaN where unknown (default: the truth in the recording).

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If the recording has no frames or does not fit the predictor, or if the shape or
            order of :obj:`probability`, :obj:`frames` or :obj:`truth` is wrong.

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
            f"'probability' must have shape (num_answers, num_classes), with a row for each of the "
            f"{len(last)} 'frames' (got {tuple(rows.shape)})"
        )
    exists = (last >= 0) & (last < recording.num_frames)
    if len(last) and (
        last.dtype.kind not in "iu" or not exists.all() or (np.diff(last) <= 0).any()
    ):
        raise ValueError(
            f"'frames' must be increasing whole numbers from 0 to {recording.num_frames - 1}, "
            f"frames of the recording (got {last.tolist()!r:.60})"
        )
    true = None if truth is None else _checked_truth(truth, predictor, recording, rows.size(1))
    trial = PredictedTrial.from_predictions(predictor, recording, rows, last.tolist(), true)
    return draw_trial(trial)


def _checked_truth(
    truth: Sequence[str] | np.ndarray, predictor: Predictor, recording: Recording, size: int
) -> Truth:
    value = np.asarray(truth)
    if predictor.task == "multiclass":
        is_valid = value.shape == (recording.num_frames,) and value.dtype.kind == "U"
        requirement = f"the name of a class for each of the {recording.num_frames} frames"
    else:
        is_valid = value.shape == (recording.num_frames, size) and value.dtype.kind in "biuf"
        requirement = f"numbers of shape {(recording.num_frames, size)}"
    need(is_valid, f"'truth' must be {requirement}", f"{value.dtype} of shape {value.shape}")
    return Truth(value if value.dtype.kind == "U" else value.astype(np.float64), "given")
