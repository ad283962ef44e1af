import json
import os
from pathlib import Path

import numpy as np
import pytest
from xela_server import message, sensor

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._xela_messages import read_xela_messages, write_xela_messages

# Taxels of each sensor, first reading in counts, and whether there are forces.
REAL = {
    "XR23AHLCPP.json": ([368], [32845, 33398, 36714], False),
    "XR23AHRCPP.json": ([368], [32854, 32876, 35900], False),
    "uSPa35.json": ([15, 15], [33683, 33237, 36980], False),
    "uSPa46.json": ([24, 24], [33061, 33202, 37560], True),
    "uSPr2F.json": ([24, 24], [33061, 33202, 37560], True),
    "uSPrDS.json": ([30, 30], [33270, 33172, 36217], False),
    "uSPrHE35.json": ([15, 15], [33683, 33237, 36980], False),
}


@pytest.fixture(scope="module")
def real():
    shared = Path(__file__).resolve().parents[3] / "shared" / "data"
    # The variable may name the folder of another data set.
    roots = [Path(os.environ.get("TACTILE_TEST_DATA") or shared), shared]
    folders = [root / "xela" / "ws_messages" for root in roots]
    folder = next((folder for folder in folders if folder.is_dir()), folders[0])
    missing = [name for name in REAL if not (folder / name).is_file()]
    if missing:
        pytest.skip(
            f"'{missing[0]}' of XELA's server is not in '{folder}'; set TACTILE_TEST_DATA to the "
            "folder that has 'xela/ws_messages'"
        )
    return folder


@pytest.fixture
def write(tmp_path):
    """Writes texts and messages as a file, one after another, and returns its path."""

    def write(*parts, indent=None):
        parts = [p if isinstance(p, str) else json.dumps(p, indent=indent) + "\n" for p in parts]
        (tmp_path / "xela.json").write_bytes("".join(parts).encode())
        return tmp_path / "xela.json"

    return write


LOG = "[2026-01-14T13:40:06.957662] [JSON]\n"


@pytest.mark.parametrize("indent", [None, 1])
@pytest.mark.parametrize(
    "parts",
    [
        [message(1), message(2)],
        [LOG, message(1), LOG, "\n", message(2), "bye\n"],
        [{"message": "Welcome"}, message(1), message(2)],
        ["\ufeff", LOG[:-1], message(1), message(2)],
        ["[", message(1), ",", message(2), "]"],
    ],
)
def test_read_files_of_every_form(write, parts, indent):
    rec = read_xela_messages(write(*parts, indent=indent))
    assert rec.time.tolist() == [0.1, 0.2]
    assert rec.tactile[1, 0].tolist() == [32854, 32876, 35900]
    assert rec.meta == {
        "sensor": "XELA uSkin",
        "unit": "count",
        "models": ["uSPa22"],
        "taxels": [2],
        "handedness": ["right"],
        "handedness_reliable": False,
        "server_version": "1.8.0",
        "repeated_messages": 0,
        "skipped_messages": 0,
    }


def test_read_drops_and_counts_repeated_numbers(write):
    rec = read_xela_messages(write(*(message(i) for i in (1, 1, 1, 2, 2, 4))))
    assert rec.time.tolist() == [0.1, 0.2, 0.4]
    assert rec.meta["repeated_messages"] == 3


def test_read_counts_messages_whose_number_is_a_text(write):
    rec = read_xela_messages(
        write({"message": "Welcome"}, message(1), message(2, message="2"), message(3))
    )
    assert rec.time.tolist() == [0.1, 0.3]
    assert rec.meta["skipped_messages"] == 1


def test_read_forces(write):
    rec = read_xela_messages(write(message(1)), forces=True)
    assert rec.meta["unit"] == "newton"
    assert rec.tactile[0, 0].tolist() == [0.5, -0.25, 1]


@pytest.mark.parametrize(
    ("parts", "message_"),
    [
        ([""], r"xela.json' must hold at least one XELA message \(got none\)"),
        ([LOG, message(1, sensors=2)], r"xela.json', line 2: XELA message 1 must hold 2 sensors"),
        ([LOG, LOG, '{"a": 1}\n'], r"xela.json', line 3: 'message' of a XELA message must be"),
        ([LOG, '{"message": 1,,}'], r"line 2: the message that begins here cannot be read as JSON"),
        (
            [message(1), message(2, **{"1": {"data": "1,2,3", "model": "uSPa22"}})],
            r"line 2: message 2 must have sensors of \[2\] taxels, as in .* \(got \[1\]\)",
        ),
        (
            [message(2), message(1)],
            r"line 2: 'time' must increase \(got 0.1 s in message 1 after 0.2 s in message 2\)",
        ),
        (
            [message(1), message(2, **{"1": sensor(model="uSPa46")})],
            r"line 2: message 2 must have sensors \['1'\] of models \['uSPa22'\], as in .* "
            r"\(got \['1'\] of models \['uSPa46'\]\)",
        ),
        (
            [message(1), message(2, **{"1": ..., "2": sensor()})],
            r"line 2: message 2 must have sensors \['1'\] .*\(got \['2'\] of models",
        ),
        (
            ['{"message": 1, "time": 0, "1": {"data": "1,2,3", "data": "4,5,6"}}'],
            r"line 1: the message .* JSON \(an object .* once \(got 'data' twice",
        ),
        (['{"message": 1, "time": %s}' % ("9" * 5000)], r"line 1: the message that begins here"),
        (
            ['{"message": 1, "time": 1768398006957}'],
            r"'time' of XELA message 1 must be a number of",
        ),
        (['{"message": %s, "time": 0}' % ("9" * 400)], r"'message' .* must be an integer \(got 99"),
        ([message(1, **{"\u0661": sensor(), "sensors": 2})], r"must hold 2 sensors \(got \['1'\]"),
        (
            [message(1), json.dumps(message(2))[1:40]],
            r"line 2: the end of a message must follow its beginning",
        ),
        (['{"a":' * 100_000], r"line 1: the message that begins here cannot be read as JSON"),
    ],
)
def test_read_refuses(write, parts, message_):
    with pytest.raises(ValueError, match=message_):
        read_xela_messages(write(*parts))


