r"""Subscriptions: queues with the frames of a stream."""

import asyncio
import threading
from collections import deque
from contextlib import suppress
from time import perf_counter
from typing import Self

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Policy
from torch_geometric_tactile.data.live_frame import LiveFrame

_DEFAULT_SIZES: dict[str, int] = {"all": 8192, "drop_oldest": 256, "newest": 1}


class StreamEnded(EOFError):  # noqa: N818 - an end, not an error
    r"""Raised when a stream has ended and there are no more frames.

    Examples:
        >>> subscription = Subscription()
        >>> subscription.end()
        >>> try:
        ...     subscription.get(timeout=1.0)
        ... except StreamEnded as end:
        ...     print(end)
        the stream has ended
    """


class StreamOverflow(OSError):  # noqa: N818 - as OverflowError, without its arithmetic
    r"""Raised when a subscriber that asked for all frames read them too slowly.

    Examples:
        >>> import numpy as np
        >>> subscription = Subscription("all", size=1)
        >>> frame = LiveFrame(0, 0.0, 0, None, np.zeros((4, 3), np.float32))
        >>> subscription.put(frame), subscription.put(frame)  # the second does not fit
        (0, 1)
        >>> subscription.get() is frame
        True
        >>> try:
        ...     subscription.get()
        ... except StreamOverflow as error:
        ...     print(str(error)[:43])
        a subscriber of policy 'all' was too slow:
    """


