r"""Predictions as a table."""

import csv
import itertools
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording, StaticData, StaticDataset
from torch_geometric_tactile.data._column_order import column_names, in_column_order
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._csv_table import safe_cell
from torch_geometric_tactile.io.recording_files import chosen_format, format_options
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._prediction_pictures import PredictionPictures

_BATCH_SIZE = 256

# The first cells of a row, its probabilities, and whether it lacks contact, if a rule tells it.
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
    r"""Writes a row for each frame of some recordings: file, frame, time, prediction and
    probabilities. With a model of windows, a row for each window, with its last frame. What
    pictures show is added to them. A recording of another rate is resampled if asked for.
    """

    def rows() -> _Rows:
        columns: dict[str, list[str]] = {}
        for path in paths:
            recording = open_recording(predictor, path, options)
            try:
                recording = predictor.preparation.match_recording(
                    in_column_order(recording, columns), resample=resample
                )
                columns = {**column_names(recording), **columns}
                frames: Sequence[int] = range(recording.num_frames)
                if adapt:
                    predictor.adapt_recording(recording, rest=rest)
                if predictor.window is not None:
                    frames = predictor.windows(recording)[1].tolist()
                probability = predictor.recording(recording, _BATCH_SIZE)
            except ValueError as error:
                hint = _hint(str(error), path, predictor.info.rest)
                raise ValueError(f"'{path}': {error}{hint}") from error
            if pictures is not None:
                pictures.add(predictor, path, recording, probability, frames)
            free: Iterable[Tensor | None] = [None] * len(probability)
            if predictor.contact is not None:
                free = predictor.lacks_contact(recording)
            for i, row, is_free in zip(frames, probability, free, strict=True):
                yield [cell_text(os.fspath(path)), i, f"{recording.time[i]:.6f}"], row, is_free

    return _write(predictor, ["recording", "frame", "time"], rows(), out)


def open_recording(
    predictor: Predictor, path: PathLike, options: Mapping[str, Any] | None = None
) -> Recording:
    r"""Reads a recording with the options of the training, as far as its format has them, and with
    those that are given.
    """
    chosen = options or {}
    merged = {**predictor.read_options, **chosen}
    taken = format_options(chosen_format(path, merged))
    used = {k: v for k, v in merged.items() if k in taken or k in chosen}
    try:
        return read_recording(path, **used)
    except ValueError as error:
        raise ValueError(f"{error}{_hint(str(error), path)}") from error


def _hint(error: str, path: PathLike, rest: float | None = None) -> str:
    seconds = "SECONDS" if rest is None else f"{rest:.3g}"
    if re.search("the contact rule (compares|must have)", error):
        return (
            f"; add '--rest {seconds}' if nothing touches the sensor in the first {seconds} s of "
            "each recording"
        )
    if "call 'adapt'" in error:
        return f"; 'tactile predict --rest {seconds}' and '--adapt' do so"
    if Path(path).suffix.lower() == ".csv" and re.search(r"must have (the col|\d+ taxels)", error):
        return (
            "; say which columns of this file are those of the training by '--tactile', '--joint', "
            "'--num-channels' and '--ignore', as to 'tactile inspect'"
        )
    return ""


def write_samples(predictor: Predictor, samples: StaticDataset, out: PathLike) -> Counter[str]:
    r"""Writes a row for each sample of a data set: index, prediction and probabilities."""

    def rows() -> _Rows:
        number = itertools.count()
        for logits, _ in predicted(predictor, samples):
            for probability in predictor.probability(logits):
                yield [next(number)], probability, None

    return _write(predictor, ["index"], rows(), out)


def predicted(predictor: Predictor, samples: StaticDataset) -> Iterator[tuple[Tensor, StaticData]]:
    r"""Yields the logits of some samples after the others, with the samples as the model
    saw them.
    """
    for index in torch.arange(len(samples)).split(_BATCH_SIZE):
        with torch.inference_mode():
            data = predictor.prepare_samples(samples.batch(index))
            logits = predictor.logits(data)
        yield logits, data


def _write(predictor: Predictor, head: Sequence[str], rows: _Rows, out: PathLike) -> Counter[str]:
    has_labels = predictor.task != "regression"
    count: Counter[str] = Counter()
    with atomic_path(out) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for cells, probability, lacks_contact in rows:
            has_labels = has_labels or lacks_contact is not None
            if not count:
                names = predictor.names(len(probability))
                prefix = "" if predictor.task == "regression" else "p_"
                label = ["prediction"] if has_labels else []
                writer.writerow([*head, *label, *(cell_text(f"{prefix}{name}") for name in names)])
            labels = predictor.labels(probability, lacks_contact)[0] if has_labels else []
            prediction = ";".join(labels)
            count[prediction] += 1
            numbers = [f"{value:.6f}" for value in probability.tolist()]
            writer.writerow([*cells, *([cell_text(prediction)] if has_labels else []), *numbers])
        need(count, "there must be at least one frame to predict (got none)")
    return count


def cell_text(text: str) -> str:
    r"""Returns a name for a cell of a CSV file: a class may be called -1, and the name of a file
    may be no text.
    """
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if re.fullmatch(r"[+-]?[0-9.]+", text) else safe_cell(text)


def describe_counts(count: Counter[str], out: PathLike, of_windows: bool = False) -> str:
    r"""Returns what was written, in words."""
    total = sum(count.values())
    parts: Iterable[str] = (f"{name or 'none'} {n}" for name, n in count.most_common(8))
    more = ", ..." if len(count) > 8 else ""
    counts = "" if set(count) == {""} else f": {', '.join(parts)}{more}"
    unit = "window" if of_windows else "frame"
    return f"{Path(out)}: {total} {unit}{'s' if total > 1 else ''}{counts}"
