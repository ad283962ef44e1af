import json

import pytest

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.live._serial_port import SerialPort


@pytest.fixture
def ports(monkeypatch):
    ports = [SerialPort("/dev/ttyACM0", "Leonardo\x1b[2J", 0x2341, 0x8036, "75")]
    monkeypatch.setattr(
        "torch_geometric_tactile.live._serial_port.list_ports", lambda: ports, raising=False
    )
    return ports


def test_ports_are_listed_one_a_line(ports, capsys):
    assert main(["ports"]) == 0
    assert capsys.readouterr().out == "/dev/ttyACM0  2341:8036  75  Leonardo\\x1b[2J\n"


def test_ports_as_json(ports, capsys):
    assert main(["ports", "--json"]) == 0
    (port,) = json.loads(capsys.readouterr().out)
    assert port["vid"] == 0x2341
    assert port["device"] == "/dev/ttyACM0"


def test_no_ports(ports, capsys):
    ports.clear()
    assert main(["ports"]) == 0
    assert capsys.readouterr().out == "no serial ports found\n"
    assert main(["ports", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []
