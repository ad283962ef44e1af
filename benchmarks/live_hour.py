r"""A recorded hour replayed at four times its speed, with recorder, judge and viewer; and slow
viewers beside a recorder.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.live import Judge, LiveSession, Status, StreamEnded, open_source
from torch_geometric_tactile.sensors import stock_layout

_JOINTS = 16
_BROWSER = "/usr/bin/chromium"


def write_hour(path: Path, seconds: float, rate: float) -> int:
    r"""Writes a recording of 384 taxels, and returns its number of frames."""
    count = int(seconds * rate)
    draw = np.random.default_rng(0)
    tactile = np.empty((count, 384, 3), dtype=np.float32)
    for start in range(0, count, 4096):
        size = min(4096, count - start)
        tactile[start : start + size] = draw.integers(-300, 300, size=(size, 384, 3))
    tactile[:, 0, 0] = np.arange(count) % 60_000
    angle = np.sin(np.arange(count) / rate)[:, None] * np.full(_JOINTS, 0.2) + 0.4
    recording = Recording(
        time=np.arange(count) / rate,
        tactile=tactile,
        joint=angle.astype(np.float32),
        meta={"sensor": "allegro_uskin", "unit": "count", "rate": rate},
    )
    write_recording(recording, path)
    return count


def measure_hour(
    onnx: Path, folder: Path, seconds: float, rate: float, speed: float
) -> dict[str, Any]:
    r"""Returns memory over time, losses, and the part of a core."""
    source, copy = folder / "hour.npz", folder / "copy.mcap"
    count = write_hour(source, seconds, rate)
    session = LiveSession(
        open_source(f"file:{source}?speed={speed}"),
        judge=Judge(onnx, np.zeros((384, 3))),
        layout=stock_layout("allegro_uskin"),
    )
    url = session.view()
    process = psutil.Process()
    memory: list[tuple[float, float]] = []
    session.record(copy)  # before it is opened, for the first frame
    with browsed(url) as has_browser, session:
        spent, start = time.process_time(), time.monotonic()

        def note(status: Status) -> None:
            memory.append((time.monotonic() - start, process.memory_info().rss / 2**20))

        session.run(on_status=note)
        wall = time.monotonic() - start
        spent = time.process_time() - spent
        health = session.stream.health()
        judged = session.judged
    settled = [size for at, size in memory if at > 0.1 * wall]
    back = read_recording(copy)
    return {
        "frames": count,
        "recorded": back.num_frames,
        "same": np.array_equal(back.tactile[:, 0, 0], np.arange(count) % 60_000),
        "judged": judged,
        "lost": health.lost,
        "minutes": wall / 60,
        "browser": has_browser,
        "memory at 10 % (MB)": settled[0],
        "highest after (MB)": max(settled),
        "lowest after (MB)": min(settled),
        "growth (MB)": float(np.mean(settled[-20:]) - np.mean(settled[:20])),
        "core (%)": 100 * spent / wall,
    }


@contextmanager
def browsed(url: str) -> Iterator[bool]:
    r"""Shows a page in a headless browser; yields whether there is one."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        yield False
        return
    if not Path(_BROWSER).exists():
        yield False
        return
    opened, leave = threading.Event(), threading.Event()

    def show() -> None:
        with sync_playwright() as player:
            browser = player.chromium.launch(executable_path=_BROWSER, args=["--no-sandbox"])
            page = browser.new_page()
            page.goto(url)
            opened.set()
            while not leave.is_set():
                page.wait_for_timeout(500)
            browser.close()

    thread = threading.Thread(target=show)
    thread.start()
    opened.wait(60)
    try:
        yield True
    finally:
        leave.set()
        thread.join()


def measure_slow_viewers(folder: Path, seconds: float) -> dict[str, Any]:
    r"""Returns what a recorder has beside a reader that sleeps 50 ms a frame, and a browser that is
    closed in mid-stream.
    """
    source, copy = folder / "short.npz", folder / "short.mcap"
    count = write_hour(source, seconds, 500.0)
    session = LiveSession(open_source(str(source)), layout=stock_layout("allegro_uskin"))
    url = session.view()
    slow = session.stream.subscribe("newest")
    seen = 0

    def sleepy() -> None:
        nonlocal seen
        try:
            while True:
                slow.get()
                time.sleep(0.05)
                seen += 1
        except StreamEnded:
            return

    thread = threading.Thread(target=sleepy)
    thread.start()
    session.record(copy)
    with session:
        with browsed(url) as has_browser:
            session.run(seconds=seconds / 2)
        session.run()
    thread.join()
    back = read_recording(copy)
    return {
        "frames": count,
        "recorded": back.num_frames,
        "same": np.array_equal(back.tactile[:, 0, 0], np.arange(count) % 60_000),
        "seen by the slow one": seen,
        "browser": has_browser,
    }


def measure_idle(seconds: float) -> dict[str, Any]:
    r"""Returns the part of a core that a stream and a viewer take while nothing comes."""
    from live_wire import sender

    with sender("board", "--seconds", 0.1, "--taxels", 384) as other:
        session = LiveSession(open_source(f"serial:{other.name}?protocol=cobs"))
        session.view()
        with session:
            time.sleep(1.0)
            spent = time.process_time()
            session.run(seconds=seconds)
            spent = time.process_time() - spent
            state = session.stream.state
    return {"seconds": seconds, "state": state, "core (%)": 100 * spent / seconds}
