r"""Recordings from the episodes of a LeRobot data set."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io.lerobot_dataset import OWN, STATE, TACTILE, require_pyarrow
from torch_geometric_tactile.texts import printable, read_json
from torch_geometric_tactile.typing import PathLike

_MOST_BYTES = 2**30
_MOST_TIMES = 200


def read_lerobot(
    root: PathLike,
    *,
    tactile: str = TACTILE,
    state: str = STATE,
    allow_large: bool = False,
) -> list[Recording]:
    r"""Reads the episodes of a LeRobot data set, of :func:`write_lerobot` or of others.

    The time is that of the data set, from 0, and the label is the task; sets of
    :func:`write_lerobot` have their own labels and metadata. Other features are left out.

    Args:
        root (str or PathLike): The folder.
        tactile (str): The feature of the readings, float :math:`(N, C)` or :math:`(N,)`.
        state (str): The feature of the joint angles in radians, if there is one.
        allow_large (bool): Whether to read files whose tables take more than 1 GiB and more than
            200 times their own size.

    Raises:
        FileNotFoundError: If it is no such folder.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If a file cannot be read.
        ValueError: If the version is not 3, the features are missing or no numbers, or the files do
            not fit together. The message names the folder or file.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> from torch_geometric_tactile.io import write_lerobot
        >>> recording = Recording(time=np.arange(20) / 100, tactile=np.ones((20, 4, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_lerobot([recording, recording], f"{folder}/cups", fps=50, task="pick")
        ...     episodes = read_lerobot(f"{folder}/cups")
        >>> len(episodes), episodes[0].num_frames
        (2, 10)
    """
    require_pyarrow()
    root = Path(root)
    info = _info(root)
    features = info["features"]
    dataset = _Dataset(
        tactile=tactile,
        state=state if state in features else None,
        shape=_shape(root, features, tactile),
        fps=info["fps"],
        tasks=_tasks(root),
        own=_own(root),
    )
    paths = sorted(root.glob("data/*/*.parquet"))
    if not paths:
        raise FileNotFoundError(f"'{root}' must hold 'data/chunk-.../file-....parquet' (got none)")
    recordings = [r for path in paths for r in dataset.recordings(path, allow_large)]
    total = sum(recording.num_frames for recording in recordings)
    if (len(recordings), total) != (info["total_episodes"], info["total_frames"]):
        raise ValueError(
            f"'{root}' must hold {info['total_episodes']} episodes and {info['total_frames']} "
            f"frames, as its info.json says (got {len(recordings)} and {total})"
        )
    return recordings


@dataclass
class _Dataset:
    # What is known before the frames are read.
    tactile: str
    state: str | None
    shape: tuple[int, ...]
    fps: float
    tasks: dict[int, str]
    own: list[Any]

    def recordings(self, path: Path, allow_large: bool) -> Iterator[Recording]:
        columns = [self.tactile, "timestamp", "frame_index", "episode_index", "task_index"]
        columns += [] if self.state is None else [self.state]
        table = _table(path, columns, allow_large)
        episodes = _numbers(path, table, "episode_index")
        bounds = np.flatnonzero(np.diff(episodes)) + 1
        for start, stop in pairwise([0, *bounds.tolist(), len(episodes)]):
            if stop > start:
                yield self._recording(path, table.slice(start, stop - start))

    def _recording(self, path: Path, rows: Any) -> Recording:
        nested = () if self.shape == (1,) else self.shape
        tactile = _array(path, rows, self.tactile, nested)
        last = self.shape[1] if len(self.shape) == 2 else 1
        steps = _numbers(path, rows, "frame_index") / self.fps
        time = _numbers(path, rows, "timestamp").astype(np.float64)
        number = int(_numbers(path, rows, "episode_index")[0])
        task = self.tasks.get(int(_numbers(path, rows, "task_index")[0]))
        own = self.own[number] if 0 <= number < len(self.own) else None
        known = own if isinstance(own, dict) and isinstance(own.get("meta"), dict) else {}
        try:
            return Recording(
                # Times in float32 are steps of a clock.
                time=steps if np.allclose(time, steps, rtol=1e-6, atol=1e-6) else time,
                tactile=tactile.reshape(len(rows), self.shape[0], last),
                joint=self._joint(path, rows),
                label=known.get("label", task),
                meta={**known.get("meta", {"episode": number}), "rate": self.fps},
            )
        except ValueError as error:
            raise ValueError(f"'{path}' holds no consistent recording: {error}") from error

    def _joint(self, path: Path, rows: Any) -> np.ndarray | None:
        if self.state is None:
            return None
        kind = rows.column(self.state).type
        if not require_pyarrow().types.is_nested(kind):
            return _array(path, rows, self.state, ())[:, None]
        first = rows.column(self.state)[0].as_py()
        return _array(path, rows, self.state, (len(first or ()),))


def _info(root: Path) -> dict[str, Any]:
    path = root / "meta" / "info.json"
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; give the folder of a LeRobot data set")
    info = _json(path)
    version = info.get("codebase_version")
    if not isinstance(version, str) or not version.startswith("v3."):
        raise ValueError(
            f"'{root}' must be a LeRobot data set of version 3 (got {printable(version)}): convert "
            "it with lerobot's own script"
        )
    for key, kind in {
        "features": dict,
        "fps": int | float,
        "total_episodes": int,
        "total_frames": int,
    }.items():
        if not isinstance(info.get(key), kind) or isinstance(info[key], bool):
            raise ValueError(f"'{path}' must hold '{key}' (got {printable(info.get(key))[:40]})")
    if not 0 < info["fps"] < 1e6:
        raise ValueError(f"'{path}' must hold a positive 'fps' (got {info['fps']})")
    return info


def _json(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"'{path}' must hold a JSON object (got {type(content).__name__})")
    return content


def _shape(root: Path, features: dict[str, Any], tactile: str) -> tuple[int, ...]:
    feature = features.get(tactile)
    if not isinstance(feature, dict):
        names = ", ".join(printable(name) for name in list(features)[:20])
        raise ValueError(f"'{root}' must have the feature '{tactile}' (got {names or 'none'})")
    shape = feature.get("shape")
    whole = isinstance(shape, list) and all(isinstance(n, int) and 0 < n < 2**31 for n in shape)
    if not whole or not 1 <= len(shape or ()) <= 2:
        raise ValueError(
            f"'{tactile}' of '{root}' must have one or two dimensions (got {printable(shape)[:40]})"
        )
    assert isinstance(shape, list)
    return tuple(shape)


def _table(path: Path, columns: list[str], allow_large: bool) -> Any:
    pa = require_pyarrow()
    try:
        with pa.parquet.ParquetFile(path, page_checksum_verification=True) as file:
            groups = (file.metadata.row_group(i) for i in range(file.metadata.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            stored = path.stat().st_size
            if not allow_large and size > _MOST_BYTES and size > _MOST_TIMES * stored:
                raise ValueError(
                    f"its tables would take {size / 2**30:.1f} GiB: pass allow_large=True if it is "
                    "right"
                )
            missing = [name for name in columns if name not in file.schema_arrow.names]
            if missing:
                raise ValueError(f"it must have the column '{missing[0]}'")
            return file.read(columns=columns)
    except (pa.ArrowException, ValueError, OSError) as error:
        if isinstance(error, FileNotFoundError | PermissionError):
            raise
        raise ValueError(f"'{path}' cannot be read as Parquet: {error}") from error


def _numbers(path: Path, table: Any, name: str) -> np.ndarray:
    column = table.column(name)
    try:
        values = column.combine_chunks().to_numpy(zero_copy_only=False)
    except Exception as error:  # pyarrow's own, of nested or other types
        raise ValueError(f"'{path}' must hold numbers in '{name}' ({error})") from error
    if values.dtype.kind not in "iuf" or column.null_count:
        raise ValueError(f"'{path}' must hold numbers in '{name}' (got {column.type})")
    return np.asarray(values)


def _array(path: Path, table: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    pa = require_pyarrow()
    column = table.column(name).combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    if isinstance(column.type, pa.BaseExtensionType):
        column = column.storage
    for size in shape:
        if not pa.types.is_nested(column.type) or column.null_count:
            raise ValueError(f"'{path}' must hold lists in '{name}' (got {column.type})")
        if pa.types.is_fixed_size_list(column.type):
            same = column.type.list_size == size
        else:
            lengths = pa.compute.list_value_length(column).to_numpy(zero_copy_only=False)
            same = bool((lengths == size).all())
        if not same:
            raise ValueError(f"'{path}' must hold lists of {size} in '{name}' (got others)")
        column = column.flatten()
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise ValueError(f"'{path}' must hold numbers in '{name}' (got {column.type})")
    values = column.to_numpy(zero_copy_only=False)  # null is NaN
    return np.asarray(values, dtype=np.float32).reshape(len(table), *shape)


def _tasks(root: Path) -> dict[int, str]:
    path = root / "meta" / "tasks.parquet"
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; a LeRobot data set must have its tasks")
    pa = require_pyarrow()
    try:
        table = pa.parquet.read_table(path)
    except (pa.ArrowException, ValueError, OSError) as error:
        raise ValueError(f"'{path}' cannot be read as Parquet: {error}") from error
    texts = [field.name for field in table.schema if pa.types.is_string(field.type)]
    texts += [field.name for field in table.schema if pa.types.is_large_string(field.type)]
    if "task_index" not in table.column_names or not texts:
        raise ValueError(f"'{path}' must hold 'task_index' and names (got {table.column_names})")
    numbers = _numbers(path, table, "task_index").tolist()
    return dict(zip(map(int, numbers), table.column(texts[0]).to_pylist(), strict=True))


def _own(root: Path) -> list[Any]:
    if not (root / OWN).is_file():
        return []
    episodes = _json(root / OWN).get("episodes")
    return episodes if isinstance(episodes, list) else []
