r"""What one reader of a stream gets."""

import asyncio
import threading
from collections import deque
from contextlib import suppress
from time import perf_counter
from typing import Self

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Policy
from torch_geometric_tactile.data.live_frame import LiveFrame

_SIZES: dict[str, int] = {"all": 8192, "drop_oldest": 256, "newest": 1}


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
    r"""A queue with the frames of a stream for one reader. Made by :meth:`Stream.subscribe
    <torch_geometric_tactile.live.Stream.subscribe>`.

    It is an iterator, and an asynchronous one that needs no thread. Frames that are in the queue
    when the stream ends are still delivered.

    Args:
        policy (str): What happens if the queue is full: with :obj:`"all"` no later frame is
            delivered, and the end is an error; with :obj:`"drop_oldest"` the oldest frame goes;
            :obj:`"newest"` keeps only the newest frame.
        size (int, optional): Most frames in the queue; by default 8192 with :obj:`"all"`, and 256
            with :obj:`"drop_oldest"`.

    Attributes:
        dropped (int): Frames that were not delivered.
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
        need(policy in _SIZES, f"'policy' must be one of {list(_SIZES)} (got {policy!r})")
        size = _SIZES[policy] if size is None or policy == "newest" else size
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ValueError(f"'size' must be a positive number of frames (got {size!r})")
        self.policy = policy
        self.size = size
        self.dropped = 0
        self.overflowed = False
        self._frames: deque[LiveFrame] = deque()
        self._changed = threading.Condition()
        self._waiting: list[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = []
        self._ended = False
        self._error: BaseException | None = None

    def get(self, timeout: float | None = None) -> LiveFrame:
        r"""Returns the next frame.

        Args:
            timeout (float, optional): How long to wait for it in seconds; without end if left out.

        Raises:
            TimeoutError: If none came in time.
            StreamEnded: If there are no more.
            StreamOverflow: If frames of policy :obj:`"all"` were lost after those delivered.
            Exception: What the source raised, if it failed.
        """
        deadline = None if timeout is None else perf_counter() + timeout
        with self._changed:
            while True:
                frame = self._take()
                if frame is not None:
                    return frame
                left = None if deadline is None else deadline - perf_counter()
                if left is not None and left <= 0:
                    raise TimeoutError(f"no frame came within {timeout:g} s")
                self._changed.wait(left)

    def poll(self) -> LiveFrame | None:
        r"""Returns the next frame if there is one by now, and otherwise :obj:`None`; what ended the
        stream is left to :meth:`get`.
        """
        try:
            return self.get(timeout=0.0)
        except (TimeoutError, StreamEnded):
            return None

    def close(self) -> None:
        r"""Ends the subscription; who waits for a frame is woken with :class:`StreamEnded`."""
        with self._changed:
            self._frames.clear()
            self._error = None
            self.overflowed = False
            self._ended = True
            self._wake()

    def put(self, frame: LiveFrame) -> int:
        r"""Adds a frame, and returns how many were dropped for it. Called by the stream.

        Args:
            frame (LiveFrame): The frame.
        """
        with self._changed:
            if self._ended:
                return 0
            if self.overflowed:
                self.dropped += 1
                return 1
            full = len(self._frames) >= self.size
            if full and self.policy == "all":
                self.overflowed = True
            else:
                if full:
                    self._frames.popleft()
                self._frames.append(frame)
            self.dropped += full
            self._wake()
            return int(full)

    def has_room(self, timeout: float) -> bool:
        r"""Waits until a frame can be added without a loss, and returns whether it can. Called by
        the stream.

        Args:
            timeout (float): How long to wait in seconds.
        """
        with self._changed:
            return self._changed.wait_for(self._takes_more, timeout)

    def _takes_more(self) -> bool:
        return self._ended or self.policy != "all" or len(self._frames) < self.size

    def end(self, error: BaseException | None = None) -> None:
        r"""Says that no more frames come. Called by the stream.

        Args:
            error (BaseException, optional): Why, if the source failed.
        """
        with self._changed:
            if not self._ended:
                self._error = error
            self._ended = True
            self._wake()

    def _take(self) -> LiveFrame | None:
        if self._frames:
            frame = self._frames.popleft()
            self._changed.notify_all()  # there is room now
            return frame
        if self.overflowed:
            raise StreamOverflow(
                f"a subscriber of policy 'all' was too slow: its {self.size} frames were full, and "
                f"{self.dropped} frames are lost; take a larger 'size', or policy 'drop_oldest'"
            )
        if self._error is not None:
            raise self._error
        if self._ended:
            raise StreamEnded("the stream has ended")
        return None

    def _wake(self) -> None:
        self._changed.notify_all()
        waiting, self._waiting = self._waiting, []
        for loop, future in waiting:
            with suppress(RuntimeError):  # its loop is closed
                loop.call_soon_threadsafe(_finish, future)

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
        await asyncio.sleep(0)  # a full queue must not starve the others of the loop
        loop = asyncio.get_running_loop()
        while True:
            with self._changed:
                try:
                    frame = self._take()
                except StreamEnded:
                    raise StopAsyncIteration from None
                if frame is not None:
                    return frame
                future = loop.create_future()
                self._waiting.append((loop, future))
            try:
                await future
            finally:
                with self._changed:
                    self._waiting = [entry for entry in self._waiting if entry[1] is not future]

    def __repr__(self) -> str:
        return f"{type(self).__name__}(policy={self.policy!r}, size={self.size})"


def _finish(future: "asyncio.Future[None]") -> None:
    if not future.done():
        future.set_result(None)
