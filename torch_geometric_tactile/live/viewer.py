r"""The viewer: a page in the browser that shows a stream."""

import asyncio
import ipaddress
import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.live._viewer.client import ViewerClient
from torch_geometric_tactile.live._viewer.page import ViewerPage
from torch_geometric_tactile.live._viewer.screen import ViewerScreen
from torch_geometric_tactile.live._web_server import WebServer

if TYPE_CHECKING:
    from torch_geometric_tactile.live.judge import Judgement
    from torch_geometric_tactile.live.stream import Stream
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_LOG = logging.getLogger(__name__)
_MOST_PAGES = 8
_CLOSING = 1.0  # seconds that a page is waited for


class Viewer:
    r"""Shows a stream on a page in the browser: the hand in its pose, readings as colour and shear
    as arrows, label probabilities, rate, age and loss.

    The page is one file that asks nobody else for anything. It is served on this machine only,
    unless :obj:`host` says otherwise, and a page of another site cannot read it or press its
    buttons: requests whose :obj:`Host` is a foreign name, or whose :obj:`Origin` is another page's,
    are refused. There is no password: whoever may open connections to :obj:`host`, as other users
    of this machine, sees what is shown and may press the buttons.

    Each page has a subscription of its own that keeps the newest frame only, and gets it when the
    one before is on the screen: a slow page skips frames, never lags, and holds nobody up. Without
    a page open nothing is done.

    Args:
        stream (Stream): The stream; it may be opened later.
        layout (TaxelLayout, str or PathLike, optional): Where the taxels are: a layout, its name or
            its file. If left out, the one that the source names as :obj:`"sensor"`; without one,
            taxels are a grid by number.
        host (str): Address to serve on.
        port (int): Port to serve on; any free one if 0.
        joint (numpy.ndarray, optional): Joint angles in radians to show while frames carry none;
            those of an open hand if left out.
        kinematics (HandKinematics, optional): The hand that carries the layout; the Allegro hand if
            left out, for layouts of its links.

    Attributes:
        on_tare (callable, optional): Called without arguments, in a thread of its own, when the
            tare button is pressed. If :obj:`None`, the rest that is shown is measured anew.
        on_record (callable, optional): Called likewise by the record button, to begin or end a
            recording; set :attr:`recording` in it. Without it there is no such button.

    Raises:
        ImportError: If websockets is missing.
        ValueError: If the layout, its hand and the joint angles do not fit.

    Examples:
        >>> from torch_geometric_tactile.live import ReplaySource, Stream, Viewer
        >>> stream = Stream(ReplaySource("grasp.h5", loop=True))
        >>> viewer = Viewer(stream, port=8000)
        >>> viewer.url
        'http://127.0.0.1:8000/'
        >>> with stream, viewer:  # doctest: +SKIP
        ...     input("Enter ends ")
    """

    def __init__(
        self,
        stream: "Stream",
        layout: "TaxelLayout | PathLike | None" = None,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        joint: np.ndarray | None = None,
        kinematics: "HandKinematics | None" = None,
    ) -> None:
        self._screen = ViewerScreen(stream, layout, joint, kinematics)
        self._turn = asyncio.Lock()
        self._server = WebServer(
            self._show,
            host,
            port,
            name="the viewer",
            most=_MOST_PAGES,
            closing=_CLOSING,
            page=ViewerPage().answer,
        )

    def start(self) -> None:
        r"""Begins to serve, in a thread of its own; does nothing if it does already.

        Raises:
            OSError: If the port is taken or the address is not one of this machine.
        """
        self._screen.prepare()
        self._turn = asyncio.Lock()
        self._server.start()
        if not _is_local(self._server.host):
            _LOG.warning(
                "the viewer is served on '%s': who reaches this address sees it and may press its "
                "buttons",
                self._server.host,
            )

    @property
    def url(self) -> str:
        r"""Address of the page; its port is known once it is served."""
        host = self._server.host
        host = "127.0.0.1" if host in ("", "0.0.0.0") else host
        host = "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
        return f"http://{host}:{self._server.port}/"

    def judgement(self, judgement: "Judgement") -> None:
        r"""Shows what a model says; the last one stays until the next.

        Args:
            judgement (Judgement): The judgement.
        """
        self._screen.judgement = judgement

    def note(self, text: str) -> None:
        r"""Shows a line, such as an event or a warning.

        Args:
            text (str): The line.
        """
        self._screen.note(text)

    @property
    def rest(self) -> np.ndarray | None:
        r"""What readings are shown relative to :math:`(N, C)`. While it is :obj:`None`, the page's
        first second.
        """
        return self._screen.rest.given

    @rest.setter
    def rest(self, rest: np.ndarray | None) -> None:
        self._screen.rest.given = None if rest is None else np.asarray(rest)

    @property
    def recording(self) -> bool:
        r"""Whether a recording is shown as running."""
        return self._screen.recording_since is not None

    @recording.setter
    def recording(self, recording: bool) -> None:
        if recording != self.recording:
            self._screen.recording_since = time.perf_counter() if recording else None

    @property
    def on_tare(self) -> Callable[[], object] | None:
        r"""What the tare button calls."""
        return self._screen.on_tare

    @on_tare.setter
    def on_tare(self, callback: Callable[[], object] | None) -> None:
        self._screen.on_tare = callback

    @property
    def on_record(self) -> Callable[[], object] | None:
        r"""What the record button calls."""
        return self._screen.on_record

    @on_record.setter
    def on_record(self, callback: Callable[[], object] | None) -> None:
        self._screen.on_record = callback

    def close(self) -> None:
        r"""Ends the serving, and disconnects the pages; does nothing if it is closed."""
        self._server.close()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    async def _show(self, connection: Any) -> None:
        await ViewerClient(connection, self._screen, self._turn).run()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r})"


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
