r"""``meta/tactile.json``: what LeRobot has no place for, of each episode."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch_geometric_tactile._texts import printable, read_json
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_features import FRAME_TIMES, TACTILE, TACTILE_FRAMES

PATH = "meta/tactile.json"
_ADVICE = "remove it if another program changed the data set"


@dataclass
class OwnContent:
    r"""The contents of a file."""

    path: Path
    shape: tuple[int, int] | None = None
    episodes: dict[int, dict[str, Any]] = field(default_factory=dict)

    def of(self, number: int, length: int, task: str) -> dict[str, Any]:
        r"""Returns the label and metadata of an episode."""
        known = self.episodes.get(number)
        if known is None:
            return {"label": task, "meta": {"episode": number}}
        for key, value in {"length": length, "task": task}.items():
            if known.get(key) not in (None, value):
                raise ValueError(
                    f"'{self.path}' must have the {key} {printable(value)[:40]} of episode {number}"
                    f" (got {printable(known[key])[:40]}): {_ADVICE}"
                )
        return known


def own_content(
    recordings: Sequence[Recording], lengths: Sequence[int], tasks: Sequence[str], rows: int
) -> dict[str, Any]:
    r"""Returns the contents of a new file."""
    shape = [recordings[0].num_taxels, recordings[0].num_channels]
    out: dict[str, Any] = {"version": 2, "feature": TACTILE, "shape": shape}
    if rows:
        frames = {"feature": TACTILE_FRAMES, "shape": [rows, *shape]}
        out["every_frame"] = {**frames, "time": FRAME_TIMES, "missing": "NaN, before the others"}
    out["episodes"] = [
        {
            "episode_index": index,
            "length": length,
            "task": task,
            "label": recording.label,
            "meta": dict(recording.meta),
        }
        for index, (recording, length, task) in enumerate(
            zip(recordings, lengths, tasks, strict=True)
        )
    ]
    return out


def read_own(root: Path, num_episodes: int, tasks: Sequence[str]) -> OwnContent:
    r"""Reads the file of a data set, or nothing if there is none."""
    path = root / PATH
    if not path.is_file():
        return OwnContent(path)
    content = read_object(path)
    version, episodes = content.get("version"), content.get("episodes")
    if version not in (1, 2):
        raise ValueError(f"'{path}' must have version 1 or 2 (got {printable(version)[:40]})")
    if not isinstance(episodes, list) or not all(
        isinstance(e, dict) and isinstance(e.get("meta"), dict) for e in episodes
    ):
        raise ValueError(f"'{path}' must hold 'episodes', each with 'meta' (got something else)")
    if version == 1:  # 0.2.0 wrote them by position, without tasks
        episodes = [{**episode, "episode_index": i} for i, episode in enumerate(episodes)]
        if len(tasks) > 1:  # not one task that was given for all
            episodes = [{**e, "task": task_of_label(e.get("label"))} for e in episodes]
    numbers = [episode.get("episode_index") for episode in episodes]
    whole = all(type(number) is int for number in numbers)
    if len(numbers) != num_episodes or not whole or sorted(numbers) != [*range(len(numbers))]:
        raise ValueError(
            f"'{path}' must hold each of {num_episodes} episodes once (got {len(numbers)}: "
            f"{printable(numbers)[:80]}): {_ADVICE}"
        )
    by_number = dict(zip(numbers, episodes, strict=True))
    return OwnContent(path, None if version == 1 else _shape(path, content), by_number)


def _shape(path: Path, content: dict[str, Any]) -> tuple[int, int]:
    shape = content.get("shape")
    if isinstance(shape, list) and len(shape) == 2 and all(type(n) is int and n > 0 for n in shape):
        return (shape[0], shape[1])
    raise ValueError(
        f"'{path}' must hold 'shape', the numbers of taxels and channels "
        f"(got {printable(shape)[:40]})"
    )


def task_of_label(label: str | int | None) -> str:
    r"""Returns the task of a recording that is given none."""
    return "touch" if label is None else str(label)


def read_object(path: Path) -> dict[str, Any]:
    r"""Reads a JSON object."""
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"'{path}' must hold a JSON object (got {type(content).__name__})")
    return content
