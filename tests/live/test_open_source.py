import os

import numpy as np
import pytest

from torch_geometric_tactile.live import ReplaySource, open_source


def test_magnetic_skin_has_its_unit_and_layout():
    source = open_source("serial:/dev/ttyX?protocol=anyskin")
    assert source.meta == {"unit": "microtesla", "sensor": "anyskin"}
    source = open_source("serial:/dev/ttyX?protocol=anyskin&num_magnetometers=3")
    assert source.meta == {"unit": "microtesla"}
    assert open_source("serial:/dev/ttyX?protocol=flexitac&shape=2x3").decoder.shape == (2, 3)


def test_open_source_of_files(tmp_path):
    source = open_source("file:some/grasp.h5?speed=2.5&loop=1")
    assert isinstance(source, ReplaySource)
    assert (source.path, source.speed, source.loop) == ("some/grasp.h5", 2.5, True)
    assert open_source("some/grasp.h5").path == "some/grasp.h5"
    assert open_source("grasp.h5?loop=no&speed=0").waits
    odd = tmp_path / "what?speed=2.npz"
    odd.touch()
    assert open_source(str(odd)).path == str(odd)
    assert open_source(odd, speed=3).speed == 3


def test_link_to_a_device_is_told_to_be_a_port(tmp_path):
    link = tmp_path / "by-id"
    link.symlink_to(os.devnull)
    for url in (str(link), f"{link}?protocol=cobs", f"file:{link}"):
        with pytest.raises(ValueError, match=r'must be given as "serial:.*by-id\?protocol=NAME"'):
            open_source(url)


def test_open_source_of_a_port():
    source = open_source("serial:/dev/ttyACM0?protocol=text&shape=12x32&baudrate=9600")
    assert (source.port, source.baudrate, source.decoder.shape) == ("/dev/ttyACM0", 9600, (12, 32))
    assert open_source("serial:COM3", protocol="anyskin").port == "COM3"


def test_port_without_a_protocol_expects_lines_of_numbers():
    source = open_source("serial:/dev/ttyACM0?time=us&num_taxels=46&baudrate=9600")
    assert (source.decoder.time, source.decoder.num_taxels, source.baudrate) == ("us", 46, 9600)
    assert source.clock_period == 2**32 / 1e6


def test_settings_go_before_those_of_the_url():
    assert open_source("file:grasp.h5?speed=2", speed=8).speed == 8


def test_open_source_of_a_server():
    pytest.importorskip("websockets", reason="needs the extra 'live'")
    source = open_source("ws://10.0.0.5:5000?forces=yes")
    assert (source.name, source.forces) == ("ws://10.0.0.5:5000", True)


def test_open_source_of_a_simulation():
    pytest.importorskip("mujoco", reason="needs the extra 'sim'")
    source = open_source("sim:?object=sponge&seed=3")
    assert repr(source) == "SimulatedSource('sim:?object=sponge')"


@pytest.mark.parametrize(
    ("url", "match"),
    [
        ("", 'a source must be one of "serial:'),
        ("/dev/ttyUSB0", r'given as "serial:/dev/ttyUSB0\?protocol=NAME"'),
        ("COM3", r'given as "serial:COM3\?protocol=NAME"'),
        (None, 'a source must be one of "serial:'),
        ("usb:/dev/x", r'a source must be one of "serial:.*, ws:.*, "file:.*, .* or "sim:'),
        (
            "serial:/dev/x?shape=2x3",
            "a setting of protocol 'lines' must be one of time, num_taxels",
        ),
        ("serial:/dev/x?baud=9600", r"or 'baudrate' of the port \(got 'baud'\)"),
        ("serial:/dev/x?time=min", r"'time' must be one of none, s, ms, us \(got 'min'\)"),
        ("serial:/dev/x?protocol=tcp", "'protocol' must be one of cobs"),
        ("serial:/dev/x?protocol=cobs&baudrate=fast", "'baudrate' must be an integer"),
        ("serial:/dev/x?protocol=cobs&parity=odd", "a setting of protocol 'cobs' must be one of"),
        ("serial:?protocol=anyskin", "'port' must be the path or name"),
        ("file:", "a file source must name the file"),
        (
            "file:x.h5?spede=2",
            r"an option of file: must be one of \['speed', 'rate', 'loop', .* \(got 'spe",
        ),
        ("file:x.h5?speed=fast", r"'speed' must be a number \(got 'fast'\)"),
        ("file:x.h5?speed=-1", "'speed' must be 0 or more"),
        ("file:x.h5?loop=maybe", r"'loop' must be 1 or 0 \(got 'maybe'\)"),
        ("file:x.h5?speed=1&speed=2", "option 'speed' must be given once"),
        ("sim:sponge", "a simulated source must be sim: or"),
        ("sim:?object=cup", r"'only' must be one of \['plastic_tube', 'sponge'"),
        ("sim:?seed=one", "'seed' must be an integer"),
        ("sim:?seed=-1", "'seed' must not be negative"),
        ("sim:?rate=0", "'rate' must be above 0"),
        ("sim:?motion=throw", "'motion' must be one of"),
        ("sim:?objects=some", "'objects' must be one of"),
    ],
)
def test_wrong_source_raises(url, match):
    if str(url).startswith("sim:"):
        pytest.importorskip("mujoco", reason="needs the extra 'sim'")
    with pytest.raises(ValueError, match=match):
        open_source(url)


def test_file_source_reads_csv_with_options(tmp_path):
    path = tmp_path / "glove.csv"
    path.write_text("Glove 7\ntime;thumb;index;bend\n0;1,5;NA;3\n0,01;2;3;4\n")
    options = "preamble=1&decimal=%2C&missing=NA,-1&joint=bend&loop=0"
    with open_source(f"file:{path}?speed=0&{options}") as source:
        frames = source.read(timeout=5.0)
    np.testing.assert_array_equal(frames[0].tactile, [[1.5], [np.nan]])
    assert [frame.joint.tolist() for frame in frames] == [[3.0], [4.0]]
