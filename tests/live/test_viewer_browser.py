"""The viewer's page in a real browser."""

import dataclasses
import shutil
import statistics
import time
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")
pytest.importorskip("playwright", reason="needs playwright")

from playwright.sync_api import sync_playwright

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.live import ReplaySource, Stream, Viewer
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin, as_layout

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
LONG = 20.0
SIZES = {"phone": (390, 844), "desk": (1280, 800)}

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs the browser chromium")


@pytest.fixture(scope="module")
def launch_chromium():
    with sync_playwright() as driver:
        yield lambda: driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])


@pytest.fixture(scope="module")
def browser(launch_chromium):
    browser = launch_chromium()
    yield browser
    browser.close()


def grasp(count=200, rate=100.0):
    """A hand whose fingers close, and then feel pressure and shear; two taxels are missing."""
    draw = np.random.default_rng(0)
    closed = np.minimum(np.arange(count) / 100, 1)[:, None].astype(np.float32)
    tactile = draw.normal(0, 2, (count, 384, 3)).astype(np.float32) + 32768
    touched = slice(72, 96)
    tactile[100:, touched, 2] += 1500
    tactile[100:, touched, 0] += 600
    tactile[:, [10, 20]] = np.nan
    return Recording(
        np.arange(count) / rate,
        tactile,
        joint=closed * np.full(16, 0.8, np.float32),
        meta={"sensor": "allegro_uskin", "unit": "count"},
    )


@pytest.fixture(scope="module")
def hand():
    """A viewer of a grasping hand, on which a model says something."""
    with Stream(ReplaySource(grasp(), loop=True)) as stream, Viewer(stream) as viewer:
        viewer.rest = np.where(np.isnan(grasp(1).tactile[0]), np.nan, 32768)
        yield viewer


class Opened:
    """A page, and all that it asked for and complained of."""

    def __init__(self, browser, viewer, size="phone", scheme="dark"):
        width, height = SIZES[size]
        self.context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme
        )
        self.page = self.context.new_page()
        self.asked, self.wrong = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.on("console", lambda message: self.wrong.append(message.text))
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.goto(viewer.url)
        self.wait("shown.frames > 2")

    def wait(self, condition):
        # Not wait_for_function, which the page's policy forbids.
        self.until(lambda: self.page.evaluate(condition), condition)

    def until(self, holds, condition=""):
        deadline = time.monotonic() + LONG
        while not holds():
            assert time.monotonic() < deadline, condition
            self.page.wait_for_timeout(20)

    def __enter__(self):
        return self

    def __exit__(self, kind, *error):
        self.context.close()
        if kind is None:
            assert self.wrong == []


def say(viewer, label="sponge", probability=(0.7, 0.2, 0.1)):
    now = time.perf_counter_ns()
    viewer.judgement(
        SimpleNamespace(
            label=label,
            task="multiclass",
            class_names=("sponge", "mug", "<b>box</b>"),
            probability=np.array(probability),
            lacks_contact=False,
            received=now - 2_000_000,
            finished=now,
        )
    )


def skin():
    draw = np.random.default_rng(0)
    tactile = draw.normal(0, 2, (200, 5, 3)).astype(np.float32)
    tactile[:, 1, 2] -= 400
    tactile[:, 2, 2] += 300
    meta = {"sensor": "anyskin", "unit": "microtesla"}
    return Recording(np.arange(200) / 100, tactile, meta=meta)


def test_a_magnetic_field_is_no_pressure_and_has_two_signs(browser):
    with Stream(ReplaySource(skin(), loop=True)) as stream, Viewer(stream) as viewer:
        viewer.rest = np.zeros((5, 3), np.float32)
        with Opened(browser, viewer, "desk") as opened:
            opened.wait("full >= 400")
            text = opened.page.inner_text("body")
            assert "anyskin" in text
            assert "Field along z, relative to rest" in text
            assert "µT" in text
            assert "essure" not in text
            ticks = opened.page.inner_text("#ticks").split()
            assert [ticks[0].strip("\u2212"), ticks[-2]] == ["500", "500"]


