import struct

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from viewer_pages import Page, ask, unpack, wait
from websockets.exceptions import InvalidStatus

from torch_geometric_tactile.live import Viewer
from torch_geometric_tactile.live._viewer.page import pack_message


def test_page_forbids_everything_that_is_not_in_it(viewer):
    response, body = ask(viewer)
    assert response.status == 200
    assert response.getheader("Content-Type") == "text/html; charset=utf-8"
    policy = dict(
        rule.strip().split(" ", 1)
        for rule in response.getheader("Content-Security-Policy").split(";")
    )
    assert policy["default-src"] == "'none'"
    assert policy["frame-ancestors"] == "'none'"
    assert policy["connect-src"] == f"'self' {viewer.url.replace('http', 'ws')[:-1]}"
    for kind in ("script-src", "style-src"):
        assert policy[kind].startswith("'sha256-")
        assert "unsafe" not in policy[kind]
    assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")
    assert b"https://" not in body
    assert response.getheader("X-Frame-Options") == "DENY"
    assert response.getheader("Cache-Control") == "no-store"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "127.0.0.1.evil.example:{port}",
        "localhost.evil.example",
        "192.0.2.1:{port}",
        "localhost@evil.example",
        "[::1",
        "",
    ],
)
@pytest.mark.parametrize("path", ["/", "/live", "/other"])
def test_foreign_host_is_refused(viewer, host, path):
    name = host.format(port=viewer.url[:-1].rpartition(":")[2])
    response, body = ask(viewer, path, [("Host", name)])
    assert response.status == 403
    assert b"<html" not in body


def test_no_host_or_two_are_refused(viewer):
    assert ask(viewer, headers=[("Accept", "*/*")])[0].status == 403
    own = viewer.url[7:-1]
    assert ask(viewer, headers=[("Host", own), ("Host", "evil.example")])[0].status == 403


@pytest.mark.parametrize("host", ["localhost", "localhost:9", "LOCALHOST:8000", "127.0.0.1:1234"])
def test_names_of_this_machine_are_taken_with_any_port(viewer, host):
    assert ask(viewer, headers=[("Host", host)])[0].status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:3000"])
def test_foreign_origin_is_refused(viewer, origin):
    own = viewer.url[7:-1]
    assert ask(viewer, headers=[("Host", own), ("Origin", origin)])[0].status == 403
    with pytest.raises(InvalidStatus) as refused:
        Page(viewer, origin=origin)
    assert refused.value.response.status_code == 403


def test_own_origin_is_taken(viewer):
    with Page(viewer, origin=viewer.url[:-1]) as page:
        assert page.next("layout")[0]["form"] == "numbers"


def test_other_paths_are_not_found(viewer):
    assert ask(viewer, "/secret")[0].status == 404
    assert ask(viewer, "/?x=1")[0].status == 200


def test_too_many_pages(viewer):
    pages = [Page(viewer) for _ in range(8)]
    for page in pages:
        page.next()
    with pytest.raises(InvalidStatus) as refused:
        Page(viewer)
    assert refused.value.response.status_code == 503
    pages[0].socket.close()
    wait(lambda: viewer.clients < 8)
    with Page(viewer) as page:
        page.next()
    for page in pages:
        page.socket.close()


def test_other_machines_only_with_a_warning(stream, caplog):
    with Viewer(stream, host="0.0.0.0") as viewer:
        assert ask(viewer)[0].status == 200
        assert "press its buttons" in caplog.text
        assert ask(viewer, headers=[("Host", "robot.example")])[0].status == 403


def test_arrays_come_back_and_begin_at_a_multiple_of_four():
    sent = {"tactile": np.array([[1, np.nan, -2.5]]), "pose": np.arange(24).reshape(2, 12)}
    for kind in ("a", "ab", "abc", "abcd", "ä"):
        message = pack_message({"kind": kind}, sent)
        head, arrays = unpack(message)
        assert head["kind"] == kind
        assert struct.unpack_from("<I", message)[0] % 4 == 0
        np.testing.assert_array_equal(arrays["tactile"], sent["tactile"])
        np.testing.assert_array_equal(arrays["pose"], sent["pose"])


def test_numbers_that_browsers_do_not_parse_are_null():
    head, _ = unpack(
        pack_message(
            {
                "age": float("nan"),
                "health": {"rate": np.float32("inf"), "lost": np.int64(3)},
                "all": [1.5, (-np.inf,)],
            }
        )
    )
    assert head["age"] is None
    assert head["health"] == {"rate": None, "lost": 3}
    assert head["all"] == [1.5, [None]]
