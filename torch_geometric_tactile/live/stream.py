r"""Streams: the frames of a source for any number of subscribers."""

import logging
import math
import threading
import time
import weakref
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from itertools import groupby
from typing import TYPE_CHECKING, Any, Self

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Policy
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._clock_map import ClockMap
from torch_geometric_tactile.live._frame_clock import FrameClock
from torch_geometric_tactile.live._outage import Outage
from torch_geometric_tactile.live.health import Health, HealthMeter
from torch_geometric_tactile.live.source import Source, SourceEnded
from torch_geometric_tactile.live.subscription import Subscription

if TYPE_CHECKING:
    from torch_geometric_tactile.live.taxel_map import TaxelMap, TaxelOrder
    from torch_geometric_tactile.sensors import TaxelLayout

_log = logging.getLogger(__name__)
_POLL_SECONDS = 0.1
_BACK_OFF_SECONDS = (0.1, 2.0)  # first and longest wait before a source is opened again
_JOIN_SECONDS = 10.0
_MIN_OPEN_OUTAGE = (
    0.25  # seconds; longer than for past outages, since a busy machine delivers frames late
)


class Stream:
    r"""Reads a source in one thread and passes its frames to any number of subscribers.

    Subscribe before opening, so that no frame is missed. If an open source is lost, the stream
    opens it again as soon as it is available, or at intervals that grow from 0.1 s to 2 s.
    :meth:`health` shows this. Any other error of the source ends the stream and is raised for every
    subscriber. A stream can be opened once. All subscribers share the arrays of the readings and
    must not change them.

    Args:
        source (Source): The source. The stream opens and closes it.
        taxel_map (TaxelMap, optional): Map from the taxel order of the source to the order of a
            layout.
        layout (TaxelLayout or TaxelOrder, optional): The layout whose taxel order the frames should
            have. If the source sends taxels in the order of its wiring
            (:attr:`Source.device_order`) and there is no :obj:`taxel_map`, the map of this package
            for the sensor and this layout is used (:meth:`TaxelMap.for_sensor`).
        silent_after (float): Seconds without a frame after which the state is :obj:`"silent"`.

    Attributes:
        anchor (tuple of int): The same moment in nanoseconds since 1970 and on the monotonic clock.
            The date of frame :obj:`f` is :obj:`anchor[0] + f.time * 1e9 - anchor[1]`.
        error (BaseException, optional): The error of the source, if it failed.

    Raises:
        ValueError: If :obj:`silent_after` is not positive. Opening or the first frame raises it if
            the taxel order may differ from the order of :obj:`layout`.

    Examples:
        >>> from torch_geometric_tactile.live import ReplaySource, Stream
        >>> with Stream(ReplaySource("grasp.h5")) as stream:  # doctest: +SKIP
        ...     for frame in stream:
        ...         print(frame.time, stream.health().line())
    """

    def __init__(
        self,
        source: Source,
        *,
        taxel_map: "TaxelMap | None" = None,
        layout: "TaxelLayout | TaxelOrder | None" = None,
        silent_after: float = 1.0,
    ) -> None:
        need(silent_after > 0, "'silent_after' must be positive, in seconds", silent_after)
        self.source = source
        self.taxel_map = taxel_map
        self._layout = layout if source.device_order and taxel_map is None else None
        self.silent_after = silent_after
        self.anchor = (time.time_ns(), time.perf_counter_ns())
        self.error: BaseException | None = None
        self._state = "closed"
        self._meter = HealthMeter()
        self._clock_map = ClockMap(source.clock_period)
        self._frame_clock = FrameClock()
        self._has_coarse_clock = False  # whether device times repeat
        self._device_time: float | None = None
        self._device_info: FrameInfo | None = None
        self._source_info: FrameInfo | None = None
        self._mapped_info: FrameInfo | None = None
        self._last: LiveFrame | None = None
        self._outages: list[Outage] = []
        self._start_time = math.inf
        self._end_time = math.inf
        self._subscriptions: tuple[weakref.ref[Subscription], ...] = ()
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._is_over = False
        self._thread: threading.Thread | None = None

    @property
    def state(self) -> str:
        r"""The state, as in :class:`Health`."""
        return self._state

    @property
    def seconds(self) -> float:
        r"""Seconds since the first frame. Before the first frame, the seconds since the stream was
        opened. Before it is opened, negative infinity."""
        return time.perf_counter() - self._start_time

    @property
    def meta(self) -> dict[str, Any]:
        r"""Metadata of the readings, as in :attr:`Source.meta`, after applying the taxel map."""
        meta = dict(self.source.meta)
        if self.taxel_map is not None and self.taxel_map.layout:
            meta["sensor"] = self.taxel_map.layout
        return meta

    def health(self) -> Health:
        r"""Returns the current state, frame rate and losses of the stream."""
        now = time.perf_counter()
        open_outage = None if self._state == "open" else self.open_outage(now)
        outages = [*self.outages, *([] if open_outage is None else [open_outage])]
        return self._meter.snapshot(self._state, self.source, outages=outages)

    @property
    def rate(self) -> float | None:
        r"""Frames per second by frame numbers, so lost frames do not lower it. The rate is on the
        clock of the device: replaying a recording at double speed does not change it.
        :obj:`None` in the first second, and for a source that waits (:attr:`Source.waits`)."""
        rate = self._frame_clock.rate
        if rate is None or self.source.waits:
            return None
        return rate / self.source.clock_rate

    @property
    def outages(self) -> tuple[Outage, ...]:
        r"""The past outages: times between two frames that exceed both five periods and 50 ms. A
        source that waits has none."""
        return tuple(self._outages)

    def open_outage(self, now: float) -> Outage | None:
        r"""Returns the current outage, or :obj:`None`. There is an outage if no frame has arrived
        for more than a quarter of a second and five periods, and the source has not ended.

        Args:
            now (float): The present time, as returned by :func:`time.perf_counter`.
        """
        last = self._last
        if last is None or self._state == "ended" or self.source.waits:
            return None
        end = min(now, self._end_time)
        is_outage = end - last.time > max(_MIN_OPEN_OUTAGE, self._frame_clock.largest_gap)
        return Outage(last.time, end) if is_outage else None

    def require_frames(self) -> None:
        r"""Raises an error unless a frame was received.

        Raises:
            OSError: If no frame was received; the message gives the reason and the settings to
                check.
        """
        if not self._meter.frames:
            raise OSError(f"'{self.source.name}' sent no frame: {self.source.why_no_frame()}")

    def subscribe(self, policy: Policy = "all", size: int | None = None) -> Subscription:
        r"""Returns a queue of all later frames. The stream drops the queue when nothing refers to
        it any more.

        Args:
            policy (str): :obj:`"all"`, :obj:`"drop_oldest"` or :obj:`"newest"`, see
                :class:`Subscription`.
            size (int, optional): Limit of frames in the queue.
        """
        subscription = Subscription(policy, size)
        with self._lock:
            if self._is_over:
                subscription.end(self.error)
            else:
                active = [reference for reference in self._subscriptions if reference() is not None]
                # A new tuple, so that the reading thread can iterate without the lock.
                self._subscriptions = (*active, weakref.ref(subscription))
        return subscription

    def open(self) -> None:
        r"""Opens the source and starts to read. Does nothing if the stream is open.

        Raises:
            OSError: If the source is not available.
            ValueError: If the stream was closed.
        """
        with self._lock:
            if self._is_over or self._stop.is_set():
                raise ValueError("a stream can be opened only once: create a new one")
            if self._thread is not None:
                return
            opened: Future[None] = Future()
            self._thread = threading.Thread(
                target=self._run, args=(opened,), name=f"stream {self.source.name}", daemon=True
            )
            self._thread.start()
        try:
            opened.result()
        except BaseException:  # such as Ctrl-C
            self._stop.set()
            raise

    def close(self) -> None:
        r"""Closes the source and wakes all subscribers. Does nothing if the stream is closed."""
        self._stop.set()
        thread = self._thread
        if thread is None:
            self._end(None)
        elif thread is not threading.current_thread():
            thread.join(_JOIN_SECONDS)
            if thread.is_alive():
                _log.warning("%s does not respond: it will be closed later", self.source)
                self._end(None)

    def _run(self, opened: "Future[None]") -> None:
        # All calls of the source are made in this thread, since a source is not thread-safe.
        try:
            self.source.open()
            taxels = self.source.meta.get("taxels")
            if taxels:
                self._select_map(sum(taxels))
        except BaseException as open_error:
            with suppress(Exception):
                self.source.close()
            self._end(None)
            opened.set_exception(open_error)
            return
        self._state = "open"
        self._start_time = time.perf_counter()
        opened.set_result(None)
        error: BaseException | None = None
        try:
            self._read_frames()
        except SourceEnded:
            pass
        except (StopIteration, StopAsyncIteration) as failure:
            # Unchanged, it would silently end the loop of a subscriber.
            error = RuntimeError(f"{self.source} raised {type(failure).__name__}")
            error.__cause__ = failure
        except BaseException as failure:
            error = failure
        finally:
            with suppress(Exception):
                self.source.close()
            self._end(error)

    def _end(self, error: BaseException | None) -> None:
        with self._lock:
            if self._is_over:
                return
            self._is_over = True
            self.error = error
            self._end_time = time.perf_counter()
            self._state = "closed" if self._stop.is_set() or self._state == "closed" else "ended"
            subscriptions = self._subscriptions
        for reference in subscriptions:
            subscription = reference()
            if subscription is not None:
                subscription.end(error)

    def _read_frames(self) -> None:
        last_time, wait_start = time.perf_counter(), time.perf_counter_ns()
        back_off = _BACK_OFF_SECONDS[0]
        while not self._stop.is_set():
            try:
                frames = self.source.read(_POLL_SECONDS)
            except SourceEnded:
                raise
            except (EOFError, OSError) as error:
                if not self.source.reopens:
                    raise
                back_off = self._reopen(error, back_off)
                last_time = time.perf_counter()
                continue
            if frames:
                self._deliver(frames, wait_start)
                self._state = "open"
                last_time, back_off = time.perf_counter(), _BACK_OFF_SECONDS[0]
                wait_start = time.perf_counter_ns()  # the next read waits from here on
            elif time.perf_counter() - last_time > self.silent_after and self._state != "silent":
                if not self._meter.frames:
                    _log.warning("no frame yet: %s", self.source.why_no_frame())
                self._state = "silent"

    def _reopen(self, error: BaseException, back_off: float) -> float:
        # Returns the next back-off. Only a frame resets it, since a port may open and fail at once.
        self._state = "lost"
        _log.info("%s is lost (%s) and will be opened again", self.source.name, error)
        with suppress(Exception):
            self.source.close()
        while not self._stop.is_set():
            is_back = _wait_for_source(self.source, self._stop, back_off)
            back_off = _BACK_OFF_SECONDS[0] if is_back else min(2 * back_off, _BACK_OFF_SECONDS[1])
            if self._stop.is_set():
                break
            try:
                self.source.open()
            except SourceEnded:
                raise
            except (EOFError, OSError):
                continue
            self._meter.reconnects += 1
            self._clock_map.reset()
            self._frame_clock.reset()
            self._state = "open"
            break
        return back_off

    def _deliver(self, frames: list[LiveFrame], wait_start: int) -> None:
        if self._last is None:
            self._select_map(len(frames[0].tactile))
            open_time, self._start_time = self._start_time, time.perf_counter()
            times = self._frame_times(frames, wait_start, open_time)
        else:
            times = self._frame_times(frames, wait_start)
        for frame, frame_time in zip(frames, times, strict=True):
            self._meter.observe(frame)
            frame = self._map_frame(frame, frame_time)
            self._add_outage(frame)
            self._last = frame
            for reference in self._subscriptions:
                if self.source.waits:
                    self._wait_for_room(reference)
                subscription = reference()
                if subscription is not None:
                    self._meter.dropped += subscription.put(frame)

    def _select_map(self, num_taxels: int) -> None:
        # Called when the sensor is known, before a frame is delivered.
        layout, self._layout = self._layout, None
        if layout is not None:
            from torch_geometric_tactile.live.taxel_map import TaxelMap

            models = self.source.meta.get("models", ())
            self.taxel_map = TaxelMap.for_sensor(models, num_taxels, layout)

    def _wait_for_room(self, reference: "weakref.ref[Subscription]") -> None:
        while not self._stop.is_set():
            subscription = reference()  # its reader may drop it during the wait
            if subscription is None or subscription.has_room(_POLL_SECONDS):
                return
            del subscription

    def _add_outage(self, frame: LiveFrame) -> None:
        last = self._last
        if last is None or self.source.waits:
            return
        if frame.time - last.time > self._frame_clock.largest_gap:
            num_lost = max(0, frame.sequence - last.sequence - 1)
            self._outages.append(Outage(last.time, frame.time, num_lost))

    def _frame_times(
        self, frames: list[LiveFrame], wait_start: int, since: float = -math.inf
    ) -> list[float]:
        times: list[float] = []
        reads = [frames]
        if len(frames) > 1:
            reads = [[*group] for _, group in groupby(frames, key=lambda frame: frame.received)]
        for read in reads:
            received = read[0].received
            if self._has_exact_times(read):
                times += [self._exact_time(frame) for frame in read]
                continue
            # If the source received it before it was asked to read, the reader was not late.
            wait_seconds = (received - wait_start) * 1e-9 if received >= wait_start else math.inf
            numbers = [frame.sequence for frame in read]
            times += self._frame_clock.times(
                numbers, received * 1e-9, waited=wait_seconds, since=since
            )
        return times

    def _has_exact_times(self, frames: list[LiveFrame]) -> bool:
        if (
            self._has_coarse_clock
            or not self.source.exact_clock
            or not math.isfinite(self.source.clock_rate)
        ):
            return False
        previous = self._device_time
        for frame in frames:
            if frame.device_time is None:
                return False
            if frame.device_time == previous:
                self._has_coarse_clock = True
                return False
            previous = frame.device_time
        self._device_time = previous
        return True

    def _exact_time(self, frame: LiveFrame) -> float:
        assert frame.device_time is not None
        mapped = self._clock_map.map(frame.device_time / self.source.clock_rate, frame.received)
        return self._frame_clock.observe(frame.sequence, mapped)

    def _map_frame(self, frame: LiveFrame, frame_time: float) -> LiveFrame:
        tactile, info = frame.tactile, frame.info or self._device_frame_info()
        if self.taxel_map is not None:
            tactile = self.taxel_map.apply(tactile)
            info = self._map_info(info)
        return LiveFrame(
            frame.sequence,
            frame_time,
            frame.received,
            frame.device_time,
            tactile,
            frame.joint,
            frame.extra,
            info,
        )

    def _device_frame_info(self) -> FrameInfo:
        # One object for all frames of a device, of which only the unit is known.
        if self._device_info is None:
            self._device_info = FrameInfo(unit=self.source.meta.get("unit"))
        return self._device_info

    def _map_info(self, info: FrameInfo) -> FrameInfo:
        # One object for all frames of a source, since readers compare each new object. The column
        # names of readings are removed, because they are in the taxel order of the source.
        if info is not self._source_info:
            joint = {name: info.columns[name] for name in info.columns if name != "tactile"}
            self._source_info, self._mapped_info = info, info.changed(columns=joint)
        assert self._mapped_info is not None
        return self._mapped_info

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[LiveFrame]:
        return self.subscribe()

    def __aiter__(self) -> Subscription:
        return self.subscribe()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.source!r}, state={self._state!r})"


def _wait_for_source(source: Source, stop: threading.Event, back_off: float) -> bool:
    # Waits for the back-off, or until a source that had disappeared is available again.
    deadline = time.perf_counter() + back_off
    was_missing = not source.is_there()
    while not stop.wait(max(0.0, min(_POLL_SECONDS, deadline - time.perf_counter()))):
        is_available = source.is_there()
        if was_missing and is_available:
            return True
        was_missing = was_missing or not is_available
        if time.perf_counter() >= deadline:
            break
    return False
