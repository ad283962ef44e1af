r"""Recording of a stream to a file."""

import logging
import os
import shlex
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._annotations import GAP, checked_annotation
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.io._mcap_schemas import SPAN_END, SPAN_START, TOPICS, encode
from torch_geometric_tactile.live.subscription import StreamEnded

if TYPE_CHECKING:
    from torch_geometric_tactile.io import McapWriter
    from torch_geometric_tactile.live._posed_points import PosedPoints
    from torch_geometric_tactile.live.stream import Stream
    from torch_geometric_tactile.sensors import TaxelLayout

#: Seconds that a recording of limited length waits for late frames.
LATE_SECONDS = 0.5
_log = logging.getLogger(__name__)
_SUFFIXES = (".mcap", ".h5", ".hdf5")
_POLL_SECONDS = 0.1
_POINTS_SECONDS = 0.1
_HEALTH_SECONDS = 1.0
_MIN_OUTAGE_SECONDS = 0.05  # the shortest outage of a stream


class Recorder:
    r"""Writes all frames of a stream to a file, in a separate thread.

    The file has its final name from the first frame on. After a crash it holds all but the last
    quarter of a second, and :func:`~torch_geometric_tactile.io.read_recording` can read it. An
    existing file is only replaced with :obj:`overwrite`.

    HDF5 files are written at the end: :obj:`grasp.h5` is recorded as :obj:`grasp.mcap`, which
    :meth:`close` converts and removes. After a crash, or if the conversion fails, the MCAP file
    stays; convert it with :obj:`tactile convert grasp.mcap grasp.h5`.

    The constructor does everything slow, such as importing PyTorch for a layout, so that no frame
    has to wait. Start the recorder before the stream is opened, so that no frame is missed. An
    outage (:attr:`Stream.outages`) becomes an annotation :obj:`"gap"` from the last frame before it
    to the first frame after it.

    No frame is lost silently. Errors, such as a full disk, a failed stream or a stream that is too
    fast for the disk, are available from :attr:`error` at once, and :meth:`close` raises them.
    Frames that were written before the error are kept.

    Infinite readings are written as NaN (missing), and one warning is logged.

    Args:
        path (str or PathLike): The file, :obj:`.mcap`, :obj:`.h5` or :obj:`.hdf5`. HDF5 files hold
            frames, events and annotations only.
        stream (Stream): The stream.
        layout (TaxelLayout, str or PathLike, optional): The layout, from which taxel positions for
            viewers are written ten times a second. Needs :obj:`torch`.
        label (str or int, optional): Label of the recording.
        overwrite (bool): Whether to replace an existing file.
        size (int, optional): Limit of frames that wait for the disk.
        max_seconds (float, optional): Seconds from the first frame to the end of the recording.

    Attributes:
        frames (int): Number of written frames.
        error (BaseException or None): The first error.
        rest (numpy.ndarray or None): Readings at rest :math:`(N, C)`, which are subtracted from the
            readings in the points for viewers. If :obj:`None`, the first frame is subtracted.
        annotation (str or None): The label of the current annotation.

    Raises:
        FileExistsError: If the file exists and :obj:`overwrite` is false, or if the MCAP file to
            which an HDF5 file is recorded exists.
        FileNotFoundError: If the folder does not exist.
        ValueError: If the suffix is unknown, or :obj:`max_seconds` is not positive.

    Examples:
        >>> from tempfile import TemporaryDirectory
        >>> from torch_geometric_tactile.live import ReplaySource, Stream
        >>> recording = Recording(time=np.arange(5) / 100, tactile=np.ones((5, 4, 3)))
        >>> with TemporaryDirectory() as folder:
        ...     stream = Stream(ReplaySource(recording, speed=0))
        ...     subscription = stream.subscribe("all")
        ...     with Recorder(Path(folder) / "grasp.mcap", stream) as recorder, stream:
        ...         frames = list(subscription)
        >>> recorder.frames
        5
    """

    def __init__(
        self,
        path: PathLike,
        stream: "Stream",
        *,
        layout: "TaxelLayout | PathLike | None" = None,
        label: str | int | None = None,
        overwrite: bool = False,
        size: int | None = None,
        max_seconds: float | None = None,
    ) -> None:
        if max_seconds is not None and not max_seconds > 0:
            raise ValueError(f"'max_seconds' must be positive (got {max_seconds})")
        self.path = Path(path)
        _check_target(self.path, overwrite)
        Recording(time=np.zeros(0), tactile=np.zeros((0, 1, 1)), label=label)  # checks the label
        self.stream = stream
        self.layout = layout
        self.max_seconds = max_seconds
        self.label = label
        self.overwrite = overwrite
        self.frames = 0
        self.error: BaseException | None = None
        self.rest: np.ndarray | None = None
        self.annotation: str | None = None
        self._size = size
        self._file: McapWriter | None = None
        self._lock = threading.Lock()
        self._pending_writes: list[Callable[[McapWriter], None]] = []
        self._first_reading = np.zeros(0)
        self._first_time = self._last_time = 0.0
        self._points = preload_recorder(layout)
        self._next_points = self._next_health = -float("inf")
        self._has_warned = False
        self._closed = False
        self._has_ended = False
        self._stop_time: int | None = None
        self._close_requested = threading.Event()
        self._subscription: Any = None
        self._thread: threading.Thread | None = None

    @property
    def seconds(self) -> float:
        r"""Seconds from the first to the last frame that was written."""
        return self._last_time - self._first_time

    @property
    def is_over(self) -> bool:
        r"""Whether a frame after :obj:`max_seconds` has ended the recording."""
        return self._has_ended

    def start(self) -> None:
        r"""Starts to record. Does nothing if the recorder has started."""
        if self._thread is not None:
            return
        self._subscription = self.stream.subscribe("all", self._size)
        self._thread = threading.Thread(target=self._run, name=f"recorder {self.path}", daemon=True)
        self._thread.start()

    def judgement(self, judgement: Any) -> None:
        r"""Writes the prediction of a model for a frame.

        Args:
            judgement (Judgement): The prediction.
        """
        self._add(lambda file: _write_prediction(file, judgement))

    def event(self, kind: str, text: str = "") -> float | None:
        r"""Writes an event at the present time, such as a new tare. Returns the seconds since the
        first frame, or :obj:`None` before the first frame.

        Args:
            kind (str): Kind of event.
            text (str): Description of the event.
        """
        now = time.perf_counter()
        self._write_event(now, kind, text)
        return self._seconds_at(now)

    def annotate(self, label: str) -> float | None:
        r"""Starts an annotation at the present time, and ends the current one. If the current
        annotation has the same label, only ends it. The end of the recording ends the last
        annotation. Returns the seconds since the first frame, or :obj:`None` before the first
        frame.

        Args:
            label (str): Label of the annotation.

        Raises:
            ValueError: If the label is not allowed for annotations, or is :obj:`"gap"`.
        """
        if label == GAP:
            raise ValueError(f"'label' must not be '{GAP}', which the recorder writes for outages")
        checked_annotation((0.0, 0.0, label))
        now, previous = time.perf_counter(), self.annotation
        self.annotation = None if label == previous else label
        if previous is not None:
            self._write_event(now, SPAN_END, previous)
        if self.annotation is not None:
            self._write_event(now, SPAN_START, label)
        return self._seconds_at(now)

    def _seconds_at(self, time: float) -> float | None:
        return time - self._first_time if self.frames else None

    def _write_event(self, time: float, kind: str, text: str) -> None:
        self._add(lambda file: file.write_event(time, kind, text))

    def close(self) -> None:
        r"""Writes all frames that were received up to now, and closes the file.

        Raises:
            OSError: If the disk is full, or the stream was lost or too fast.
            Exception: The first error of the stream or of writing.
        """
        if self._thread is not None and self._stop_time is None:
            self._stop_time = time.perf_counter_ns()
            self._close_requested.set()
            self._thread.join()
            if self.error is not None:
                raise self.error

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _add(self, write: "Callable[[McapWriter], None]") -> None:
        with self._lock:
            if self.error is not None or self._closed:
                return
            if self._file is None:
                self._pending_writes.append(write)
                return
            try:
                write(self._file)
            except (OSError, ValueError) as error:
                self.error = error

    @contextmanager
    def _keep_first_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self.error = self.error or error

    def _run(self) -> None:
        with self._keep_first_error():
            self._write_all()
        self._subscription.close()
        with self._lock, self._keep_first_error():
            self._write_lasting_outage()
        with self._lock, self._keep_first_error():
            self._closed = True
            if self._file is not None:
                self._file.close()
        with self._keep_first_error():
            if self._file is not None and self._file.path != self.path:
                _convert_to_hdf5(self._file.path, self.path, self.overwrite)

    def _write_all(self) -> None:
        while self.error is None:
            stop_time = self._stop_time
            try:
                frame = self._subscription.get(0.0 if stop_time is not None else _POLL_SECONDS)
            except TimeoutError:
                if stop_time is not None:
                    return
                self._flush()
                continue
            except StreamEnded:
                # The predictions for the last frames come after them.
                while not self._close_requested.wait(_POLL_SECONDS):
                    self._flush()
                return
            if stop_time is not None and frame.received > stop_time:
                return
            with self._lock:
                if self._is_after_end(frame):
                    return
                self._write(self._infinite_to_nan(frame))

    def _end_time(self) -> float:
        if self._file is None or self.max_seconds is None:
            return float("inf")
        return self._first_time + self.max_seconds

    def _is_after_end(self, frame: LiveFrame) -> bool:
        if frame.time <= self._end_time():
            return False
        assert self._file is not None
        if self._ends_outage(frame):
            _write_gap(self._file, self._last_time, self._end_time())
        self._has_ended = True
        return True

    def _ends_outage(self, frame: LiveFrame) -> bool:
        if frame.time - self._last_time <= _MIN_OUTAGE_SECONDS:
            return False  # runs for every frame: the loop below would be slow
        return any(outage.end == frame.time for outage in reversed(self.stream.outages))

    def _write_lasting_outage(self) -> None:
        if (
            self._file is None
            or self._has_ended
            or self._stop_time is None
            or self.error is not None
        ):
            return
        end = min(self._stop_time * 1e-9, self._end_time())
        if self.stream.open_outage(end) is not None:
            _write_gap(self._file, self._last_time, end)

    def _flush(self) -> None:
        with self._lock:
            if self._file is not None:
                self._file.flush()

    def _write(self, frame: LiveFrame) -> None:
        if self._file is None:
            self._open(frame)
        assert self._file is not None
        if self.frames and self._ends_outage(frame):
            _write_gap(self._file, self._last_time, frame.time)
        self._file.write_frame(frame)
        self.frames += 1
        self._last_time = frame.time
        if frame.time >= self._next_points and self._points is not None:
            self._next_points = frame.time + _POINTS_SECONDS
            self._write_points(frame, self._points)
        if frame.time >= self._next_health:
            self._next_health = frame.time + _HEALTH_SECONDS
            self._file.write_health(frame.time, asdict(self.stream.health()))

    def _open(self, frame: LiveFrame) -> None:
        # At the first frame, since the metadata of a source is complete only when it is open.
        from torch_geometric_tactile.io import McapWriter

        meta, mcap_path = _file_meta(self.stream), _mcap_path(self.path)
        if self._points is not None:
            self._points.name_joints(meta.get("joint_names"))
            meta["sensor"] = self._points.layout.name
        name = meta.get("sensor")
        self._file = McapWriter(
            mcap_path,
            meta=meta,
            anchor=self.stream.anchor,
            layout=name if isinstance(name, str) else None,
            label=self.label,
            overwrite=self.overwrite and mcap_path == self.path,
        )
        self._first_reading = frame.tactile
        self._first_time = frame.time
        for write in self._pending_writes:
            write(self._file)
        self._pending_writes = []

    def _write_points(self, frame: LiveFrame, pose_points: "PosedPoints") -> None:
        rest = self._first_reading if self.rest is None else self.rest
        assert self._file is not None
        try:
            points = pose_points(frame, rest)
            self._file.write_points(frame.time, points.pos, points.fields, points.frame_id)
        except ValueError as error:
            # Only viewers need the points: they must not end a recording.
            _log.warning("'%s': no more points are written: %s", self.path, error)
            self._points = None

    def _infinite_to_nan(self, frame: LiveFrame) -> LiveFrame:
        finite_frame = _replace_infinite(frame)
        if finite_frame is not frame and not self._has_warned:
            self._has_warned = True
            _log.warning("'%s': infinite readings are written as missing", self.path)
        return finite_frame


