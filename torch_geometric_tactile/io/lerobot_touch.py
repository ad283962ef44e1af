r"""Writer that adds touch to a LeRobot data set, for example of joints and videos."""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_content import (
    check_alike,
    check_new_folder,
    data_files,
    integer_column,
    read_info,
    read_object,
    read_tasks,
    row_values,
    sort_episodes,
    split_episodes,
    step_times,
    tactile_content,
    write_description,
    write_json,
)
from torch_geometric_tactile.io._lerobot_steps import (
    STATE,
    TACTILE,
    Stats,
    check_gap_options,
    check_gaps,
    check_key_and_fill,
    extra_signals,
    feature_stats,
    feature_value_names,
    frames_since,
    pool_stats,
    stats_to_lists,
    touch_columns,
    touch_features,
    warn_of_unsupported_signals,
)
from torch_geometric_tactile.io._lerobot_tables import (
    arrow_column,
    read_numbers,
    read_parquet,
    require_pyarrow,
    schema_metadata,
    write_parquet,
)


def add_to_lerobot(
    source: PathLike,
    recordings: Sequence[Recording],
    root: PathLike,
    *,
    starts: Sequence[float] | None = None,
    every_frame: bool = False,
    gaps: Literal["nan", "error"] = "nan",
    max_gap: float | None = None,
    allow_large: bool = False,
    key: str = TACTILE,
    fill: float | None = None,
) -> None:
    r"""Writes a copy of a LeRobot data set with touch that was recorded at the same time.

    Each step has the last frame at or before it, or NaN in a gap. Joint angles and actions of the
    recordings are left out, since the data set already has those signals of its robot. Annotations
    and further signals are written as in :func:`write_lerobot`. The data set itself is not changed.
    The copy appears under its name only when it is complete.

    Args:
        source (str or PathLike): The folder of the data set.
        recordings (sequence of Recording): One recording for each episode, in the same order, all
            with the same taxels and channels. Each recording must cover its episode, up to one step
            at either end.
        root (str or PathLike): The folder of the copy, which must be new or empty.
        starts (sequence of float, optional): The time of each episode's first step on the clock of
            its recording, in seconds. Defaults to the time of the first frame.
        every_frame (bool): Whether to store all frames since the previous step as well, as in
            :func:`write_lerobot`.
        gaps (str): Whether steps in a gap are NaN or an error, as in :func:`write_lerobot`.
        max_gap (float, optional): The longest time in seconds that is not a gap, as in
            :func:`write_lerobot`.
        allow_large (bool): Whether to read large tables, as in :func:`read_lerobot`.
        key (str): The feature of the readings, as in :func:`write_lerobot`. With
            :obj:`"observation.state"`, the readings follow the existing values. The names of these
            values are kept, and their statistics are computed again.
        fill (float, optional): The number that replaces missing readings and further signals, as in
            :func:`write_lerobot`. Existing features are not changed.

    Raises:
        FileExistsError: If the folder of the copy is not empty.
        FileNotFoundError: If there is no such data set.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If the disk is full, or a file cannot be read.
        ValueError: If the data set cannot be read, has links out of its folder or already has
            touch; if the number of recordings is not the number of episodes; if a recording does
            not cover its episode, or has a gap and :obj:`gaps` is :obj:`"error"`; if :obj:`key` or
            :obj:`fill` is invalid; or if readings are to be joined to :obj:`observation.state`, and
            this is missing or not one-dimensional.

    Examples:
        >>> from torch_geometric_tactile.io import add_to_lerobot, read_recording
        >>> skin = [read_recording(f"skin_{i}.h5") for i in range(50)]  # doctest: +SKIP
        >>> add_to_lerobot("datasets/cups", skin, "datasets/cups_touch")  # doctest: +SKIP
    """
    require_pyarrow()
    check_gap_options(gaps, max_gap)
    check_key_and_fill(key, fill)
    source, root = Path(source), Path(root)
    info = read_info(source)
    recordings = list(recordings)
    check_alike(recordings)
    if len(recordings) != info["total_episodes"]:
        raise ValueError(
            f"'recordings' must hold one recording for each of {info['total_episodes']} episodes "
            f"of '{source}' (got {len(recordings)})"
        )
    if starts is not None and len(starts) != len(recordings):
        raise ValueError(
            f"'starts' must hold one time for each of {len(recordings)} recordings "
            f"(got {len(starts)})"
        )
    start_times = [r.time[0] for r in recordings] if starts is None else starts
    shifted = [
        replace(r, time=r.time - start, joint=None, action=None)
        for r, start in zip(recordings, start_times, strict=True)
    ]
    check_new_folder(root)
    episodes = _read_episodes(source, info)
    touch = dict(zip(episodes, shifted, strict=True))
    rows = 0
    for i, (number, recording) in enumerate(touch.items()):
        episode = episodes[number]
        _check_coverage(i, recording, number, episode.steps, info["fps"])
        if every_frame:
            step_frames = frames_since(recording.time, episode.steps, info["fps"])
            rows = max(rows, 1, *map(len, step_frames))
        check_gaps(i, recording.time, episode.steps, info["fps"], False, gaps, max_gap, fill)
    extra = extra_signals(recordings)
    warn_of_unsupported_signals(root, recordings, extra)
    state_names = _state_names(source, info, allow_large) if key == STATE else []
    features = touch_features(shifted[0], rows, extra, key, state_names)
    # Checked before the copy, which may take a long time.
    existing_feature = next((n for n in features if n in info["features"] and n != STATE), None)
    need(
        existing_feature is None,
        f"'{source}' must not have the feature '{existing_feature}' already",
    )
    if key == STATE:  # with the further keys of its description
        features[STATE] = {**info["features"][STATE], **features[STATE]}
    with _copied_folder(source, root) as copy:
        values_at_steps = partial(
            touch_columns, rows=rows, extra=extra, max_gap=max_gap, key=key, fill=fill
        )
        stats: dict[int, dict[str, Stats]] = {}
        for path in data_files(copy, info):
            table = read_parquet(path, allow_large)
            parts = []
            for number, episode_rows in split_episodes(path, table):
                columns = values_at_steps(touch[number], episodes[number].steps, info["fps"])
                if key == STATE:
                    state = row_values(path, episode_rows, STATE, (len(state_names),))
                    columns[STATE] = np.concatenate([state, columns[STATE]], axis=1)
                parts.append(columns)
                stats[number] = {name: feature_stats(columns[name]) for name in features}
            write_parquet(_with_columns(table, features, parts), path)
        _add_stats(copy, stats)
        lengths = [len(episode.steps) for episode in episodes.values()]
        tasks = [episode.task for episode in episodes.values()]
        content = tactile_content(
            dict(zip(episodes, recordings, strict=True)),
            start_times,
            lengths,
            tasks,
            rows,
            extra,
            key=key,
            first_column=len(state_names) if key == STATE else None,
            fill=fill,
        )
        info["features"] |= features
        write_description(copy, content, info)