@pytest.mark.parametrize("indent", [None, 1])
def test_read_file_cut_in_the_middle(write, indent):
    path = write(message(1), message(2), indent=indent)
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    with pytest.raises(ValueError, match=r"cannot be read as JSON .*: is the file truncated\?"):
        read_xela_messages(path)


def test_read_no_text(tmp_path):
    (tmp_path / "a.json").write_bytes(b"\xff\xfe{")
    with pytest.raises(ValueError, match=r"a.json' cannot be read as text"):
        read_xela_messages(tmp_path / "a.json")


@pytest.mark.parametrize("name", REAL)
def test_read_real_messages(real, name):
    taxels, first, calibrated = REAL[name]
    rec = read_xela_messages(real / name)
    assert rec.tactile.shape == (1, sum(taxels), 3)
    assert rec.meta["taxels"] == taxels
    assert rec.tactile[0, 0].tolist() == first
    # At rest: about 32768 counts of shear and 36500 of pressure.
    assert np.abs(np.median(rec.tactile[0], axis=0) - [32768, 32768, 36500]).max() < 1000
    assert rec.meta["server_version"].startswith("1.8.0b")
    if calibrated:
        forces = read_xela_messages(real / name, forces=True)
        assert np.abs(forces.tactile).max() < 0.1
        assert forces.tactile[0, 0].tolist() == np.float32([-0.00066, 0.00026, -0.00095]).tolist()
    else:
        with pytest.raises(ValueError, match=r"must have 'calibrated' for forces"):
            read_xela_messages(real / name, forces=True)


def counts(num_frames=6, num_taxels=5, **kwargs):
    tactile = np.random.default_rng(0).integers(0, 65536, (num_frames, num_taxels, 3))
    return Recording(1.78e9 + np.arange(num_frames) / 70, tactile, **kwargs)


def test_round_trip_gives_equal_counts_forces_and_metadata(assert_same, tmp_path):
    meta = {
        "sensor": "XELA uSkin",
        "unit": "count",
        "models": ["a", "b"],
        "taxels": [1, 4],
        "handedness": ["left", ""],
        "handedness_reliable": False,
        "server_version": "1.9",
        "repeated_messages": 0,
        "skipped_messages": 0,
    }
    rec = counts(meta=meta)
    tactile = np.random.default_rng(1).normal(size=rec.tactile.shape).astype(np.float32)
    tactile[2, 3] = np.nan
    forces = Recording(rec.time, tactile, meta={**meta, "unit": "newton"})
    write_xela_messages(rec, tmp_path / "a.jsonl", forces=forces, first_number=100)
    assert_same(read_xela_messages(tmp_path / "a.jsonl"), rec)
    assert_same(read_xela_messages(tmp_path / "a.jsonl", forces=True), forces)
    lines = (tmp_path / "a.jsonl").read_text().splitlines()
    assert [json.loads(line)["message"] for line in lines] == list(range(100, 106))


def test_write_says_what_is_lost(caplog, tmp_path):
    more = {"meta": {"object": "mug"}, "extra": {"pac": np.zeros((6, 22))}}
    rec = counts(label="cup", joint=np.zeros((6, 1)), action=np.zeros((6, 1)), **more)
    write_xela_messages(rec, tmp_path / "a.jsonl")
    assert (
        "a.jsonl' is a file of XELA messages and cannot store action, joint, label, object, pac"
        in caplog.text
    )
    caplog.clear()
    write_xela_messages(read_xela_messages(tmp_path / "a.jsonl"), tmp_path / "b.jsonl")
    assert not caplog.text


@pytest.mark.parametrize(
    ("rec", "message_"),
    [
        (
            Recording([], np.zeros((0, 1, 3))),
            r"at least one frame to be written as XELA messages \(got none",
        ),
        (counts(meta={"unit": "newton"}), r"must hold counts .*3 channels, unit 'newton'"),
        (Recording([0.0], np.zeros((1, 1, 1))), r"must hold counts of 3 channels .*got 1 channels"),
        (
            Recording([0.0], [[[1, np.nan, 1]]]),
            r"frame 0 cannot be written as a XELA message: .*got nan in",
        ),
        (counts(meta={"taxels": [4]}), r"frame 0 cannot be .*'taxels' must add up to 5"),
    ],
)
def test_write_refuses(rec, message_, tmp_path):
    with pytest.raises(ValueError, match=message_):
        write_xela_messages(rec, tmp_path / "a.jsonl")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [{"meta": {}}, {"time": np.arange(6) / 7}, {"tactile": np.zeros((6, 4, 3))}],
    ids=["unit", "time", "taxels"],
)
def test_write_refuses_forces_of_other_frames(change, tmp_path):
    rec = counts()
    same = {"time": rec.time, "tactile": rec.tactile, "meta": {"unit": "newton"}}
    write_xela_messages(rec, tmp_path / "a.jsonl", forces=Recording(**same))
    with pytest.raises(ValueError, match=r"'forces' must hold the same frames in newtons \(got"):
        write_xela_messages(rec, tmp_path / "b.jsonl", forces=Recording(**(same | change)))
    assert not (tmp_path / "b.jsonl").exists()
