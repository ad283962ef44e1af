import io
import logging

import pytest

from torch_geometric_tactile.commands._status_line import StatusLine


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    return Terminal()


def warn(text):
    """As a logger without a handler does; those of pytest have one."""
    logging.lastResort.handle(logging.makeLogRecord({"levelno": logging.WARNING, "msg": text}))


def test_parts_that_do_not_fit_are_left_out_whole(terminal):
    with StatusLine(terminal) as line:
        line.show("51 still frames so far: keep still  100.0 Hz  lost 0")
        line.show("x" * 60)
    shown = terminal.getvalue().replace("\x1b[K", "").split("\r")
    assert shown == ["", "51 still frames so far: keep still", "x" * 39 + "\n"]


def test_warnings_have_their_own_line_while_it_is_open(terminal):
    usual = logging.lastResort
    with StatusLine(terminal) as line:
        line.show("100.0 Hz")
        warn("the disk is slow")
        line.show("99.0 Hz")
    assert logging.lastResort is usual
    assert terminal.getvalue() == ("\r100.0 Hz\x1b[K\r\x1b[Kthe disk is slow\n\r99.0 Hz\x1b[K\n")


def test_in_a_log_lines_are_rare_and_warnings_are_not():
    log = io.StringIO()
    with StatusLine(log) as line:
        line.show("100.0 Hz")
        warn("slow")
        line.show("99.0 Hz")
    assert log.getvalue() == "100.0 Hz\nslow\n"