@dataclass
class _Episode:
    steps: np.ndarray
    task: str


def _read_episodes(source: Path, info: dict[str, Any]) -> dict[int, _Episode]:
    tasks = read_tasks(source)
    episodes: list[tuple[int, _Episode]] = []
    columns = ("timestamp", "frame_index", "episode_index", "task_index")
    for path in data_files(source, info):
        for number, rows in split_episodes(path, read_numbers(path, dict.fromkeys(columns, 1))):
            task = tasks.get(int(integer_column(path, rows, "task_index")[0]), "")
            episodes.append((number, _Episode(step_times(path, rows, info["fps"]), task)))
    return sort_episodes(source, info, episodes)


def _state_names(source: Path, info: dict[str, Any], allow_large: bool) -> list[str]:
    # The names of the values of the state, to which readings are joined.
    feature = info["features"].get(STATE)
    feature = feature if isinstance(feature, dict) else {}
    shape, dtype = feature.get("shape"), feature.get("dtype")
    is_flat = isinstance(shape, list) and len(shape) == 1 and type(shape[0]) is int
    if not isinstance(shape, list) or not is_flat or shape[0] < 1 or dtype != "float32":
        raise ValueError(
            f"'{source}' must have '{STATE}' of float32 in one dimension, to which readings are "
            f"joined (got {printable([dtype, shape] if feature else None)[:60]}): choose another "
            "'key'"
        )
    # The declared size is compared with a file before that many names are created.
    read_numbers(data_files(source, info)[0], {STATE: shape[0]}, allow_large)
    names = feature_value_names(feature.get("names"), shape[0])
    if names and any(name.startswith("taxel_0_") for name in names):
        raise ValueError(
            f"'{source}' must not have readings in '{STATE}' already (got values named "
            "'taxel_0_...')"
        )
    return names or [f"state_{i}" for i in range(shape[0])]


def _with_columns(
    table: Any, features: dict[str, Any], parts: Sequence[dict[str, np.ndarray]]
) -> Any:
    # The table with the values of features in its episodes.
    for name in features:
        values = arrow_column(np.concatenate([part[name] for part in parts]))
        table = _set_column(table, name, values)
    metadata = table.schema.metadata or {}
    if b"huggingface" in metadata:
        table = table.replace_schema_metadata(schema_metadata(features, metadata))
    return table


def _set_column(table: Any, name: str, values: Any) -> Any:
    index = table.schema.get_field_index(name)
    if index < 0:
        return table.append_column(name, values)
    return table.set_column(index, name, values)


def _check_coverage(
    i: int, recording: Recording, number: int, steps: np.ndarray, fps: float
) -> None:
    tolerance = 1.001 / fps  # one step, with rounding of the times
    start, end = recording.time[0], recording.time[-1]
    if start > steps[0] + tolerance or end < steps[-1] - tolerance:
        raise ValueError(
            f"recording {i} must cover {steps[0]:.4g} to {steps[-1]:.4g} s after its start, as "
            f"episode {number} does (got {start:.4g} to {end:.4g} s)"
        )


def _add_stats(root: Path, stats: dict[int, dict[str, Stats]]) -> None:
    pa = require_pyarrow()
    features = next(iter(stats.values()))  # the same for all episodes
    for path in sorted(root.glob("meta/episodes/*/*.parquet")):
        table = read_parquet(path)
        numbers = integer_column(path, table, "episode_index").tolist()
        unknown = next((number for number in numbers if number not in stats), None)
        need(unknown is None, f"'{path}' must list only episodes in the data files", unknown)
        # Statistics of the state without readings have a different length.
        stale = {
            n for n in table.column_names for name in features if n.startswith(f"stats/{name}/")
        }
        stale -= {f"stats/{name}/{key}" for name, part in features.items() for key in part}
        table = table.drop_columns([*stale])
        for name, part in features.items():
            for key in part:
                values = [stats[number][name][key].tolist() for number in numbers]
                table = _set_column(table, f"stats/{name}/{key}", pa.array(values))
        write_parquet(table, path)
    path = root / "meta/stats.json"
    content = read_object(path) if path.is_file() else {}
    joined = pool_stats([stats[number] for number in sorted(stats)])
    write_json(path, content | stats_to_lists(joined), allow_nan=False)


@contextmanager
def _copied_folder(source: Path, root: Path) -> Iterator[Path]:
    # Yields a temporary copy, which is renamed to the folder when the block succeeds.
    home = source.resolve()
    if root.resolve().is_relative_to(home):
        raise ValueError(f"the copy must be outside of '{source}' (got '{root}')")
    # Folders in the cache of Hugging Face have links to the files of the same data set.
    allowed = (home, home.parent.parent / "blobs")
    for path in source.rglob("*"):
        if not any(path.resolve().is_relative_to(folder) for folder in allowed):
            raise ValueError(f"'{path}' must not be a link to a file outside of the data set")
    temporary = root.with_name(f".{root.name}.tmp")
    try:
        shutil.copytree(source, temporary)
    except FileExistsError as error:
        raise FileExistsError(
            f"'{temporary}' must not exist (a killed run left it behind): remove it"
        ) from error
    try:
        yield temporary
        if root.exists():
            root.rmdir()
        os.rename(temporary, root)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
