r"""The viewer's page in a headless browser: what it asks for, and how old what it shows is."""

import http.client
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from torch_geometric_tactile.live import ReplaySource, Stream, Viewer

_SECONDS = 5.0
_SETTLE = 3.0  # seconds in which the page finds out how much it can draw
_WIDTHS = {"phone": (390, 844), "desk": (1280, 800)}
_THROTTLES = (1, 4, 6)
# The number of each frame, and how old the one before was when it was on the screen.
_LOG = """() => {
  window.log = [];
  const before = take;
  take = (message, now) => { before(message, now); log.push([message.sequence, message.age]); };
}"""


def measure_page(folder: Path) -> dict[str, Any]:
    r"""Returns what the page does."""
    from live_hour import write_hour
    from playwright.sync_api import sync_playwright

    path = folder / "page.npz"
    write_hour(path, 4.0, 100.0)
    found: dict[str, Any] = {}
    with Stream(ReplaySource(path, loop=True)) as stream, Viewer(stream) as viewer:
        found["foreign host"] = _status(viewer.url, {"Host": "evil.example"})
        found["foreign origin"] = _status(viewer.url, {"Origin": "http://evil.example"})
        with sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"]
            )
            asked: list[str] = []
            for width, size in _WIDTHS.items():
                context = browser.new_context(viewport={"width": size[0], "height": size[1]})
                page = context.new_page()
                page.on("request", lambda request: asked.append(request.url))
                page.on("websocket", lambda socket: asked.append(socket.url))
                page.goto(viewer.url)
                page.evaluate(_LOG)
                for rate in _THROTTLES:
                    context.new_cdp_session(page).send(
                        "Emulation.setCPUThrottlingRate", {"rate": rate}
                    )
                    page.wait_for_timeout(1000 * _SETTLE)
                    page.evaluate("() => { log.length = 0; }")
                    page.wait_for_timeout(1000 * _SECONDS)
                    log = [row for row in page.evaluate("log") if row[1] is not None]
                    ages = np.array([age for _, age in log])
                    found[f"{width}, throttled {rate} x"] = {
                        "age p50 (ms)": float(np.percentile(ages, 50)),
                        "age p99 (ms)": float(np.percentile(ages, 99)),
                        "frames a second": len({number for number, _ in log}) / _SECONDS,
                    }
                context.close()
            browser.close()
    host = urlsplit(viewer.url).netloc
    found["requests"] = len(asked)
    found["foreign requests"] = sum(urlsplit(url).netloc != host for url in asked)
    return found


def _status(url: str, headers: dict[str, str]) -> int:
    parts = urlsplit(url)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=10)
    connection.request("GET", "/", headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status