def preload_recorder(layout: "TaxelLayout | PathLike | None") -> "PosedPoints | None":
    r"""Imports the libraries of a recorder, so that no frame of a stream waits for them. Returns
    the object that poses the taxels of a layout, or :obj:`None` without a layout.
    """
    from torch_geometric_tactile.io import recording_mcap  # noqa: F401 - imports the libraries
    from torch_geometric_tactile.io._mcap_output import require_mcap

    require_mcap()
    for topic in TOPICS:  # encoding the first message of a topic is slow
        encode(topic, {})
    if layout is None:
        return None
    from torch_geometric_tactile.live._posed_points import PosedPoints

    return PosedPoints(layout)


def _replace_infinite(frame: LiveFrame) -> LiveFrame:
    joint = frame.joint
    if not np.isinf(frame.tactile).any() and (joint is None or not np.isinf(joint).any()):
        return frame
    return replace(
        frame,
        tactile=np.where(np.isinf(frame.tactile), np.nan, frame.tactile).astype(np.float32),
        joint=None if joint is None else np.where(np.isinf(joint), np.nan, joint),
    )


def _write_prediction(file: "McapWriter", judgement: Any) -> None:
    label = judgement.label
    file.write_prediction(
        judgement.time,
        judgement.probability,
        judgement.class_names,
        label if isinstance(label, str) else ", ".join(map(str, label)),
        sequence=judgement.sequence,
        task=str(judgement.task),
        latency=judgement.latency.get("total"),
    )


