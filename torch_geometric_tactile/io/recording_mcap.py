r"""Recordings as MCAP files, which viewers of robot data can open. The files survive a crash.

Topics are :obj:`tactile.Frame`, :obj:`tactile.Prediction`, :obj:`tactile.Health`,
:obj:`tactile.Event` and :obj:`foxglove.PointCloud`
(:mod:`~torch_geometric_tactile.io._mcap_schemas`). Label, metadata, name of the layout and clocks
are in a metadata record at the beginning, so that they survive if the file is truncated.

The times of messages are nanoseconds since 1970. The :obj:`time` of a frame in the file is on the
monotonic clock of the host. The time of a :class:`~torch_geometric_tactile.data.Recording` is in
seconds since the anchor of the stream.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io._mcap_output import McapOutput, require_mcap
from torch_geometric_tactile.io._mcap_records import METADATA_NAME, texts_checksum
from torch_geometric_tactile.io._mcap_schemas import (
    EVENT,
    FLOAT32,
    FRAME,
    HEALTH,
    POINTS,
    PREDICTION,
    SPAN_END,
    SPAN_START,
    TOPICS,
    encode,
    frame_schema,
    message_schema,
)

VERSION = 1
_FLUSH_SECONDS = 0.25
_NS_PER_SECOND = 1_000_000_000
_CHUNK_BYTES = 2**20
_MAX_SECONDS = 2**62 / _NS_PER_SECOND  # since 1970: nanoseconds in a file reach the year 2116


class McapWriter:
    r"""Writes a recording to an MCAP file, frame by frame.

    A chunk is closed a quarter of a second after its first frame and passed to the operating
    system. If the process is killed, only later frames are lost. A power failure may lose data that
    the system has not written yet (a few seconds on Linux). Bytes in the file never change after
    they are written. If the disk is full, the incomplete chunk is removed, the error names the
    file, and all later calls raise the same error.

    Args:
        path (str or PathLike): The file.
        meta (Mapping): Metadata, as in a :class:`~torch_geometric_tactile.data.Recording`.
        anchor (tuple of int): The same moment on two clocks: nanoseconds since 1970, and
            nanoseconds on the monotonic clock.
        layout (str, optional): Name of the layout.
        label (str or int, optional): The label of the recording.
        overwrite (bool): Whether to replace an existing file.
        flush_seconds (float, optional): Seconds after which a chunk is closed. With :obj:`None`, a
            chunk is closed when it is full, for files that are written at once.
        live (bool): Whether readers return the numbers and device times of the frames as further
            signals (:obj:`"sequence"`, :obj:`"device_time"`).
        has_actions (bool): Whether :meth:`write_frame` gets actions.

    Raises:
        FileExistsError: If the file exists, and :obj:`overwrite` is false.
        ImportError: If the extra :obj:`live` is missing.
        OSError: If the file cannot be created.

    Examples:
        >>> import tempfile
        >>> from torch_geometric_tactile.io import read_mcap
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.mcap"
        ...     with McapWriter(path, label="cup") as writer:
        ...         writer.write_frame(LiveFrame(0, 0.0, 0, None, np.ones((4, 3), np.float32)))
        ...     read_mcap(path).label
        'cup'
    """

    def __init__(
        self,
        path: PathLike,
        *,
        meta: Mapping[str, Any] | None = None,
        anchor: tuple[int, int] = (0, 0),
        layout: str | None = None,
        label: str | int | None = None,
        overwrite: bool = False,
        flush_seconds: float | None = _FLUSH_SECONDS,
        live: bool = True,
        has_actions: bool = False,
    ) -> None:
        library = require_mcap()
        head = Recording(
            time=np.zeros(0), tactile=np.zeros((0, 1, 1)), label=label, meta=dict(meta or {})
        )
        self.path = Path(path)
        self._has_actions = has_actions
        self._anchor = int(anchor[0]), int(anchor[1])
        self._flush_ns = None if flush_seconds is None else int(flush_seconds * _NS_PER_SECOND)
        self._chunk_start: int | None = None
        schemas = {topic: message_schema(topic) for topic in TOPICS}
        schemas[FRAME] = frame_schema(has_actions)
        self._output = McapOutput(self.path, overwrite, lock=live)
        self._writer = library.Writer(self._output, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
        self._channels: dict[str, int] = {}
        try:
            self._writer.start(library="torch_geometric_tactile")
            self._writer.add_metadata(
                METADATA_NAME,
                _metadata_texts(head, layout or "", live, schemas, self._anchor, has_actions),
            )
            for topic, schema in schemas.items():
                number = self._writer.register_schema(topic, "protobuf", schema)
                self._channels[topic] = self._writer.register_channel(topic, "protobuf", number)
            self._output.commit()
        except BaseException:
            self._output.close()
            raise

    def _log_time(self, time: float) -> int:
        return max(0, self._anchor[0] + _to_nanoseconds(time) - self._anchor[1])

    def _write(self, topic: str, time: float, data: bytes, sequence: int = 0) -> None:
        log_time = self._log_time(time)
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=log_time,
            publish_time=log_time,
            sequence=sequence % 2**32,  # MCAP has 32 bits; the message has the full number
            data=data,
        )

    def write_frame(
        self,
        frame: LiveFrame,
        privileged: Mapping[str, np.ndarray] | None = None,
        action: np.ndarray | None = None,
    ) -> None:
        r"""Writes a frame.

        Args:
            frame (LiveFrame): The frame.
            privileged (Mapping of str to numpy.ndarray, optional): Signals known only in
                simulation.
            action (numpy.ndarray, optional): The last command at or before the frame :math:`(A,)`.

        Raises:
            OSError: If the disk is full.
            ValueError: If there is an action, and :obj:`has_actions` is false.
        """
        need(
            action is None or self._has_actions,
            "'action' must be None without has_actions=True in McapWriter (got a command)",
        )
        tactile = np.asarray(frame.tactile)
        data = encode(
            FRAME,
            {
                "sequence": frame.sequence,
                "time": frame.time,
                "received": frame.received,
                "device_time": frame.device_time,
                "shape": tactile.shape,
                "tactile": tactile,
                "joint": None if frame.joint is None else np.asarray(frame.joint, np.float32),
                "extra": _encode_signals(frame.extra),
                "privileged": _encode_signals(privileged or {}),
                "action": None if action is None else np.asarray(action, np.float32),
            },
        )
        self._write(FRAME, frame.time, data, frame.sequence)
        if self._flush_ns is None:
            return
        if self._chunk_start is None:
            self._chunk_start = frame.received
        elif frame.received - self._chunk_start >= self._flush_ns:
            self.flush()

    def write_prediction(
        self,
        time: float,
        probability: np.ndarray,
        class_names: tuple[str, ...] | list[str],
        label: str,
        *,
        sequence: int | None = None,
        task: str = "",
        latency: float | None = None,
    ) -> None:
        r"""Writes the prediction of a model for a frame.

        Args:
            time (float): Time of the frame.
            probability (numpy.ndarray): Probabilities of the classes :math:`(K,)`.
            class_names (sequence of str): Names of the classes.
            label (str): The predicted label.
            sequence (int, optional): Number of the frame.
            task (str): The task of the model.
            latency (float, optional): Seconds from the frame to the label.

        Raises:
            OSError: If the disk is full.
        """
        names = [str(name) for name in class_names]
        values = {"probability": probability, "class_names": names, "label": str(label)}
        optional_values = {"sequence": sequence, "task": str(task), "latency": latency}
        self._write(
            PREDICTION, time, encode(PREDICTION, {"time": time, **values, **optional_values})
        )

    def write_health(self, time: float, health: Mapping[str, Any]) -> None:
        r"""Writes the health of a stream.

        Args:
            time (float): The current time on the monotonic clock in seconds.
            health (Mapping): The fields of :class:`~torch_geometric_tactile.live.Health`.

        Raises:
            OSError: If the disk is full.
        """
        self._write(HEALTH, time, encode(HEALTH, {**health, "time": time}))

    def write_event(self, time: float, kind: str, text: str = "") -> None:
        r"""Writes an event, such as a new tare.

        The events :obj:`"annotation_start"` and :obj:`"annotation_end"` mark an annotation with
        their text as label. An end closes the last open annotation with this label. An annotation
        without end lasts to the last frame.

        Args:
            time (float): Time of the event on the monotonic clock in seconds.
            kind (str): Type of the event.
            text (str): Details of the event.

        Raises:
            OSError: If the disk is full.
        """
        self._write(EVENT, time, encode(EVENT, {"time": time, "kind": kind, "text": text}))

    def write_points(
        self, time: float, pos: np.ndarray, fields: Mapping[str, np.ndarray], frame_id: str
    ) -> None:
        r"""Writes the taxels as a point cloud, for viewers.

        Args:
            time (float): Time on the monotonic clock in seconds.
            pos (numpy.ndarray): Positions in metres :math:`(N, 3)`.
            fields (Mapping of str to numpy.ndarray): Values of the points :math:`(N,)` by name.
            frame_id (str): Name of the coordinate frame of the positions.

        Raises:
            OSError: If the disk is full.
        """
        columns = dict(zip("xyz", np.asarray(pos).T, strict=True)) | dict(fields)
        table = np.stack([*columns.values()], axis=1).astype("<f4")
        seconds, nanos = divmod(self._log_time(time), _NS_PER_SECOND)
        cloud = {
            "timestamp": {"seconds": seconds, "nanos": nanos},
            "frame_id": frame_id,
            "pose": {
                "position": {"x": 0.0, "y": 0.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
            "point_stride": 4 * table.shape[1],
            "fields": [
                {"name": name, "offset": 4 * i, "type": FLOAT32} for i, name in enumerate(columns)
            ],
            "data": table.tobytes(),
        }
        self._write(POINTS, time, encode(POINTS, cloud))

    def flush(self) -> None:
        r"""Closes the chunk and passes it to the operating system.

        Raises:
            OSError: If the disk is full.
        """
        self._chunk_start = None
        self._writer.flush()
        self._output.commit()

    def close(self) -> None:
        r"""Writes the last chunk and the index, and closes the file. Does nothing if it is already
        closed.

        Raises:
            OSError: If the disk is full. The file keeps all earlier chunks.
        """
        if self._output.closed:
            return
        try:
            if self._output.error is None:
                self.flush()
                self._writer.finish()
                self._output.commit()
        finally:
            self._output.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _metadata_texts(
    head: Recording,
    layout: str,
    live: bool,
    schemas: Mapping[str, bytes],
    anchor: tuple[int, int],
    has_actions: bool,
) -> dict[str, str]:
    texts = {
        "version": str(VERSION),
        "label": json.dumps(head.label, ensure_ascii=False),
        "meta": json.dumps(dict(head.meta), ensure_ascii=False),
        "layout": layout,
        "unix_ns": str(anchor[0]),
        "monotonic_ns": str(anchor[1]),
        "live": str(int(live)),
        # The channel records are in the first chunk, which may be damaged.
        "channels": json.dumps({topic: i for i, topic in enumerate(schemas, start=1)}),
    }
    if has_actions:
        texts["has_actions"] = "1"
    return {**texts, "crc32": str(texts_checksum(texts))}


def _encode_signals(arrays: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    signals = []
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in "biufU":
            raise ValueError(f"'{name}' must hold numbers or strings (got {array.dtype})")
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        signal = {"name": name, "dtype": array.dtype.str, "shape": array.shape}
        signals.append({**signal, "data": array.tobytes()})
    return signals


def write_mcap(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as an MCAP file that is either complete or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ImportError: If the extra :obj:`live` is missing.
        OSError: If the disk is full. The file keeps its old content.
        ValueError: If there is no frame.

    Examples:
        >>> import tempfile
        >>> from torch_geometric_tactile.io import read_mcap
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_mcap(recording, f"{folder}/grasp.mcap")
        ...     read_mcap(f"{folder}/grasp.mcap")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100, label='cup')
    """
    require_mcap()
    if recording.num_frames == 0:
        raise ValueError(
            "'recording' must hold at least one frame to be written as MCAP (got none)"
        )
    layout = recording.meta.get("sensor")
    with atomic_path(path) as temporary:
        try:
            with McapWriter(
                temporary,
                meta=recording.meta,
                anchor=(_unix_ns(recording.meta.get("recorded_at")), 0),
                layout=layout if isinstance(layout, str) else None,
                label=recording.label,
                overwrite=True,
                flush_seconds=None,
                live=False,
                has_actions=recording.action is not None,
            ) as writer:
                for i, time in enumerate(recording.time.tolist()):
                    action = None if recording.action is None else recording.action[i]
                    writer.write_frame(*_live_frame(recording, i, time), action)
                for start, end, label in recording.annotations:  # pairs of events, in any order
                    writer.write_event(start, SPAN_START, label)
                    writer.write_event(end, SPAN_END, label)
        except OSError as error:
            raise OSError(error.errno, os.strerror(error.errno or 0), str(path)) from error


def _to_nanoseconds(seconds: float) -> int:
    return round(min(max(-_MAX_SECONDS, seconds), _MAX_SECONDS) * _NS_PER_SECOND)


def _unix_ns(seconds: Any) -> int:
    is_time = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    return int(seconds * _NS_PER_SECOND) if is_time and 0 <= seconds < 2**33 else 0


def _live_frame(
    recording: Recording, i: int, time: float
) -> tuple[LiveFrame, dict[str, np.ndarray]]:
    frame = LiveFrame(
        sequence=i,
        time=time,
        received=_to_nanoseconds(time),
        device_time=None,
        tactile=recording.tactile[i],
        joint=None if recording.joint is None else recording.joint[i],
        extra=_frame_of_arrays(recording.extra, i),
    )
    return frame, _frame_of_arrays(recording.privileged, i)


def _frame_of_arrays(arrays: Mapping[str, np.ndarray], i: int) -> dict[str, np.ndarray]:
    # A slice keeps the width of text arrays, which an index would shorten.
    return {name: value[i : i + 1].reshape(value.shape[1:]) for name, value in arrays.items()}
