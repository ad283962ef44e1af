r"""Tables of predictions as CSV files."""

import csv
import itertools
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import GroupedError, need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording, StaticData, StaticDataset
from torch_geometric_tactile.data._column_order import column_names, in_column_order
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._csv_table import text_to_cell
from torch_geometric_tactile.io.recording_files import format_options, select_format
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._prediction_pictures import PredictionPictures
from torch_geometric_tactile.reports._recording_truth import class_in_name, recording_truth
from torch_geometric_tactile.visualization._truth import Truth

_BATCH_SIZE = 256

# The first cells of a row, its probabilities, and whether it has no contact (None without a rule).
_Rows = Iterator[tuple[list[Any], Tensor, Tensor | None]]


def write_recordings(
    predictor: Predictor,
    paths: Sequence[PathLike],
    out: PathLike,
    adapt: bool = False,
    rest: float | None = None,
    options: Mapping[str, Any] | None = None,
    pictures: PredictionPictures | None = None,
    resample: bool = False,
) -> Counter[str]:
    r"""Writes a row for each frame of all recordings: file, frame, time, prediction and
    probabilities. For a model that reads windows, a row is a window and names its last frame. The
    true class is a further column if the name of a file or the first recording contains it.

    The predictions are also added to the pictures. With :obj:`resample`, recordings are resampled
    to the frame rate of the training data.

    Raises:
        UnpredictedRecordingsError: If there are several recordings and some cannot be predicted.
            The error is raised after the table of the others is written. There is no table if no
            recording has predictions.
        ValueError: If the only recording cannot be predicted.
    """
    problems: list[OSError | ValueError] = []

    def predicted_recordings() -> Iterator[_PredictedRecording]:
        columns: dict[str, list[str]] = {}
        for path in paths:
            try:
                predicted = _predict_recording(
                    predictor,
                    path,
                    open_recording(predictor, path, options),
                    columns,
                    adapt=adapt,
                    rest=rest,
                    resample=resample,
                )
            except (OSError, ValueError) as error:
                if len(paths) == 1:
                    raise
                problems.append(error)
                continue
            # The first recording with named columns sets their order for all others.
            columns = {**column_names(predicted.recording), **columns}
            if pictures is not None:
                pictures.add(
                    predictor,
                    path,
                    predicted.recording,
                    predicted.probability,
                    predicted.frames,
                    predicted.truth,
                )
            yield predicted

    recordings = predicted_recordings()
    first = next(recordings, None)
    if first is None and problems:
        raise UnpredictedRecordingsError(problems, len(paths), Counter())
    has_label = predictor.task == "multiclass" and (
        (first is not None and first.truth is not None)
        or any(class_in_name(predictor, path, predictor.class_names) for path in paths)
    )
    first_columns = ["recording", "frame", "time", *(["label"] if has_label else [])]
    rows = (
        row
        for predicted in itertools.chain([first] if first else [], recordings)
        for row in predicted.rows(has_label)
    )
    count = _write_rows(predictor, first_columns, rows, out)
    if problems:
        raise UnpredictedRecordingsError(problems, len(paths), count)
    return count


class UnpredictedRecordingsError(GroupedError):
    r"""An error that lists the recordings that cannot be predicted. It is raised after the table of
    the other recordings is written.

    Args:
        errors (sequence of Exception): One error for each recording, with the name of its file.
        num_recordings (int): Number of all recordings.
        count (Counter): Number of rows of the table by prediction; empty if there is no table.
    """

    def __init__(
        self, errors: Sequence[OSError | ValueError], num_recordings: int, count: Counter[str]
    ) -> None:
        super().__init__(
            f"{len(errors)} of {num_recordings} recordings have no predictions", errors
        )
        self.count = count


class _PredictedRecording(NamedTuple):
    # A predicted recording, and the last frame of each row of probabilities.
    path: PathLike
    recording: Recording
    frames: Sequence[int]
    probability: Tensor
    lacks_contact: Iterable[Tensor | None]
    truth: Truth | None

    def rows(self, has_label: bool) -> _Rows:
        cells = zip(self.frames, self.probability, self.lacks_contact, strict=True)
        for frame, row, is_free in cells:
            first_cells = [cell_text(os.fspath(self.path)), frame]
            first_cells.append(f"{self.recording.time[frame]:.6f}")
            if has_label:
                label = "" if self.truth is None else str(self.truth.value[frame])
                first_cells.append(cell_text(label))
            yield first_cells, row, is_free


