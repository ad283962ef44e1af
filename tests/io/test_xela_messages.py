import json
import os
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import (
    XelaFrame,
    format_xela_message,
    parse_xela_message,
    read_xela_messages,
    write_xela_messages,
)

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


def sensor(**changed):
    return {
        "data": "8056,806C,8C3C,7E75,8013,8D36",
        "model": "uSPa22",
        "taxels": 2,
        "integer": [32854, 32876, 35900, 32373, 32787, 36150],
        "calibrated": [0.5, -0.25, 1.0, None, 0.0, 2.0],
        "handedness": "right",
        **changed,
    }


def message(number=7, **changed):
    content = {
        "message": number,
        "time": number / 10,
        "sensors": 1,
        "type": "routine",
        "version": "1.8.0",
        "1": sensor(),
        "sendtime": number / 10 + 0.01,
        **changed,
    }
    return {key: value for key, value in content.items() if value is not ...}


@pytest.fixture
def write(tmp_path):
    """Writes texts and messages as a file, one after another, and returns its path."""

    def write(*parts, indent=None):
        parts = [p if isinstance(p, str) else json.dumps(p, indent=indent) + "\n" for p in parts]
        (tmp_path / "xela.json").write_bytes("".join(parts).encode())
        return tmp_path / "xela.json"

    return write


def test_parse_by_hand():
    frame = parse_xela_message(message())
    assert isinstance(frame, XelaFrame)
    assert frame.reading.tolist() == [[0x8056, 0x806C, 0x8C3C], [0x7E75, 0x8013, 0x8D36]]
    assert frame.reading.dtype == np.float32
    assert frame._replace(reading=None) == (
        XelaFrame(7, 0.7, None, (2,), ("uSPa22",), ("right",), "1.8.0")
    )


def test_parse_forces_with_a_missing_one():
    reading = parse_xela_message(message(), forces=True).reading
    assert np.array_equal(reading, np.float32([[0.5, -0.25, 1], [np.nan, 0, 2]]), equal_nan=True)


def test_parse_sensors_in_numeric_order():
    parts = {
        str(i): sensor(data=f"{i:X},0,0", taxels=1, integer=..., model=f"m{i}") for i in (10, 9, 1)
    }
    for part in parts.values():
        del part["integer"]
    frame = parse_xela_message(message(**{**parts, "sensors": 3}))
    assert frame.reading[:, 0].tolist() == [1, 9, 10]
    assert frame.models == ("m1", "m9", "m10")


@pytest.mark.parametrize(
    "data",
    [
        "8056,\n806C,\n8C3C,\n7E75,\n8013,\n8D36",
        " 8056, 806c , 8C3C\t7E75 8013,8D36,\r\n",
    ],
)
def test_parse_line_breaks_and_spaces_between_words(data):
    frame = parse_xela_message(message(**{"1": sensor(data=data)}))
    assert frame.reading.ravel().tolist() == sensor()["integer"]


def test_parse_takes_what_may_be_left_out():
    frame = parse_xela_message({"message": 1, "sendtime": 2.5, "1": {"data": "1,2,3"}})
    assert frame.time == 2.5
    assert (frame.models, frame.handedness, frame.version) == (("",), ("",), "")
    two = parse_xela_message({"message": 1, "sendtime": 2.5, "1": {"data": "1,2,3,4,5,6"}})
    assert two.taxels == (2,)
    assert two.reading.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("changed", "message_"),
    [
        ({"message": "Welcome"}, r"'message' of a XELA message must be an integer \(got 'Welcome'"),
        ({"message": True}, r"must be an integer \(got True\)"),
        ({"message": ...}, r"must be an integer \(got None\)"),
        ({"time": "now"}, r"'time' of XELA message 7 must be a number of seconds \(got 'now'\)"),
        ({"time": ..., "sendtime": ...}, r"'time' of XELA message 7 must .*\(got None\)"),
        ({"time": float("nan")}, r"'time' of XELA message 7 must .*\(got nan\)"),
        ({"sensors": 2}, r"XELA message 7 must hold 2 sensors \(got \['1'\]\)"),
        ({"sensors": ..., "1": ...}, r"XELA message 7 must hold 1 sensors \(got none\)"),
        ({"1": 3}, r"sensor '1' of XELA message 7 must be a JSON object \(got 3\)"),
        ({"1": {}}, r"'data' of sensor '1' of XELA message 7 must be a text .*\(got None\)"),
        ({"1": {"data": "8056,8O6C"}}, r"words of up to four digits \(got '8O6C'\)"),
        ({"1": {"data": "18056,1,2"}}, r"words of up to four digits \(got '18056'\)"),
        ({"1": {"data": "1,2,3,4"}}, r"must hold 3 words for each of 1 taxels \(got 4\)"),
        ({"1": {"data": ""}}, r"must hold 3 words for each of 1 taxels \(got 0\)"),
        ({"1": sensor(model={"a": 1})}, r"'model' of XELA message 7 must be a text \(got {'a': 1}"),
        ({"1": sensor(handedness=1)}, r"'handedness' of XELA message 7 must be a text \(got 1\)"),
        ({"version": 1.8}, r"'version' of XELA message 7 must be a text \(got 1.8\)"),
        ({"1": sensor(taxels=3)}, r"must hold 3 words for each of 3 taxels \(got 6\)"),
        ({"1": sensor(taxels=None)}, r"'taxels' of sensor '1' .* positive integer \(got None\)"),
        ({"1": sensor(integer=[1])}, r"'integer' of sensor '1' .* must say the same as 'data'"),
    ],
)
def test_parse_refuses(changed, message_):
    with pytest.raises(ValueError, match=message_):
        parse_xela_message(message(**changed))