class Subscription:
    r"""A queue with the frames of a stream for one reader. :meth:`Stream.subscribe
    <torch_geometric_tactile.live.Stream.subscribe>` creates it.

    It is an iterator, and an asynchronous iterator that needs no thread. Frames that are in the
    queue when the stream ends are still delivered.

    Args:
        policy (str): Treatment of a full queue. With :obj:`"all"`, delivery stops, and the reader
            gets :class:`StreamOverflow` after the queued frames. With :obj:`"drop_oldest"`, the
            oldest frame is dropped. :obj:`"newest"` keeps only the newest frame.
        size (int, optional): Limit of frames in the queue; by default 8192 with :obj:`"all"`, and
            256 with :obj:`"drop_oldest"`.

    Attributes:
        dropped (int): Number of frames that were not delivered.
        overflowed (bool): Whether a queue of policy :obj:`"all"` was full.

    Raises:
        ValueError: If there is no such policy, or :obj:`size` is not positive.

    Examples:
        >>> import numpy as np
        >>> subscription = Subscription("newest")
        >>> for i in range(3):
        ...     dropped = subscription.put(LiveFrame(i, 0.0, 0, None, np.zeros((4, 3), np.float32)))
        >>> subscription.get().sequence, subscription.dropped
        (2, 2)
    """

    def __init__(self, policy: Policy = "all", size: int | None = None) -> None:
        need(
            policy in _DEFAULT_SIZES,
            f"'policy' must be one of {list(_DEFAULT_SIZES)} (got {policy!r})",
        )
        size = _DEFAULT_SIZES[policy] if size is None or policy == "newest" else size
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ValueError(f"'size' must be a positive number of frames (got {size!r})")
        self.policy = policy
        self.size = size
        self.dropped = 0
        self.overflowed = False
        self._frames: deque[LiveFrame] = deque()
        self._changed = threading.Condition()
        self._async_waiters: list[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = []
        self._ended = False
        self._error: BaseException | None = None

    def get(self, timeout: float | None = None) -> LiveFrame:
        r"""Returns the next frame.

        Args:
            timeout (float, optional): Limit of the wait in seconds; no limit if left out.

        Raises:
            TimeoutError: If no frame arrives within the timeout.
            StreamEnded: If there are no more frames.
            StreamOverflow: After the queued frames, if a queue of policy :obj:`"all"` was full.
            Exception: The error of the source, if it failed.
        """
        deadline = None if timeout is None else perf_counter() + timeout
        with self._changed:
            while True:
                frame = self._pop_frame()
                if frame is not None:
                    return frame
                remaining = None if deadline is None else deadline - perf_counter()
                if remaining is not None and remaining <= 0:
                    raise TimeoutError(f"no frame arrived within {timeout:g} s")
                self._changed.wait(remaining)

    def poll(self) -> LiveFrame | None:
        r"""Returns the next frame, or :obj:`None` if the queue is empty or the stream has ended.

        Raises:
            StreamOverflow: After the queued frames, if a queue of policy :obj:`"all"` was full.
            Exception: The error of the source, if it failed.
        """
        try:
            return self.get(timeout=0.0)
        except (TimeoutError, StreamEnded):
            return None

    def close(self) -> None:
        r"""Ends the subscription. Readers that wait for a frame get :class:`StreamEnded`."""
        with self._changed:
            self._frames.clear()
            self._error = None
            self.overflowed = False
            self._ended = True
            self._notify_waiting()

    def put(self, frame: LiveFrame) -> int:
        r"""Adds a frame, and returns the number of dropped frames. Called by the stream.

        Args:
            frame (LiveFrame): The frame.
        """
        with self._changed:
            if self._ended:
                return 0
            if self.overflowed:
                self.dropped += 1
                return 1
            is_full = len(self._frames) >= self.size
            if is_full and self.policy == "all":
                self.overflowed = True
            else:
                if is_full:
                    self._frames.popleft()
                self._frames.append(frame)
            self.dropped += is_full
            self._notify_waiting()
            return int(is_full)

    def has_room(self, timeout: float) -> bool:
        r"""Waits until a frame can be added without a loss, and returns whether this is possible.
        Called by the stream.

        Args:
            timeout (float): Limit of the wait in seconds.
        """
        with self._changed:
            return self._changed.wait_for(self._accepts_frame, timeout)

    def _accepts_frame(self) -> bool:
        return self._ended or self.policy != "all" or len(self._frames) < self.size

    def end(self, error: BaseException | None = None) -> None:
        r"""Marks the end of the stream. Called by the stream.

        Args:
            error (BaseException, optional): The error of the source, if it failed.
        """
        with self._changed:
            if not self._ended:
                self._error = error
            self._ended = True
            self._notify_waiting()

    def _pop_frame(self) -> LiveFrame | None:
        if self._frames:
            frame = self._frames.popleft()
            self._changed.notify_all()  # wakes `has_room`
            return frame
        if self.overflowed:
            raise StreamOverflow(
                f"a subscriber of policy 'all' was too slow: its queue of {self.size} frames was "
                f"full, and {self.dropped} frames were lost; use a larger 'size', or policy "
                "'drop_oldest'"
            )
        if self._error is not None:
            raise self._error
        if self._ended:
            raise StreamEnded("the stream has ended")
        return None

    def _notify_waiting(self) -> None:
        self._changed.notify_all()
        waiters, self._async_waiters = self._async_waiters, []
        for loop, future in waiters:
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(_resolve, future)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> LiveFrame:
        try:
            return self.get()
        except StreamEnded:
            raise StopIteration from None

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> LiveFrame:
        await asyncio.sleep(0)  # while the queue is full, other tasks must run too
        loop = asyncio.get_running_loop()
        while True:
            with self._changed:
                try:
                    frame = self._pop_frame()
                except StreamEnded:
                    raise StopAsyncIteration from None
                if frame is not None:
                    return frame
                future = loop.create_future()
                self._async_waiters.append((loop, future))
            try:
                await future
            finally:
                with self._changed:
                    self._async_waiters = [
                        entry for entry in self._async_waiters if entry[1] is not future
                    ]

    def __repr__(self) -> str:
        return f"{type(self).__name__}(policy={self.policy!r}, size={self.size})"


def _resolve(future: "asyncio.Future[None]") -> None:
    if not future.done():
        future.set_result(None)
