r"""Descriptions of recordings as text, and their pictures."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._annotations import GAP
from torch_geometric_tactile.data._taxel_faults import find_taxel_faults
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io.recording_files import select_format
from torch_geometric_tactile.visualization.figure import save_figure
from torch_geometric_tactile.visualization.recording import plot_recording

# Limits of long lists and texts, so that the description stays readable.
_MAX_INDICES = 12
_MAX_LINES = 20
_MAX_LETTERS = 100
#: The name of each fault in a description.
FAULT_NAMES = {
    "dead": "dead taxels",
    "constant": "constant",
    "saturated": "saturated",
    "equal": "equal",
}


def describe_recording(recording: Recording) -> str:
    r"""Returns the facts of a recording as lines of text.

    Examples:
        >>> print(describe_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3)), label="cup")))
        frames       2 in 0.1 s, 10 per second
        gaps         none
        taxels       4 of 3 channels
        readings     0 to 0 (unit unknown)
        joints       none
        missing      none
        dead taxels  none
        constant     none
        saturated    none
        equal        none
        label        cup
        metadata     none
        privileged   none
        extra        none
    """
    frames = str(recording.num_frames)
    if recording.num_frames > 1:
        frames += f" in {recording.duration:.6g} s, {recording.rate:.6g} per second"
    unit = unit_text(recording.meta.get("unit"))
    events = _event_lines(recording)
    missing, faults = recording.missing, find_taxel_faults(recording.tactile)
    missing_text = "none"
    if missing.any():
        missing_text = (
            f"{int(missing.sum()):,} of {missing.size:,} readings of a taxel in a frame "
            f"({100 * missing.mean():.3g} %)"
        )
    rows: list[tuple[str, Sequence[str]]] = [
        ("frames", [frames]),
        ("gaps", [_gap_line(recording)]),
        ("taxels", [f"{recording.num_taxels} of {recording.num_channels} channels"]),
        ("readings", [format_range(recording.tactile, unit)]),
        ("joints", _joint_lines(recording)),
        *([("actions", _action_lines(recording))] if recording.action is not None else []),
        ("missing", [missing_text]),
        *((name, [_format_faults(getattr(faults, key))]) for key, name in FAULT_NAMES.items()),
        ("label", ["none" if recording.label is None else str(recording.label)]),
        *([("annotations", _annotation_lines(recording))] if recording.annotations else []),
        *([("events", events)] if events else []),
        (
            "metadata",
            [
                f"{key} = {_shorten(value)}"
                for key, value in recording.meta.items()
                if key != "events" or not events
            ],
        ),
        (
            "privileged",
            [f"{name} {value.shape}" for name, value in recording.privileged.items()],
        ),
        ("extra", [f"{name} {value.shape}" for name, value in recording.extra.items()]),
    ]
    return format_rows(rows)


def format_rows(rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    r"""Returns rows as aligned lines of text, each after the name of its row.

    Examples:
        >>> print(format_rows([("label", ["cup"]), ("extra", [])]))
        label        cup
        extra        none
    """
    width = max(13, *(len(printable(name)) + 2 for name, _ in rows))
    return "\n".join(
        f"{printable(name) if i == 0 else '':<{width}}{printable(line)}"
        for name, lines in rows
        for i, line in enumerate(lines or ["none"])
    )


def unit_text(unit: object) -> str:
    r"""Returns the unit of readings in words.

    Examples:
        >>> unit_text("count"), unit_text(None)
        ('counts', '(unit unknown)')
    """
    return UNITS.get(str(unit), "(unit unknown)")


def describe_file(path: PathLike, **options: Any) -> tuple[Recording, str]:
    r"""Reads a recording from a file, and returns it with its facts as lines of text."""
    recording = read_recording(path, **options)
    return recording, (
        f"{'file':<13}{printable(path)}\n{'format':<13}{select_format(path, options)}\n"
        f"{describe_recording(recording)}"
    )


def draw_recording(recording: Recording, path: PathLike) -> None:
    r"""Draws a recording to a PNG file that is either complete or absent."""
    save_figure(plot_recording(recording), path)


def format_range(values: np.ndarray, unit: str = "") -> str:
    r"""Returns the range of numbers with their unit. Missing numbers are ignored.

    Examples:
        >>> format_range(np.array([0.5, np.nan, 2.0]), "newtons")
        '0.5 to 2 newtons'
    """
    present = values[~np.isnan(values)]
    if present.size == 0:
        return "none"
    return f"{_format_number(present.min())} to {_format_number(present.max())} {unit}".rstrip()


def _format_number(value: float) -> str:
    return str(int(value)) if value == int(value) else f"{value:.4g}"


def _joint_lines(recording: Recording) -> list[str]:
    if recording.joint is None:
        return []
    names = recording.meta.get("joint_names")
    if not isinstance(names, list) or len(names) != recording.num_joints:
        names = list(range(recording.num_joints))
    lines = [f"{recording.num_joints}, {format_range(recording.joint, 'rad')}"]
    return lines + [
        f"{name}: {format_range(recording.joint[:, i], 'rad')}" for i, name in enumerate(names)
    ]


def _action_lines(recording: Recording) -> list[str]:
    assert recording.action is not None
    names = recording.meta.get("action_names")
    if not isinstance(names, list) or len(names) != recording.num_actions:
        names = list(range(recording.num_actions))
    return [
        str(recording.num_actions),
        *(f"{name}: {format_range(recording.action[:, i])}" for i, name in enumerate(names)),
    ]


def gap_spans(recording: Recording) -> list[tuple[float, float]]:
    r"""Returns the start and the end, in seconds, of each gap between frames, and of gaps at the
    end, which only the annotations written by a recorder show.
    """
    spans = [(float(start), float(end)) for start, end in recording.gaps]
    spans += [
        (start, end)
        for start, end, label in recording.annotations
        if label == GAP and not any(start < b and a < end for a, b in spans)
    ]
    return spans


def _gap_line(recording: Recording) -> str:
    spans = gap_spans(recording)
    seconds = sum(end - start for start, end in spans)
    return f"{len(spans)}, {seconds:.2f} s without frames" if spans else "none"


def _annotation_lines(recording: Recording) -> list[str]:
    start, annotations = (
        float(recording.time[0]) if recording.num_frames else 0.0,
        recording.annotations,
    )
    return _limit_lines(
        [f"{a.start - start:.2f} to {a.end - start:.2f} s  {a.label}" for a in annotations]
    )


def _event_lines(recording: Recording) -> list[str]:
    # Metadata may hold anything under this name; only the events of recorders have these keys.
    events = recording.meta.get("events")
    if not isinstance(events, list) or not recording.num_frames:
        return []
    start, lines = float(recording.time[0]), []
    for event in events:
        if not isinstance(event, dict) or event.keys() != {"time", "kind", "text"}:
            return []
        if isinstance(event["time"], bool) or not isinstance(event["time"], int | float):
            return []
        text = _shorten(f"{event['kind']}  {event['text']}".rstrip())
        lines.append(f"{event['time'] - start:.2f} s  {text}")
    return _limit_lines(lines)


def _limit_lines(lines: list[str]) -> list[str]:
    num_hidden = len(lines) - _MAX_LINES
    return lines[:_MAX_LINES] + ([f"and {num_hidden} more"] if num_hidden > 0 else [])


def format_fault(taxels: int | Sequence[int]) -> str:
    r"""Returns a taxel, or taxels with equal readings, as text.

    Examples:
        >>> format_fault(3), format_fault((3, 7))
        ('3', '3 = 7')
    """
    if isinstance(taxels, int):
        return str(taxels)
    return short_list(taxels, _MAX_INDICES, ending=" and {} more", separator=" = ")


def _format_faults(faults: Sequence[int | Sequence[int]]) -> str:
    count = f"{len(faults)}: " if faults else ""
    return count + short_list(faults, _MAX_INDICES, format_fault)


def _shorten(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _MAX_LETTERS else f"{text[: _MAX_LETTERS - 3]}..."