@pytest.mark.parametrize(
    ("part", "message_"),
    [
        (sensor(calibrated=[1.0]), r"'calibrated' of sensor '1' .* shape \(6,\) \(got \(1,\)\)"),
        (sensor(calibrated=["a"] * 6), r"'calibrated' of sensor '1' .* must hold numbers"),
        (sensor(calibrated=["1"] * 6), r"'calibrated' of sensor '1' .* must hold numbers or null"),
        (sensor(calibrated=[1e39] * 6), r"'calibrated' of sensor '1' .* must hold finite numbers"),
        (sensor(calibrated=[10**400] * 6), r"'calibrated' of sensor '1' .* must hold numbers \("),
        (sensor(calibrated=3), r"'calibrated' of sensor '1' .* must hold numbers or null \(got 3"),
        ({"data": "1,2,3", "model": "USPA35"}, r"model 'USPA35', must have 'calibrated' .*counts"),
    ],
)
def test_parse_forces_refuses(part, message_):
    parse_xela_message(message(**{"1": part}))
    with pytest.raises(ValueError, match=message_):
        parse_xela_message(message(**{"1": part}), forces=True)


def test_parse_refuses_what_is_no_object():
    with pytest.raises(ValueError, match=r"must be a JSON object \(got list\)"):
        parse_xela_message([])


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
        ([{"message": "Welcome"}], r"xela.json' must hold at least one XELA message"),
        (["time,x\n0,1\n"], r"xela.json' must hold at least one XELA message"),
        ([LOG, message(1, sensors=2)], r"xela.json', line 2: XELA message 1 must hold 2 sensors"),
        ([LOG, LOG, '{"a": 1}\n'], r"xela.json', line 3: 'message' of a XELA message must be"),
        ([LOG, '{"message": 1,,}'], r"line 2: the message that begins here cannot be read as JSON"),
        (
            [message(1), message(2, **{"1": {"data": "1,2,3", "model": "uSPa22"}})],
            r"line 2: message 2 must have sensors of \[2\] taxels, as those before \(got \[1\]\)",
        ),
        (
            [message(2), message(1)],
            r"line 2: 'time' must increase \(got 0.1 s in message 1 after 0.2 s in message 2\)",
        ),
        (
            [message(1), message(2, **{"1": sensor(model="uSPa46")})],
            r"line 2: message 2 must have sensors \['1'\] of models \['uSPa22'\], as those before "
            r"\(got \['1'\] of models \['uSPa46'\]\)",
        ),
        (
            [message(1), message(2, **{"1": ..., "2": sensor()})],
            r"line 2: message 2 must have sensors \['1'\] .*\(got \['2'\] of models",
        ),
        (
            ['{"message": 1, "time": 0, "1": {"data": "1,2,3", "data": "4,5,6"}}'],
            r"line 1: the message .* JSON \(the key 'data' is there twice\)",
        ),
        (['{"message": 1, "time": %s}' % ("9" * 5000)], r"line 1: the message that begins here"),
        (['{"message": 1, "time": %s}' % ("9" * 400)], r"'time' of XELA message 1 must be a numb"),
        (
            ['{"message": 1, "time": 1768398006957}'],
            r"'time' of XELA message 1 must be a number of",
        ),
        (['{"message": %s, "time": 0}' % ("9" * 400)], r"'message' .* must be an integer \(got 99"),
        ([message(1, **{"\u0661": sensor(), "sensors": 2})], r"must hold 2 sensors \(got \['1'\]"),
        (['"x": 3}}\n', message(1)], r"line 1: the end of a message must have its beginning"),
        (
            [message(1), json.dumps(message(2))[1:40]],
            r"line 2: the end of a message must have its beginning",
        ),
        ([message(1), "}\n", message(2)], r"line 2: the end of a message must have its beginning"),
        (['{"a":' * 100_000], r"line 1: the message that begins here cannot be read as JSON"),
    ],
)
def test_read_refuses(write, parts, message_):
    with pytest.raises(ValueError, match=message_):
        read_xela_messages(write(*parts))