def _write_gap(file: "McapWriter", start: float, end: float) -> None:
    file.write_event(start, SPAN_START, GAP)
    file.write_event(end, SPAN_END, GAP)


def _file_meta(stream: "Stream") -> dict[str, Any]:
    source_meta = {
        name: value for name, value in stream.meta.items() if name != "events"
    }  # of a replayed file
    return {
        **source_meta,
        "source": stream.source.name,
        "checksum": stream.source.checksum,
        "recorded_at": stream.anchor[0] / 1e9,
    }


def _mcap_path(path: Path) -> Path:
    # The file that frames are written to: for an HDF5 file, an MCAP file beside it.
    return path if path.suffix.lower() == ".mcap" else path.with_suffix(".mcap")


def _check_target(path: Path, overwrite: bool) -> None:
    from torch_geometric_tactile.io._hdf5_file import require_h5py
    from torch_geometric_tactile.io._mcap_output import require_mcap

    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"'{path}' must end in one of {', '.join(_SUFFIXES)} (got '{suffix}')")
    require_mcap()
    mcap_path = _mcap_path(path)
    if mcap_path != path:
        require_h5py()
    if not path.parent.is_dir():
        raise FileNotFoundError(f"'{path.parent}' does not exist: create the folder first")
    _check_overwrite(path, overwrite)
    if mcap_path != path and mcap_path.exists():
        raise FileExistsError(
            f"'{mcap_path}' exists, but '{path}' would be recorded to it first: convert it "
            f"({_convert_command(mcap_path, path)}), move it, or choose another name"
        )
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(f"'{path.parent}' cannot be written to")


def _check_overwrite(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(
            f"'{path}' exists: choose another name, or overwrite it (--overwrite)"
        )


def _convert_to_hdf5(mcap_path: Path, path: Path, overwrite: bool) -> None:
    from torch_geometric_tactile.io import read_mcap, write_hdf5

    try:
        _check_overwrite(path, overwrite)
        write_hdf5(read_mcap(mcap_path, recover=False, allow_large=True), path)
    except BaseException:
        _log.error(
            "'%s' was not written; the recording is in '%s': %s",
            path,
            mcap_path,
            _convert_command(mcap_path, path),
        )
        raise
    mcap_path.unlink()


def _convert_command(mcap_path: Path, path: Path) -> str:
    return f"tactile convert {shlex.quote(str(mcap_path))} {shlex.quote(str(path))}"
