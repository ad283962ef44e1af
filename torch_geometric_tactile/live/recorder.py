r"""What comes from a stream, kept in a file."""

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
from torch_geometric_tactile.io._mcap_schemas import SPAN_END, SPAN_START
from torch_geometric_tactile.live._recorder_parts import load_recorder
from torch_geometric_tactile.live.subscription import StreamEnded

if TYPE_CHECKING:
    from torch_geometric_tactile.io import McapWriter
    from torch_geometric_tactile.live._posed_points import PosedPoints
    from torch_geometric_tactile.live.stream import Stream
    from torch_geometric_tactile.sensors import TaxelLayout

_log = logging.getLogger(__name__)
_SUFFIXES = (".mcap", ".h5", ".hdf5")
_WAIT = 0.1
_POINTS_SECONDS = 0.1
_HEALTH_SECONDS = 1.0
_SHORTEST_OUTAGE = 0.05  # seconds


class Recorder:
    r"""Writes all frames of a stream to a file, in a separate thread.

    The file has its final name from the first frame on. After a crash it holds all but the last
    quarter of a second, and can be read as it is by
    :func:`~torch_geometric_tactile.io.read_recording`. An existing file is not replaced unasked.

    An HDF5 file is written once: :obj:`grasp.h5` is recorded as :obj:`grasp.mcap`, which
    :meth:`close` converts and removes. After a crash, or if the conversion fails, the MCAP file
    stays, and :obj:`tactile convert grasp.mcap grasp.h5` makes the other one.

    What takes long, such as loading PyTorch for a layout, is done by the constructor, so that no
    frame waits for it. Start it before the stream is opened, so that no frame is missed. An outage
    (:attr:`Stream.outages`) is an annotation :obj:`"gap"`, from the last frame before it to the
    first one after it. Nothing is dropped in silence:
    what goes wrong, such as a full disk, a stream that died or one that was too fast for the disk,
    is raised by :meth:`close`, and :attr:`error` is set at once; what was written before is kept.

    Readings that are infinite are written as NaN (missing), and told once.

    Args:
        path (str or PathLike): The file, :obj:`.mcap`, or :obj:`.h5` or :obj:`.hdf5`, which holds
            frames, events and annotations only.
        stream (Stream): The stream.
        layout (TaxelLayout, str or PathLike, optional): The layout: for the taxels in space that
            viewers show, ten times a second. Needs :obj:`torch`.
        label (str or int, optional): What the trial is an example of.
        overwrite (bool): Whether to replace a file that exists.
        size (int, optional): Frames that may wait for the disk.
        max_seconds (float, optional): The recording ends with the last frame that is no later than
            this after its first one.

    Attributes:
        frames (int): Frames that were written.
        error (BaseException or None): What went wrong.
        rest (numpy.ndarray or None): Readings at rest :math:`(N, C)`, for the points; the first
            frame if left out.
        annotation (str or None): The label of the annotation that is open.

    Raises:
        FileExistsError: If the file exists and is not to be replaced, or the MCAP file beside it.
        FileNotFoundError: If its folder does not exist.
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
        Recording(time=np.zeros(0), tactile=np.zeros((0, 1, 1)), label=label)  # checks it
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
        self._early: list[Callable[[McapWriter], None]] = []
        self._first = np.zeros(0)
        self._first_time = self._last_time = 0.0
        self._points = load_recorder(layout)
        self._next_points = self._next_health = -float("inf")
        self._told = False
        self._closed = False
        self._is_over = False
        self._stopping: int | None = None
        self._asked = threading.Event()
        self._subscription: Any = None
        self._thread: threading.Thread | None = None

    @property
    def seconds(self) -> float:
        r"""Seconds from the first to the last frame that was written."""
        return self._last_time - self._first_time

    @property
    def is_over(self) -> bool:
        r"""Whether a frame came after :obj:`max_seconds`, so that nothing more is written."""
        return self._is_over

    def start(self) -> None:
        r"""Begins to record; does nothing if it has begun."""
        if self._thread is not None:
            return
        self._subscription = self.stream.subscribe("all", self._size)
        self._thread = threading.Thread(target=self._run, name=f"recorder {self.path}", daemon=True)
        self._thread.start()

    def judgement(self, judgement: Any) -> None:
        r"""Writes the prediction of a model for a frame.

        Args:
            judgement (Judgement): What it said.
        """
        self._add(lambda file: _write_prediction(file, judgement))

    def event(self, kind: str, text: str = "") -> None:
        r"""Writes that something happens now, such as a new tare.

        Args:
            kind (str): What kind of event.
            text (str): More about it.
        """
        self._event(time.perf_counter(), kind, text)

    def annotate(self, label: str) -> None:
        r"""Begins an annotation now, and ends the one that is open; if that has the same label,
        only ends it. What is open at the end of the recording ends there.

        Args:
            label (str): Label of the annotation.

        Raises:
            ValueError: If it is no label that an annotation can have, or :obj:`"gap"`.
        """
        if label == GAP:
            raise ValueError(f"'label' must not be '{GAP}', which the recorder writes for outages")
        checked_annotation((0.0, 0.0, label))
        now, before = time.perf_counter(), self.annotation
        self.annotation = None if label == before else label
        if before is not None:
            self._event(now, SPAN_END, before)
        if self.annotation is not None:
            self._event(now, SPAN_START, label)

    def _event(self, when: float, kind: str, text: str) -> None:
        self._add(lambda file: file.write_event(when, kind, text))

    def close(self) -> None:
        r"""Writes what came up to now, and closes the file.

        Raises:
            OSError: If the disk is full, or the stream was lost or too fast.
            Exception: What the stream raised, or the file refused.
        """
        if self._thread is not None and self._stopping is None:
            self._stopping = time.perf_counter_ns()
            self._asked.set()
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
                self._early.append(write)
                return
            try:
                write(self._file)
            except (OSError, ValueError) as error:
                self.error = error

    @contextmanager
    def _first_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self.error = self.error or error

    def _run(self) -> None:
        with self._first_error():
            self._write_all()
        self._subscription.close()
        with self._lock, self._first_error():
            self._write_lasting_outage()
        with self._lock, self._first_error():
            self._closed = True
            if self._file is not None:
                self._file.close()
        with self._first_error():
            if self._file is not None and self._file.path != self.path:
                _convert(self._file.path, self.path, self.overwrite)

    def _write_all(self) -> None:
        while self.error is None:
            stopping = self._stopping
            try:
                frame = self._subscription.get(0.0 if stopping is not None else _WAIT)
            except TimeoutError:
                if stopping is not None:
                    return
                self._idle()
                continue
            except StreamEnded:
                # What a model says of the last frames comes after them.
                while not self._asked.wait(_WAIT):
                    self._idle()
                return
            if stopping is not None and frame.received > stopping:
                return
            with self._lock:
                if self._is_late(frame):
                    return
                self._write(self._finite(frame))

    def _end_time(self) -> float:
        # Of the recording, if no frame comes before it.
        if self._file is None or self.max_seconds is None:
            return float("inf")
        return self._first_time + self.max_seconds

    def _is_late(self, frame: LiveFrame) -> bool:
        if frame.time <= self._end_time():
            return False
        assert self._file is not None
        if self._ends_outage(frame):
            _write_gap(self._file, self._last_time, self._end_time())
        self._is_over = True
        return True

    def _ends_outage(self, frame: LiveFrame) -> bool:
        if frame.time - self._last_time <= _SHORTEST_OUTAGE:
            return False  # asked for every frame
        return any(outage.end == frame.time for outage in reversed(self.stream.outages))

    def _write_lasting_outage(self) -> None:
        if self._file is None or self._is_over or self._stopping is None or self.error is not None:
            return
        end = min(self._stopping * 1e-9, self._end_time())
        if self.stream.open_outage(end) is not None:
            _write_gap(self._file, self._last_time, end)

    def _idle(self) -> None:
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
        # Only now, since a source knows all about its readings when it is open.
        from torch_geometric_tactile.io import McapWriter

        meta, growing = _meta(self.stream), _growing_path(self.path)
        if self._points is not None:
            self._points.name_joints(meta.get("joint_names"))
            meta["sensor"] = self._points.layout.name
        name = meta.get("sensor")
        self._file = McapWriter(
            growing,
            meta=meta,
            anchor=self.stream.anchor,
            layout=name if isinstance(name, str) else None,
            label=self.label,
            overwrite=self.overwrite and growing == self.path,
        )
        self._first = frame.tactile
        self._first_time = frame.time
        for write in self._early:
            write(self._file)
        self._early = []

    def _write_points(self, frame: LiveFrame, posed: "PosedPoints") -> None:
        rest = self._first if self.rest is None else self.rest
        assert self._file is not None
        try:
            points = posed(frame, rest)
            self._file.write_points(frame.time, points.pos, points.fields, points.frame_id)
        except ValueError as error:
            # What only viewers need must not end a recording.
            _log.warning("'%s' has no points from here on: %s", self.path, error)
            self._points = None

    def _finite(self, frame: LiveFrame) -> LiveFrame:
        finite = _without_infinite(frame)
        if finite is not frame and not self._told:
            self._told = True
            _log.warning("'%s': infinite readings are written as missing", self.path)
        return finite


def _without_infinite(frame: LiveFrame) -> LiveFrame:
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


def _meta(stream: "Stream") -> dict[str, Any]:
    known = {name: value for name, value in stream.meta.items() if name != "events"}  # of a file
    return {
        **known,
        "source": stream.source.name,
        "checksum": stream.source.checksum,
        "recorded_at": stream.anchor[0] / 1e9,
    }


def _growing_path(path: Path) -> Path:
    # The file that grows frame by frame: MCAP, beside an HDF5 file.
    return path if path.suffix.lower() == ".mcap" else path.with_suffix(".mcap")


def _check_target(path: Path, overwrite: bool) -> None:
    from torch_geometric_tactile.io._hdf5_file import require_h5py
    from torch_geometric_tactile.io._mcap_output import require_mcap

    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"'{path}' must end in one of {', '.join(_SUFFIXES)} (got '{suffix}')")
    require_mcap()
    growing = _growing_path(path)
    if growing != path:
        require_h5py()
    if not path.parent.is_dir():
        raise FileNotFoundError(f"'{path.parent}' does not exist: make the folder first")
    _check_new(path, overwrite)
    if growing != path and growing.exists():
        raise FileExistsError(
            f"'{growing}' exists, from which '{path}' would be made: convert it "
            f"({_command(growing, path)}), move it, or give another name"
        )
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(f"'{path.parent}' cannot be written to")


def _check_new(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(f"'{path}' exists: give another name, or overwrite it (--overwrite)")


def _convert(growing: Path, path: Path, overwrite: bool) -> None:
    from torch_geometric_tactile.io import read_mcap, write_hdf5

    try:
        _check_new(path, overwrite)
        write_hdf5(read_mcap(growing, recover=False, allow_large=True), path)
    except BaseException:
        _log.error(
            "'%s' was not written; the recording is in '%s': %s",
            path,
            growing,
            _command(growing, path),
        )
        raise
    growing.unlink()


def _command(growing: Path, path: Path) -> str:
    return f"tactile convert {shlex.quote(str(growing))} {shlex.quote(str(path))}"
