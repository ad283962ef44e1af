r"""Descriptions of recordings as text, and their pictures."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._annotations import GAP
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io.recording_files import recording_format
from torch_geometric_tactile.visualization.figure import save_figure
from torch_geometric_tactile.visualization.recording import plot_recording

# Limits of long lists and texts, so that the description stays readable.
_MAX_INDICES = 12
_MAX_LINES = 20
_MAX_LETTERS = 100


def describe_recording(recording: Recording) -> str:
    r"""Returns the facts of a recording as lines of text.

    Examples:
        >>> print(describe_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3)), label="cup")))
        frames       2 in 0.1 s, 10 per second
        gaps         none
        taxels       4 of 3 channels
        readings     0 to 0 (unit unknown)
        joints       none
        dead taxels  none
        missing      none
        label        cup
        metadata     none
        privileged   none
        extra        none
    """
    frames = str(recording.num_frames)
    if recording.num_frames > 1:
        frames += f" in {recording.duration:.6g} s, {recording.rate:.6g} per second"
    unit = UNITS.get(str(recording.meta.get("unit")), "(unit unknown)")
    events = _event_lines(recording)
    missing, dead = recording.missing, recording.dead_taxels
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
        ("readings", [_format_range(recording.tactile, unit)]),
        ("joints", _joint_lines(recording)),
        *([("actions", _action_lines(recording))] if recording.action is not None else []),
        ("dead taxels", [_format_indices(dead)]),
        ("missing", [missing_text]),
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
    return "\n".join(
        f"{name if i == 0 else '':<13}{printable(line)}"
        for name, lines in rows
        for i, line in enumerate(lines or ["none"])
    )


def describe_file(path: PathLike, **options: Any) -> tuple[Recording, str]:
    r"""Reads a recording from a file, and returns it with its facts as lines of text."""
    recording = read_recording(path, **options)
    return recording, (
        f"{'file':<13}{printable(path)}\n{'format':<13}{recording_format(path)}\n"
        f"{describe_recording(recording)}"
    )


def draw_recording(recording: Recording, path: PathLike) -> None:
    r"""Draws a recording to a PNG file that is either complete or absent."""
    save_figure(plot_recording(recording), path)


def _format_range(values: np.ndarray, unit: str = "") -> str:
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
    lines = [f"{recording.num_joints}, {_format_range(recording.joint, 'rad')}"]
    return lines + [
        f"{name}: {_format_range(recording.joint[:, i], 'rad')}" for i, name in enumerate(names)
    ]


def _action_lines(recording: Recording) -> list[str]:
    assert recording.action is not None
    names = recording.meta.get("action_names")
    if not isinstance(names, list) or len(names) != recording.num_actions:
        names = list(range(recording.num_actions))
    return [
        str(recording.num_actions),
        *(f"{name}: {_format_range(recording.action[:, i])}" for i, name in enumerate(names)),
    ]


def _gap_line(recording: Recording) -> str:
    # Gaps between frames, and gaps at the end, which only the annotations of a recorder show.
    spans = [(float(start), float(end)) for start, end in recording.gaps]
    spans += [
        (start, end)
        for start, end, label in recording.annotations
        if label == GAP and not any(start < b and a < end for a, b in spans)
    ]
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


def _format_indices(indices: np.ndarray) -> str:
    count = f"{len(indices)}: " if len(indices) else ""
    return count + short_list(indices.tolist(), _MAX_INDICES)


def _shorten(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _MAX_LETTERS else f"{text[: _MAX_LETTERS - 3]}..."