def test_page_asks_nobody_else(browser, hand):
    with Opened(browser, hand) as opened:
        opened.page.wait_for_timeout(300)
        opened.wait("document.getElementById('word').textContent === 'Streaming'")
        assert sorted(opened.asked) == [hand.url, hand.url.replace("http", "ws") + "live"]
        refused = opened.page.evaluate(
            "fetch('http://192.0.2.1/').then(() => 'answered', () => 'refused')"
        )
        assert refused == "refused"
        assert "Content Security Policy" in opened.wrong.pop(0)
        opened.wrong.clear()


def test_picture_is_posed_and_coloured(browser, hand):
    with Opened(browser, hand, "desk") as opened:
        opened.wait("full >= 1000")
        opened.wait(
            "(() => { if (frame && frame.some((v, i) => i % 3 === 2 && v > 1000)) "
            "window.kept = [scene.link, scene.pos, scene.pose].map((one) => [...one]); "
            "return window.kept !== undefined; })()"
        )
        link, pos, pose = map(np.array, opened.page.evaluate("kept"))
        pose = pose.reshape(-1, 12)
        turn = pose[:, :9].reshape(-1, 3, 3)[link.astype(int)]
        places = np.einsum("nij,nj->ni", turn, pos.reshape(-1, 3)) + pose[:, 9:][link.astype(int)]
        import torch

        posed = HandKinematics.allegro().taxel_pose(allegro_uskin(), torch.full((16,), 0.8))
        np.testing.assert_allclose(places, posed.pos.numpy(), atol=1e-5)
        assert opened.page.locator("#missing").inner_text() == "2"
        assert opened.page.locator("#ticks").inner_text().split()[-1] == "counts"
        assert opened.page.evaluate("shearFull") >= 500
        colours = opened.page.evaluate(
            "new Set(new Uint32Array(pen.getImageData(0, 0, canvas.width, canvas.height)"
            ".data.buffer)).size"
        )
        assert colours > 20
        label = opened.page.locator("#scene").get_attribute("aria-label")
        assert label.startswith("384 taxels")


@pytest.mark.full
def test_label_bars(browser, hand):
    say(hand)
    with Opened(browser, hand) as opened:
        opened.wait("document.getElementById('bars').children.length === 3")
        assert opened.page.locator("#said").inner_text() == "sponge"
        assert opened.page.locator("#bars li").all_inner_texts()[0].split() == ["sponge", "70", "%"]
        assert "<b>box</b>" in opened.page.locator("#bars").inner_text()
        meters = opened.page.get_by_role("meter")
        assert [one.get_attribute("aria-valuenow") for one in meters.all()] == ["70", "20", "10"]
        say(hand, "mug", (0.1, 0.9, 0.0))
        opened.wait("document.getElementById('said').textContent === 'mug'")


def test_buttons_and_keys(browser, hand):
    calls = []

    def record():
        calls.append("record")
        hand.recording = not hand.recording
        hand.note("Recording begins" if hand.recording else "Recording ends")

    hand.on_tare, hand.on_record = (lambda: calls.append("tare")), record
    try:
        with Opened(browser, hand) as opened:
            page = opened.page
            page.get_by_role("button", name="Tare").click()
            opened.until(lambda: calls == ["tare"])  # another one is dropped until then
            page.keyboard.press("t")
            page.keyboard.press("Control+t")  # the browser's own
            button = page.locator("#record")
            opened.wait("!document.getElementById('record').hidden")
            button.click()
            opened.wait("document.getElementById('record').getAttribute('aria-pressed') === 'true'")
            assert button.inner_text().startswith("Stop 0:0")
            page.keyboard.press("R")
            opened.wait(
                "document.getElementById('record').getAttribute('aria-pressed') === 'false'"
            )
            opened.wait("document.getElementById('notes').children.length === 2")
            assert "Recording ends" in page.locator("#notes li").first.inner_text()
    finally:
        hand.on_tare = hand.on_record = None
    assert calls == ["tare", "tare", "record", "record"]


def test_view_is_turned_by_keys_pointer_and_wheel(browser, hand):
    with Opened(browser, hand, "desk") as opened:
        page, canvas = opened.page, opened.page.locator("#scene")
        before = page.evaluate("[yaw, pitch, zoom]")
        canvas.press("ArrowLeft")
        canvas.press("ArrowDown")
        canvas.press("+")
        turned = page.evaluate("[yaw, pitch, zoom]")
        assert all(abs(new - old) > 0.05 for new, old in zip(turned, before, strict=True))
        canvas.press("0")
        assert page.evaluate("[yaw, pitch, zoom]") == before
        page.mouse.move(400, 400)
        page.mouse.down()
        page.mouse.move(500, 400)
        page.mouse.up()
        page.mouse.wheel(0, -300)
        opened.wait("zoom > 1")
        assert page.evaluate("yaw") > before[0]
        page.get_by_role("button", name="Reset view").click()
        assert page.evaluate("[yaw, pitch, zoom]") == before


@pytest.mark.full
@pytest.mark.parametrize("scheme", ["dark", "light"])
@pytest.mark.parametrize("size", list(SIZES))
def test_text_has_contrast_and_fits(browser, hand, size, scheme):
    say(hand)
    with Opened(browser, hand, size, scheme) as opened:
        opened.wait("document.getElementById('bars').children.length === 3")
        found = opened.page.evaluate(CONTRASTS)
        assert len(found) > 25
        assert [one for one in found if one[1] < 4.5] == []
        for name in ("silent", "lost", "ended", "closed", "failed", "offline"):
            text = f"it is {name}"
            found = opened.page.evaluate(f"(state('{name}', '{text}', ''), ({CONTRASTS})())")
            assert next(ratio for shown, ratio in found if shown == text) >= 4.5
        width = opened.page.evaluate("document.documentElement.scrollWidth")
        assert width <= SIZES[size][0]


# Each text on the page and its contrast with what is behind it, as WCAG 2 defines it.
CONTRASTS = r"""() => {
  const number = (text) => text.match(/[\d.]+/g).map(Number);
  const light = (c) => [0.2126, 0.7152, 0.0722].reduce((sum, weight, k) => {
    const v = c[k] / 255;
    return sum + weight * (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  }, 0);
  const behind = (node) => {
    for (; node; node = node.parentElement) {
      const c = number(getComputedStyle(node).backgroundColor);
      if (c.length === 3 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), out = [];
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || !node.checkVisibility()) continue;
    if (node.tagName === "SCRIPT" || node.classList.contains("unseen")) continue;
    const one = light(number(getComputedStyle(node).color)), other = light(behind(node));
    const ratio = (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05);
    out.push([walker.currentNode.textContent.trim(), ratio]);
  }
  return out;
}"""

# Takes down the number of each frame, and how old it and the one before were when it was shown.
LOG = """() => {
  window.log = [];
  const before = take;
  take = (message, now) => { before(message, now); log.push([message.sequence, message.age]); };
}"""


def test_throttled_page_skips_frames_and_stays_young(browser, hand):
    with Opened(browser, hand) as opened:
        session = opened.context.new_cdp_session(opened.page)
        session.send("Emulation.setCPUThrottlingRate", {"rate": 6})
        opened.page.evaluate(LOG)
        ages = []
        deadline = time.monotonic() + LONG
        while time.monotonic() < deadline:  # a busy machine may throttle it further
            opened.page.evaluate("() => { log.length = 0; }")
            opened.page.wait_for_timeout(1000)
            log = opened.page.evaluate("log")
            ages.append(statistics.median(age for _, age in log if age is not None))
            if ages[-1] < 100:
                break
        assert min(ages) < 100  # milliseconds
        assert any(new - old > 1 for (old, _), (new, _) in pairwise(log))


def test_page_that_sleeps_and_browser_that_closes_lose_nothing(launch_chromium):
    stream = Stream(ReplaySource(grasp(), loop=True))
    everything = stream.subscribe("all")
    with stream, Viewer(stream) as viewer:
        browser = launch_chromium()
        opened = Opened(browser, viewer)
        opened.page.evaluate(
            "() => { const old = draw; draw = () => { "
            "for (const end = performance.now() + 50; performance.now() < end;); old(); }; }"
        )
        opened.page.wait_for_timeout(500)
        browser.close()
        shown = [everything.get(LONG).sequence]
        while shown[-1] < stream.health().frames - 1 or len(shown) < 100:
            shown.append(everything.get(LONG).sequence)
    assert shown == list(range(len(shown)))
    assert everything.dropped == 0


def test_annotations_have_lanes_and_those_of_now_are_told(browser):
    spans = [(0.0, 0.5, "open"), (0.5, 5.0, "<b>slip</b>"), (1.0, 1.5, "open")]
    replayed = dataclasses.replace(grasp(), annotations=spans)
    with (
        Stream(ReplaySource(replayed, loop=True)) as stream,
        Viewer(stream) as viewer,
        Opened(browser, viewer, "desk") as opened,
    ):
        lanes = 'document.querySelectorAll("#spans li")'
        assert opened.page.inner_text("#spans").split() == ["open", "<b>slip</b>"]
        assert opened.page.evaluate(f'{lanes}[0].querySelectorAll("i").length') == 2
        now = 'document.getElementById("span-now").textContent'
        for text in ("open", "<b>slip</b>", "<b>slip</b>, open"):
            opened.wait(f'{now}.split(", ").sort().join(", ") === "{text}"')
        opened.wait(f'{lanes}[1].className === "on" && {lanes}[0].className === ""')


@pytest.mark.full
def test_the_annotation_that_is_recorded_is_told(browser, hand):
    with Opened(browser, hand) as opened:
        assert opened.page.evaluate('document.getElementById("spans-box").hidden')
        hand.annotation = "slip"
        opened.wait('document.getElementById("span-now").textContent === "slip"')
        hand.annotation = None
        opened.wait('document.getElementById("spans-box").hidden')


NAMES = """(() => {
    const apart = (a, b) => a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
    const names = geometry.names.map((name) => name.box), taxels = [];
    for (let o = 0; o < geometry.quad.length; o += 8) {
        const quad = [...geometry.quad.slice(o, o + 8)];
        const x = quad.filter((_, k) => k % 2 === 0), y = quad.filter((_, k) => k % 2 === 1);
        taxels.push([Math.min(...x), Math.min(...y), Math.max(...x), Math.max(...y)]);
    }
    const others = names.map((name) => names.filter((one) => one !== name).concat(taxels));
    const inside = ([left, top, right, bottom]) =>
        left >= 0 && top >= 0 && right <= canvas.clientWidth && bottom <= canvas.clientHeight;
    return [names.length, names.every(inside),
            names.every((name, k) => others[k].every((one) => apart(name, one)))];
})()"""


@pytest.mark.parametrize("size", ["phone", "desk"])
@pytest.mark.parametrize(
    ("layout", "angle", "number"),
    [
        ("allegro_uskin", 0.0, 4),
        ("allegro_uskin", 0.9, 4),
        ("allegro_uskin_368", 0.0, 4),
        ("icub_hand", None, 5),
        ("leap_paxini", None, 7),
        ("uskin_gripper", None, 2),
    ],
)
def test_names_are_beside_taxels_and_apart(browser, layout, angle, number, size):
    readings = np.zeros((50, as_layout(layout).num_taxels, 3), np.float32)
    joint = None if angle is None else np.full((50, 16), angle, np.float32)
    recording = Recording(np.arange(50) / 50, readings, joint=joint, meta={"sensor": layout})
    with (
        Stream(ReplaySource(recording, loop=True)) as stream,
        Viewer(stream, layout) as viewer,
        Opened(browser, viewer, size) as opened,
    ):
        opened.wait("geometry !== null")
        assert opened.page.evaluate(NAMES) == [number, True, True]
