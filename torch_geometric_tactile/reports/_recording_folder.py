r"""Summaries of the recordings in a folder."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._gaps import RATE_TOLERANCE
from torch_geometric_tactile.data._taxel_faults import TaxelFaults, find_taxel_faults
from torch_geometric_tactile.datasets._recording_tables import RecordingTables, table_paths
from torch_geometric_tactile.datasets._trial import DEFAULT_PATTERN, checked_pattern
from torch_geometric_tactile.io import read_lerobot, read_recording
from torch_geometric_tactile.io._folder_recordings import RECORDING_SUFFIXES, list_recordings
from torch_geometric_tactile.io.recording_files import select_format
from torch_geometric_tactile.reports._recording import (
    FAULT_NAMES,
    format_fault,
    format_range,
    format_rows,
    gap_spans,
    unit_text,
)

# Limits of long lists, so that the summary stays readable.
_MAX_LINES = 12
_MAX_FILES = 4
_MAX_VALUES = 12
_MAX_TAXELS = 12
_LEROBOT_OPTIONS = ("tactile", "num_channels", "allow_large")


@dataclass(frozen=True)
class RecordingFacts:
    r"""The facts of one recording in a folder.

    Args:
        file (str): Path of the file, relative to the folder.
        format (str): Name of the format.
        num_frames (int): Number of frames.
        seconds (float): Time from the first to the last frame.
        rate (float, optional): Frames per second; :obj:`None` with fewer than two frames.
        num_gaps (int): Number of gaps.
        gap_seconds (float): Seconds without frames.
        num_taxels (int): Number of taxels.
        num_channels (int): Number of channels of a taxel.
        num_joints (int): Number of joint angles.
        unit (str, optional): Unit of the readings.
        range (tuple of float, optional): Smallest and largest reading.
        num_missing (int): Number of missing readings of a taxel in a frame.
        groups (dict): Values by name: the label, the object, the named groups of the file name
            and the columns of ``labels.csv``. A label column may have several values.
        annotations (tuple of str): Labels of the annotations.
        faults (TaxelFaults): Taxels that do not measure.
    """

    file: str
    format: str
    num_frames: int
    seconds: float
    rate: float | None
    num_gaps: int
    gap_seconds: float
    num_taxels: int
    num_channels: int
    num_joints: int
    unit: str | None
    range: tuple[float, float] | None
    num_missing: int
    groups: dict[str, list[Any]]
    annotations: tuple[str, ...]
    faults: TaxelFaults


@dataclass(frozen=True)
class FolderFacts:
    r"""The facts of the recordings in a folder, and an error message for each unreadable file.

    Args:
        folder (str): The folder.
        recordings (list of RecordingFacts): The recordings in the order of their names.
        unreadable (dict): Error messages by the path of the file, relative to the folder.
    """

    folder: str
    recordings: list[RecordingFacts] = field(default_factory=list)
    unreadable: dict[str, str] = field(default_factory=dict)


def read_folder(
    folder: PathLike,
    pattern: str | None = None,
    *,
    error_to_text: Callable[[Exception], str] = str,
    **options: Any,
) -> FolderFacts:
    r"""Reads the recordings in a folder one by one.

    As in :class:`~torch_geometric_tactile.datasets.RecordingFrames`, the recordings are in
    :obj:`folder/raw` or :obj:`folder`, with ``annotations.csv`` and ``labels.csv`` beside them.
    In a LeRobot data set, each episode is a recording.

    Args:
        folder (str or PathLike): The folder.
        pattern (str, optional): Regular expression that matches whole file names without suffix.
            Its named groups are listed. If it contains a :obj:`"/"`, files in subfolders are read
            as well. Defaults to the pattern of the data sets, ``<object>_<trial>``.
        error_to_text (callable): Converts the error of an unreadable file to text.
        **options: Options of :func:`~torch_geometric_tactile.io.read_recording`, or of
            :func:`~torch_geometric_tactile.io.read_lerobot`.

    Raises:
        ValueError: If there are no recordings, or a LeRobot data set cannot be read.
    """
    folder = Path(folder)
    if (folder / "meta/info.json").is_file():
        return _read_lerobot_folder(folder, pattern, options)
    pattern = checked_pattern(DEFAULT_PATTERN if pattern is None else pattern)
    is_recursive = "/" in pattern
    raw = folder / "raw"
    source = raw if raw.is_dir() and list_recordings(raw, is_recursive) else folder
    paths = list_recordings(source, is_recursive)
    if not paths:
        message = f"'{folder}' must hold recordings with one of {', '.join(RECORDING_SUFFIXES)}"
        if not list_recordings(source, recursive=True):
            raise ValueError(f"{message} (got none)")
        advice = (": to search subfolders, give a ", Argument("pattern"), " with a '/'")
        raise ArgumentError(f"{message} (got none)", *advice)
    facts = FolderFacts(str(folder))
    tables = []
    for table in table_paths({folder, source, *(path.parent for path in paths)}):
        try:
            tables.append(RecordingTables([table], source, paths))
        except (ValueError, OSError) as error:
            facts.unreadable[table.relative_to(folder).as_posix()] = error_to_text(error)
    for path in paths:
        file = path.relative_to(source)
        try:
            recording = read_recording(path, **options)
            labelled = recording
            for table_rows in tables:
                labelled = table_rows.add_to(labelled, path)
            groups = _groups(recording, labelled, re.fullmatch(pattern, _trial_name(file)))
            facts.recordings.append(
                _recording_facts(file.as_posix(), select_format(path, options), labelled, groups)
            )
        except (ValueError, OSError, ImportError) as error:
            facts.unreadable[file.as_posix()] = error_to_text(error)
    return facts


def _read_lerobot_folder(
    folder: Path, pattern: str | None, options: Mapping[str, Any]
) -> FolderFacts:
    names = [*options, *([] if pattern is None else ["pattern"])]
    unknown = next((name for name in names if name not in _LEROBOT_OPTIONS), None)
    if unknown is not None:
        valid_options = ", ".join(_LEROBOT_OPTIONS)
        raise ArgumentError(
            *(Argument(unknown), f" must be an option of a LeRobot data set: {valid_options} "),
            f"('{folder}')",
        )
    facts = FolderFacts(str(folder))
    for i, recording in enumerate(read_lerobot(folder, **options)):
        name = f"episode {recording.meta.get('episode', i)}"
        groups = _groups(recording, recording, None)
        facts.recordings.append(_recording_facts(name, "LeRobot episode", recording, groups))
    return facts


def _trial_name(file: Path) -> str:
    return file.with_suffix("").as_posix()


def _recording_facts(
    file: str, file_format: str, recording: Recording, groups: dict[str, list[Any]]
) -> RecordingFacts:
    spans = gap_spans(recording)
    tactile = recording.tactile
    has_readings = tactile.size > 0 and not np.isnan(tactile).all()
    return RecordingFacts(
        file=file,
        format=file_format,
        num_frames=recording.num_frames,
        seconds=recording.duration,
        rate=recording.rate if math.isfinite(recording.rate) else None,
        num_gaps=len(spans),
        gap_seconds=sum(end - start for start, end in spans),
        num_taxels=recording.num_taxels,
        num_channels=recording.num_channels,
        num_joints=recording.num_joints,
        unit=recording.meta.get("unit"),
        range=(float(np.nanmin(tactile)), float(np.nanmax(tactile))) if has_readings else None,
        num_missing=int(recording.missing.sum()),
        groups=groups,
        annotations=tuple(annotation.label for annotation in recording.annotations),
        faults=find_taxel_faults(tactile),
    )


def _groups(
    recording: Recording, labelled: Recording, match: re.Match[str] | None
) -> dict[str, list[Any]]:
    # The label, the object and further groups, including values from tables beside the recording.
    named = {} if match is None else {k: v for k, v in match.groupdict().items() if v is not None}
    values = {**named, **labelled.meta}
    columns = [key for key in labelled.meta if key not in recording.meta]
    label = named.get("label") if labelled.label is None else labelled.label
    groups = {"label": [] if label is None else [label]}
    groups |= {key: [values[key]] for key in ("object", *named, *columns) if key in values}
    for key, column in recording.privileged.items():
        if column.ndim == 1 and column.dtype.kind == "U":
            groups[key] = np.unique(column).tolist()
    return groups | {"label": groups["label"] if label is None else [label]}


def describe_folder(facts: FolderFacts) -> str:
    r"""Returns the facts of a folder as lines of text."""
    recordings = facts.recordings
    rows: list[tuple[str, Sequence[str]]] = [("folder", [facts.folder])]
    formats = f": {_count_values(r.format for r in recordings)}" if recordings else ""
    rows.append(("files", [f"{len(recordings)}{formats}"]))
    if recordings:
        rows += _measured_rows(recordings)
        rows += _group_rows(recordings)
        rows += [
            (name, _fault_lines({r.file: getattr(r.faults, key) for r in recordings}))
            for key, name in FAULT_NAMES.items()
        ]
    lines = [f"{file}: {message}" for file, message in facts.unreadable.items()]
    if lines:
        rows.append(("unreadable", [str(len(lines)), *lines]))
    return format_rows(rows)


def _measured_rows(recordings: Sequence[RecordingFacts]) -> Iterator[tuple[str, Sequence[str]]]:
    num_frames = sum(r.num_frames for r in recordings)
    yield "frames", [f"{num_frames:,} in {sum(r.seconds for r in recordings):.6g} s"]
    yield "rate", _rate_lines(recordings)
    gaps = [r.file for r in recordings if r.num_gaps]
    text = f"{sum(r.num_gaps for r in recordings)}, "
    text += f"{sum(r.gap_seconds for r in recordings):.2f} s without frames, in "
    yield "gaps", [text + _format_files(gaps, len(recordings))] if gaps else []
    yield (
        "taxels",
        _lines_by_file(recordings, lambda r: f"{r.num_taxels} of {r.num_channels} channels"),
    )
    ranges = [value for r in recordings if r.range is not None for value in r.range]
    yield "readings", [format_range(np.array(ranges))]
    yield "unit", _lines_by_file(recordings, lambda r: unit_text(r.unit))
    yield "joints", _lines_by_file(recordings, lambda r: str(r.num_joints or "none"))
    missing = [r.file for r in recordings if r.num_missing]
    num_missing = sum(r.num_missing for r in recordings)
    num_readings = sum(r.num_frames * r.num_taxels for r in recordings)
    if missing:
        text = f"{num_missing:,} of {num_readings:,} readings of a taxel in a frame "
        text += f"({100 * num_missing / num_readings:.3g} %), in "
        text += _format_files(missing, len(recordings))
    yield "missing", [text] if missing else []


def _group_rows(recordings: Sequence[RecordingFacts]) -> Iterator[tuple[str, Sequence[str]]]:
    names = dict.fromkeys(name for r in recordings for name in r.groups)
    for name in names:
        values = [value for r in recordings for value in r.groups.get(name, ())]
        num_without = sum(not r.groups.get(name) for r in recordings)
        text = _count_values(values)
        if values and num_without:
            text += f"; none in {num_without}"
        yield name, [text]
    labels = [label for r in recordings for label in r.annotations]
    annotated = [r.file for r in recordings if r.annotations]
    if annotated:
        text = f"{_count_values(labels)}, in {_format_files(annotated, len(recordings))}"
        yield "annotations", [text]


def _count_values(values: Iterable[Any]) -> str:
    # As in "36: cup 24, mug 12", with the most frequent first.
    counts = Counter(map(str, values))
    if len(counts) > _MAX_VALUES and counts.most_common(1)[0][1] == 1:
        return f"{len(counts)} different, each once"
    items = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return short_list([f"{value} {count}" for value, count in items], _MAX_VALUES)


def _rate_lines(recordings: Sequence[RecordingFacts]) -> list[str]:
    # Rates that differ by less than the tolerance of the data sets count as one.
    rates = sorted((r.rate, r.file) for r in recordings if r.rate is not None)
    names: dict[str, str] = {r.file: "unknown" for r in recordings}
    while rates:
        alike = [(rate, file) for rate, file in rates if rate <= rates[0][0] * (1 + RATE_TOLERANCE)]
        slowest, fastest = f"{alike[0][0]:.4g}", f"{alike[-1][0]:.4g}"
        text = slowest if slowest == fastest else f"{slowest} to {fastest}"
        names |= {file: f"{text} per second" for _, file in alike}
        rates = rates[len(alike) :]
    return _lines_by_file(recordings, lambda r: names[r.file])


def _lines_by_file(
    recordings: Sequence[RecordingFacts], describe: Callable[[RecordingFacts], str]
) -> list[str]:
    # One line if all files have the same text, else a line for each text. The files with the most
    # frequent text are not named.
    files_of_text: dict[str, list[str]] = {}
    for recording in recordings:
        files_of_text.setdefault(describe(recording), []).append(recording.file)
    if len(files_of_text) == 1:
        return [*files_of_text]
    (common_text, common_files), *rarer_texts = sorted(
        files_of_text.items(), key=lambda item: -len(item[1])
    )
    lines = [f"{text} in {_format_files(files, len(recordings))}" for text, files in rarer_texts]
    return _shortened([f"{common_text} in {len(common_files)} of {len(recordings)} files", *lines])


def _fault_lines(faults_of_file: Mapping[str, Sequence[Any]]) -> list[str]:
    # Taxels that are faulty in the same files share a line.
    files_of_taxel: dict[Any, list[str]] = {}
    for file, faults in faults_of_file.items():
        for taxel in faults:
            files_of_taxel.setdefault(taxel, []).append(file)
    taxels_of_files: dict[tuple[str, ...], list[Any]] = {}
    for taxel in sorted(files_of_taxel):
        taxels_of_files.setdefault(tuple(files_of_taxel[taxel]), []).append(taxel)
    ordered = sorted(taxels_of_files.items(), key=lambda item: -len(item[0]))
    return _shortened(
        f"{short_list(taxels, _MAX_TAXELS, format_fault)} in "
        f"{_format_files(files, len(faults_of_file))}"
        for files, taxels in ordered
    )


def _format_files(files: Sequence[str], num_files: int) -> str:
    if len(files) == num_files:
        return "all files"
    return f"{len(files)} of {num_files} files: {short_list(files, _MAX_FILES, printable)}"


def _shortened(lines: Iterable[str]) -> list[str]:
    lines = [*lines]
    num_hidden = len(lines) - _MAX_LINES
    return lines[:_MAX_LINES] + ([f"and {num_hidden} more lines"] if num_hidden > 0 else [])
