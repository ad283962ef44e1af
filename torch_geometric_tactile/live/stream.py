r"""Live frames for any number of readers."""

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
from torch_geometric_tactile.live._frame_clock import FrameClock
from torch_geometric_tactile.live.clock_map import ClockMap
from torch_geometric_tactile.live.health import Health, HealthMeter
from torch_geometric_tactile.live.outage import Outage
from torch_geometric_tactile.live.source import Source, SourceEnded
from torch_geometric_tactile.live.subscription import Subscription

if TYPE_CHECKING:
    from torch_geometric_tactile.live.taxel_map import TaxelMap, TaxelOrder
    from torch_geometric_tactile.sensors import TaxelLayout

_log = logging.getLogger(__name__)
_READ = 0.1  # seconds that one read of the source may wait
_BACK_OFF = (0.1, 2.0)
_JOIN = 10.0
_OPEN_OUTAGE = 0.25  # seconds: a busy machine delivers late what came in time


class Stream:
    r"""Reads a source in one thread and passes its frames to any number of subscribers.

    Subscribe before opening, so that no frame is missed. A source that is lost after it was open is
    opened again, first after 0.1 s and then in steps up to 2 s, or as soon as it is seen to be
    back. All of this shows in :meth:`health`. Any other error of the source ends the stream, and is
    raised at every subscriber. A stream is opened once. The readings are shared by all subscribers,
    who must not write into them.

    Args:
        source (Source): The source; the stream opens and closes it.
        taxel_map (TaxelMap, optional): The order of the taxels, from that of the source to that of
            a layout.
        layout (TaxelLayout or TaxelOrder, optional): The layout that the taxels are wanted in. If
            the source sends them as they are wired (:attr:`Source.device_order`) and no map is
            given, the map is that which comes with the package for the sensor and this layout
            (:meth:`TaxelMap.for_sensor`).
        silent_after (float): After how many seconds without a frame the state is :obj:`"silent"`.

    Attributes:
        anchor (tuple of int): One moment in nanoseconds since 1970, and on the monotonic clock: the
            date of frame :obj:`f` is :obj:`anchor[0] + f.time * 1e9 - anchor[1]`.
        error (BaseException, optional): What the source raised, if it failed.

    Raises:
        ValueError: If :obj:`silent_after` is not positive. When it is opened, or at the first
            frame, if the order of the taxels is not known to be that of :obj:`layout`.

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
        self._clock = ClockMap(source.clock_period)
        self._numbers = FrameClock()
        self._coarse = False  # whether device times repeat
        self._device_time: float | None = None
        self._device_info: FrameInfo | None = None
        self._source_info: FrameInfo | None = None
        self._mapped_info: FrameInfo | None = None
        self._last: LiveFrame | None = None
        self._outages: list[Outage] = []
        self._since = math.inf
        self._until = math.inf
        self._subscriptions: tuple[weakref.ref[Subscription], ...] = ()
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._over = False
        self._thread: threading.Thread | None = None

    @property
    def state(self) -> str:
        r"""The state, as in :class:`Health`."""
        return self._state

    @property
    def seconds(self) -> float:
        r"""Seconds since the first frame, or since it was opened while there is none; limits count
        from there. Negative infinity before it is opened."""
        return time.perf_counter() - self._since

    @property
    def meta(self) -> dict[str, Any]:
        r"""What is known about the readings, after the map of taxels."""
        meta = dict(self.source.meta)
        if self.taxel_map is not None and self.taxel_map.layout:
            meta["sensor"] = self.taxel_map.layout
        return meta

    def health(self) -> Health:
        r"""Returns how well it runs, at this moment."""
        now = time.perf_counter()
        lasting = None if self._state == "open" else self.open_outage(now)
        outages = [*self.outages, *([] if lasting is None else [lasting])]
        return self._meter.snapshot(self._state, self.source, outages=outages)

    @property
    def rate(self) -> float | None:
        r"""Frames per second by their numbers, so that lost frames do not lower it, on the clock of
        the device: a recording that is replayed at double speed has its own rate. :obj:`None` until
        a second has passed, and for a source that waits (:attr:`Source.waits`)."""
        rate = self._numbers.rate
        if rate is None or self.source.waits:
            return None
        return rate / self.source.clock_rate

    @property
    def outages(self) -> tuple[Outage, ...]:
        r"""The outages that are over: times between two frames of more than five periods, and at
        least 50 ms. A source that waits has none."""
        return tuple(self._outages)

    def open_outage(self, now: float) -> Outage | None:
        r"""Returns the outage that lasts up to a moment, if there is one: no frame came for a
        quarter of a second and five periods, and the source has not ended.

        Args:
            now (float): The moment, as of :func:`time.perf_counter`.
        """
        last = self._last
        if last is None or self._state == "ended" or self.source.waits:
            return None
        end = min(now, self._until)
        is_outage = end - last.time > max(_OPEN_OUTAGE, self._numbers.largest_gap)
        return Outage(last.time, end) if is_outage else None

    def require_frames(self) -> None:
        r"""Does nothing if frames came.

        Raises:
            OSError: If none came; the message says what came instead, and what to check.
        """
        if not self._meter.frames:
            raise OSError(f"'{self.source.name}' sent no frame: {self.source.why_no_frame()}")

    def subscribe(self, policy: Policy = "all", size: int | None = None) -> Subscription:
        r"""Returns a queue of the frames from now on. One that nobody holds any more is given up.

        Args:
            policy (str): :obj:`"all"`, :obj:`"drop_oldest"` or :obj:`"newest"`, see
                :class:`Subscription`.
            size (int, optional): Most frames in the queue.
        """
        subscription = Subscription(policy, size)
        with self._lock:
            if self._over:
                subscription.end(self.error)
            else:
                alive = [one for one in self._subscriptions if one() is not None]
                self._subscriptions = (*alive, weakref.ref(subscription))
        return subscription

    def open(self) -> None:
        r"""Opens the source and begins to read; does nothing if it is open.

        Raises:
            OSError: If the source is not there.
            ValueError: If the stream was closed.
        """
        with self._lock:
            if self._over or self._stop.is_set():
                raise ValueError("a stream is opened once: make a new one")
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
        r"""Ends it: closes the source, and wakes all subscribers; does nothing if it is closed."""
        self._stop.set()
        thread = self._thread
        if thread is None:
            self._end(None)
        elif thread is not threading.current_thread():
            thread.join(_JOIN)
            if thread.is_alive():
                _log.warning("%s does not answer, and is left behind", self.source)
                self._end(None)

    def _run(self, opened: "Future[None]") -> None:
        # Everything that touches the source is called here: it is used by one thread.
        try:
            self.source.open()
            taxels = self.source.meta.get("taxels")
            if taxels:
                self._choose_map(sum(taxels))
        except BaseException as failed:
            with suppress(Exception):
                self.source.close()
            self._end(None)
            opened.set_exception(failed)
            return
        self._state = "open"
        self._since = time.perf_counter()
        opened.set_result(None)
        error: BaseException | None = None
        try:
            self._read_all()
        except SourceEnded:
            pass
        except (StopIteration, StopAsyncIteration) as wrong:  # would end a loop in silence
            error = RuntimeError(f"{self.source} raised {type(wrong).__name__}")
            error.__cause__ = wrong
        except BaseException as wrong:
            error = wrong
        finally:
            with suppress(Exception):
                self.source.close()
            self._end(error)

    def _end(self, error: BaseException | None) -> None:
        with self._lock:
            if self._over:
                return
            self._over = True
            self.error = error
            self._until = time.perf_counter()
            self._state = "closed" if self._stop.is_set() or self._state == "closed" else "ended"
            subscriptions = self._subscriptions
        for one in subscriptions:
            subscription = one()
            if subscription is not None:
                subscription.end(error)

    def _read_all(self) -> None:
        last, began = time.perf_counter(), time.perf_counter_ns()
        back_off = _BACK_OFF[0]
        while not self._stop.is_set():
            try:
                frames = self.source.read(_READ)
            except SourceEnded:
                raise
            except (EOFError, OSError) as error:
                if not self.source.reopens:
                    raise
                back_off = self._open_again(error, back_off)
                last = time.perf_counter()
                continue
            if frames:
                self._deliver(frames, began)
                self._state = "open"
                last, back_off = time.perf_counter(), _BACK_OFF[0]
                began = time.perf_counter_ns()  # from here on it waits
            elif time.perf_counter() - last > self.silent_after and self._state != "silent":
                if not self._meter.frames:
                    _log.warning("no frame yet: %s", self.source.why_no_frame())
                self._state = "silent"

    def _open_again(self, error: BaseException, back_off: float) -> float:
        # The next back-off: it is shortened only by a frame, since a port may open and fail at once
        self._state = "lost"
        _log.info("%s is lost (%s), and is opened again", self.source.name, error)
        with suppress(Exception):
            self.source.close()
        while not self._stop.is_set():
            returned = _came_back(self.source, self._stop, back_off)
            back_off = _BACK_OFF[0] if returned else min(2 * back_off, _BACK_OFF[1])
            if self._stop.is_set():
                break
            try:
                self.source.open()
            except SourceEnded:
                raise
            except (EOFError, OSError):
                continue
            self._meter.reconnects += 1
            self._clock.reset()
            self._numbers.reset()
            self._state = "open"
            break
        return back_off

    def _deliver(self, frames: list[LiveFrame], began: int) -> None:
        if self._last is None:
            self._choose_map(len(frames[0].tactile))
            opened, self._since = self._since, time.perf_counter()
            times = self._times(frames, began, opened)
        else:
            times = self._times(frames, began)
        for frame, at in zip(frames, times, strict=True):
            self._meter.observe(frame)
            frame = self._mapped(frame, at)
            self._note_outage(frame)
            self._last = frame
            for one in self._subscriptions:
                if self.source.waits:
                    self._wait_for_room(one)
                subscription = one()
                if subscription is not None:
                    self._meter.dropped += subscription.put(frame)

    def _choose_map(self, num_taxels: int) -> None:
        # Once the sensor is known, and before a frame is delivered.
        layout, self._layout = self._layout, None
        if layout is not None:
            from torch_geometric_tactile.live.taxel_map import TaxelMap

            models = self.source.meta.get("models", ())
            self.taxel_map = TaxelMap.for_sensor(models, num_taxels, layout)

    def _wait_for_room(self, one: "weakref.ref[Subscription]") -> None:
        while not self._stop.is_set():
            subscription = one()  # asked each time, since its reader may give it up meanwhile
            if subscription is None or subscription.has_room(_READ):
                return
            del subscription

    def _note_outage(self, frame: LiveFrame) -> None:
        last = self._last
        if last is None or self.source.waits:
            return
        if frame.time - last.time > self._numbers.largest_gap:
            lost = max(0, frame.sequence - last.sequence - 1)
            self._outages.append(Outage(last.time, frame.time, lost))

    def _times(self, frames: list[LiveFrame], began: int, since: float = -math.inf) -> list[float]:
        times: list[float] = []
        reads = [frames]
        if len(frames) > 1:
            reads = [[*group] for _, group in groupby(frames, key=lambda frame: frame.received)]
        for arrived in reads:
            received = arrived[0].received
            if self._has_exact_times(arrived):
                times += [self._exact_time(frame) for frame in arrived]
                continue
            # A source that received it before it was asked does not depend on the reader.
            waited = (received - began) * 1e-9 if received >= began else math.inf
            numbers = [frame.sequence for frame in arrived]
            times += self._numbers.times(numbers, received * 1e-9, waited=waited, since=since)
        return times

    def _has_exact_times(self, frames: list[LiveFrame]) -> bool:
        if self._coarse or not self.source.exact_clock or not math.isfinite(self.source.clock_rate):
            return False
        before = self._device_time
        for frame in frames:
            if frame.device_time is None:
                return False
            if frame.device_time == before:
                self._coarse = True
                return False
            before = frame.device_time
        self._device_time = before
        return True

    def _exact_time(self, frame: LiveFrame) -> float:
        assert frame.device_time is not None
        mapped = self._clock.map(frame.device_time / self.source.clock_rate, frame.received)
        return self._numbers.observe(frame.sequence, mapped)

    def _mapped(self, frame: LiveFrame, at: float) -> LiveFrame:
        tactile, info = frame.tactile, frame.info or self._unit_info()
        if self.taxel_map is not None:
            tactile = self.taxel_map.apply(tactile)
            info = self._info_of_map(info)
        return LiveFrame(
            frame.sequence,
            at,
            frame.received,
            frame.device_time,
            tactile,
            frame.joint,
            frame.extra,
            info,
        )

    def _unit_info(self) -> FrameInfo:
        # Of a device: only its unit is known. One object for all frames.
        if self._device_info is None:
            self._device_info = FrameInfo(unit=self.source.meta.get("unit"))
        return self._device_info

    def _info_of_map(self, info: FrameInfo) -> FrameInfo:
        # One object for all frames of a source, since readers compare each that is new to them.
        # The names of the columns are in the order of the source.
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


def _came_back(source: Source, stop: threading.Event, back_off: float) -> bool:
    # Waits, but no longer than until a source that was gone is seen to be back.
    deadline = time.perf_counter() + back_off
    missing = not source.is_there()
    while not stop.wait(max(0.0, min(_READ, deadline - time.perf_counter()))):
        there = source.is_there()
        if missing and there:
            return True
        missing = missing or not there
        if time.perf_counter() >= deadline:
            break
    return False