@pytest.mark.parametrize("share", [0.55, 0.7, 0.95])
@pytest.mark.parametrize("indent", [None, 1])
def test_read_file_cut_in_the_middle(write, share, indent):
    path = write(message(1), message(2), indent=indent)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"cannot be read as JSON .*: is the file cut\?"):
        read_xela_messages(path)


def test_read_missing_file_and_no_text(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone.json' does not exist"):
        read_xela_messages(tmp_path / "gone.json")
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


def test_format_by_hand():
    counts = np.array([[1, 2, 3], [0x8000, 0xABCD, 0xFFFF], [0, 0, 0]])
    forces = np.array([[0.5, np.nan, 1.0], [0, 0, 0], [0, 0, 0]])
    made = format_xela_message(
        counts, 5, 2.5, taxels=[2, 1], models=["a", "b"], forces=forces, version="v"
    )
    assert made == {
        "message": 5,
        "time": 2.5,
        "sensors": 2,
        "type": "routine",
        "version": "v",
        "1": {
            "time": 2.5,
            "sensor": "1",
            "data": "0001,0002,0003,8000,ABCD,FFFF",
            "model": "a",
            "taxels": 2,
            "integer": [1, 2, 3, 0x8000, 0xABCD, 0xFFFF],
            "handedness": "right",
            "calibrated": [0.5, None, 1.0, 0.0, 0.0, 0.0],
        },
        "2": {
            "time": 2.5,
            "sensor": "2",
            "data": "0000,0000,0000",
            "model": "b",
            "taxels": 1,
            "integer": [0, 0, 0],
            "handedness": "right",
            "calibrated": [0.0, 0.0, 0.0],
        },
        "sendtime": 2.5,
    }


@pytest.mark.parametrize(
    ("arguments", "message_"),
    [
        ({"counts": np.zeros(3)}, r"'counts' must have shape \(num_taxels, 3\) \(got \(3,\)\)"),
        ({"counts": np.full((2, 3), 0.5)}, r"whole numbers .*\(got 0.5 in taxel 0, axis x\)"),
        ({"counts": np.full((2, 3), 65536)}, r"from 0 to 65535 \(got 65536 in taxel 0"),
        ({"counts": np.full((2, 3), -1)}, r"\(got -1 in taxel 0, axis x\)"),
        ({"counts": np.full((2, 3), np.nan)}, r"\(got nan .*cannot leave a taxel out"),
        ({"forces": np.zeros((1, 3))}, r"'forces' must have shape \(2, 3\) \(got \(1, 3\)\)"),
        ({"taxels": [1]}, r"'taxels' must add up to 2 \(got \[1\]\)"),
        ({"taxels": [2, 0]}, r"'taxels' must add up to 2 \(got \[2, 0\]\)"),
        ({"models": ["a", "b"]}, r"'models' must have 1 entries \(got 2\)"),
    ],
)
def test_format_refuses(arguments, message_):
    with pytest.raises(ValueError, match=message_):
        format_xela_message(**{"counts": np.zeros((2, 3)), "number": 1, "time": 0.0, **arguments})


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
    rec = counts(label="cup", joint=np.zeros((6, 1)), **more)
    write_xela_messages(rec, tmp_path / "a.jsonl")
    assert "a.jsonl' is XELA messages and cannot hold joint, label, object, pac" in caplog.text
    caplog.clear()
    write_xela_messages(read_xela_messages(tmp_path / "a.jsonl"), tmp_path / "b.jsonl")
    assert not caplog.text


@pytest.mark.parametrize(
    ("rec", "message_"),
    [
        (Recording([], np.zeros((0, 1, 3))), r"at least one frame to be XELA messages \(got none"),
        (counts(meta={"unit": "newton"}), r"must hold counts .*3 channels, unit 'newton'"),
        (Recording([0.0], np.zeros((1, 1, 1))), r"must hold counts of 3 channels .*got 1 channels"),
        (Recording([0.0], [[[1, np.nan, 1]]]), r"frame 0 cannot be a XELA message: .*got nan in"),
        (counts(meta={"taxels": [4]}), r"frame 0 cannot be .*'taxels' must add up to 5"),
    ],
)
def test_write_refuses(rec, message_, tmp_path):
    with pytest.raises(ValueError, match=message_):
        write_xela_messages(rec, tmp_path / "a.jsonl")
    assert list(tmp_path.iterdir()) == []


def test_write_refuses_forces_of_other_frames(tmp_path):
    with pytest.raises(ValueError, match=r"'forces' must hold the same frames in newtons \(got"):
        write_xela_messages(counts(), tmp_path / "a.jsonl", forces=counts())