def _predict_recording(
    predictor: Predictor,
    path: PathLike,
    recording: Recording,
    columns: Mapping[str, list[str]],
    *,
    adapt: bool,
    rest: float | None,
    resample: bool,
) -> _PredictedRecording:
    try:
        recording = predictor.preparation.match_recording(
            in_column_order(recording, columns), resample=resample
        )
        frames: Sequence[int] = range(recording.num_frames)
        if adapt:
            predictor.adapt_recording(recording, rest=rest)
        if predictor.window is not None:
            frames = predictor.windows(recording)[1].tolist()
        probability = predictor.recording(recording, _BATCH_SIZE)
        lacks_contact: Iterable[Tensor | None] = [None] * len(probability)
        if predictor.contact is not None:
            lacks_contact = predictor.lacks_contact(recording)
    except ValueError as error:
        hint = _hint(str(error), path, predictor.info.rest)
        raise ValueError(f"'{path}': {error}{hint}") from error
    names = predictor.names(probability.size(1))
    truth = recording_truth(predictor, path, recording, names)
    return _PredictedRecording(path, recording, frames, probability, lacks_contact, truth)


def open_recording(
    predictor: Predictor, path: PathLike, options: Mapping[str, Any] | None = None
) -> Recording:
    r"""Reads a recording with :obj:`options`, and with the options used in training that its file
    format supports.
    """
    explicit = options or {}
    merged_options = {**predictor.read_options, **explicit}
    supported = format_options(select_format(path, merged_options))
    selected = {k: v for k, v in merged_options.items() if k in supported or k in explicit}
    try:
        return read_recording(path, **selected)
    except ValueError as error:
        hint = _hint(str(error), path)
        if not hint:
            raise
        raise ValueError(f"{error}{hint}") from error


def _hint(error: str, path: PathLike, rest: float | None = None) -> str:
    seconds = "SECONDS" if rest is None else f"{rest:.3g}"
    if re.search("the contact rule (compares|must have)", error):
        return (
            f"; add '--rest {seconds}' if nothing touches the sensor in the first {seconds} s of "
            "each recording"
        )
    if "call 'adapt'" in error:
        return f"; use 'tactile predict --rest {seconds}' or '--adapt'"
    if Path(path).suffix.lower() == ".csv" and re.search(r"must have (the col|\d+ taxels)", error):
        return (
            "; name the columns of this file that match the training data with '--tactile', "
            "'--joint', '--num-channels' and '--ignore', as for 'tactile inspect'"
        )
    return ""


def write_samples(predictor: Predictor, samples: StaticDataset, out: PathLike) -> Counter[str]:
    r"""Writes one row per sample of a data set: index, prediction and probabilities."""

    def rows() -> _Rows:
        number = itertools.count()
        for logits, _ in predict_batches(predictor, samples):
            for probability in predictor.probability(logits):
                yield [next(number)], probability, None

    return _write_rows(predictor, ["index"], rows(), out)


def predict_batches(
    predictor: Predictor, samples: StaticDataset
) -> Iterator[tuple[Tensor, StaticData]]:
    r"""Yields the logits of a data set batch by batch, with the transformed samples."""
    for index in torch.arange(len(samples)).split(_BATCH_SIZE):
        with torch.inference_mode():
            data = predictor.prepare_samples(samples.batch(index))
            logits = predictor.logits(data)
        yield logits, data


def _write_rows(
    predictor: Predictor, first_columns: Sequence[str], rows: _Rows, out: PathLike
) -> Counter[str]:
    has_labels = predictor.task != "regression"
    count: Counter[str] = Counter()
    with atomic_path(out) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for cells, probability, lacks_contact in rows:
            # A regression has labels only for frames without contact.
            has_labels = has_labels or lacks_contact is not None
            if not count:
                names = predictor.names(len(probability))
                prefix = "" if predictor.task == "regression" else "p_"
                label = ["prediction"] if has_labels else []
                writer.writerow(
                    [*first_columns, *label, *(cell_text(f"{prefix}{name}") for name in names)]
                )
            labels = predictor.labels(probability, lacks_contact)[0] if has_labels else []
            prediction = ";".join(labels)
            count[prediction] += 1
            numbers = [f"{value:.6f}" for value in probability.tolist()]
            writer.writerow([*cells, *([cell_text(prediction)] if has_labels else []), *numbers])
        need(count, "there must be at least one frame to predict (got none)")
    return count


def cell_text(text: str) -> str:
    r"""Returns a name as a safe cell of a CSV file. The name of a class such as -1 is not escaped;
    the name of a file may contain bytes that are not text.
    """
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if re.fullmatch(r"[+-]?[0-9.]+", text) else text_to_cell(text)


def describe_counts(count: Counter[str], out: PathLike, has_windows: bool = False) -> str:
    r"""Returns a summary of a written table: its path, and the number of rows by prediction."""
    total = sum(count.values())
    parts: Iterable[str] = (
        f"{name or 'none'} {num_rows}" for name, num_rows in count.most_common(8)
    )
    ellipsis = ", ..." if len(count) > 8 else ""
    counts = "" if set(count) == {""} else f": {', '.join(parts)}{ellipsis}"
    unit = "window" if has_windows else "frame"
    return f"{Path(out)}: {total} {unit}{'s' if total > 1 else ''}{counts}"
