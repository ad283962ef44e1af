# ruff: noqa: E402
import json
import logging
import re
import struct
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest

for module in ("mcap", "google.protobuf", "zstandard", "lz4"):
    pytest.importorskip(module, reason="needs the extra 'live'")

import zstandard
from google.protobuf import descriptor_pb2
from io_messages import messages
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from torch_geometric_tactile.data import LiveFrame, Recording
from torch_geometric_tactile.io import (
    McapWriter,
    read_mcap,
    read_recording,
    write_mcap,
)
from torch_geometric_tactile.io import _mcap_schemas as mcap_schemas
from torch_geometric_tactile.io.recording_files import recording_format

ANCHOR = (1_700_000_000 * 10**9, 5 * 10**9)


def a_recording(**more):
    tactile = np.arange(24, dtype=np.float32).reshape(4, 2, 3)
    tactile[1, 0, 2] = np.nan
    return Recording(np.arange(4) / 100, tactile, **more)


def a_frame(i, **more):
    values = {"joint": None, "extra": {}, "device_time": None, "tactile": np.full((2, 3), i)}
    values |= more
    values["tactile"] = np.asarray(values["tactile"], dtype=np.float32)
    return LiveFrame(sequence=i, time=5 + i / 100, received=5 * 10**9 + i * 10**7, **values)


def write_frames(path, frames, **more):
    with McapWriter(path, anchor=ANCHOR, **more) as writer:
        for frame in frames:
            writer.write_frame(frame)
    return path


@pytest.mark.parametrize("start", [-5.0, 1.7e9, 1e12, 1e300])
def test_times_of_any_size_come_back(tmp_path, start, assert_same):
    time = start + np.arange(2) * max(1.0, abs(start) / 1e6)
    recording = Recording(time, np.zeros((2, 1, 1)), meta={"recorded_at": -1.0})
    write_mcap(recording, tmp_path / "a.mcap")
    assert_same(read_mcap(tmp_path / "a.mcap", recover=False), recording)


def test_format_is_known_by_its_beginning(tmp_path):
    write_mcap(a_recording(), tmp_path / "a.mcap")
    (tmp_path / "a.mcap").rename(tmp_path / "a.npz")
    assert recording_format(tmp_path / "a.npz") == "MCAP"
    assert read_recording(tmp_path / "a.npz").num_frames == 4


def test_others_read_all_topics(tmp_path):
    path = tmp_path / "a.mcap"
    with McapWriter(path, anchor=ANCHOR) as writer:
        writer.write_frame(
            a_frame(7, joint=np.array([0.5]), device_time=0.25, extra={"t": np.array([1, 2])})
        )
        writer.write_prediction(5.07, np.array([0.25, 0.75]), ("slip", "stable"), "stable")
        writer.write_health(5.08, {"state": "open", "rate": 99.5, "lost": 2, "age": 0.01})
        writer.write_event(5.09, "tare", "by key")
        writer.write_points(
            5.1, np.array([[1, 2, 3], [4, 5, 6]]), {"pressure": np.array([7, np.nan])}, "palm"
        )
    ((raw, frame),) = messages(path, "tactile.Frame")
    assert raw.log_time == raw.publish_time == ANCHOR[0] + 70_000_000
    assert (raw.sequence, frame.sequence, frame.time, frame.device_time) == (7, 7, 5.07, 0.25)
    assert list(frame.shape) == [2, 3]
    assert list(frame.tactile) == [7.0] * 6
    assert list(frame.joint) == [0.5]
    assert frame.extra[0].name == "t"
    ((_, said),) = messages(path, "tactile.Prediction")
    assert list(said.class_names) == ["slip", "stable"]
    assert list(said.probability) == [0.25, 0.75]
    assert said.label == "stable"
    ((_, health),) = messages(path, "tactile.Health")
    assert (health.state, health.rate, health.lost, health.age) == ("open", 99.5, 2, 0.01)
    ((_, event),) = messages(path, "tactile.Event")
    assert (event.kind, event.text) == ("tare", "by key")
    ((_, cloud),) = messages(path, "foxglove.PointCloud")
    assert cloud.timestamp.seconds == 1_700_000_000
    assert cloud.timestamp.nanos == 100_000_000
    assert (cloud.frame_id, cloud.point_stride, cloud.pose.orientation.w) == ("palm", 16, 1.0)
    assert [(f.name, f.offset, f.type) for f in cloud.fields] == [
        *(("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("pressure", 12, 7))
    ]
    points = np.frombuffer(cloud.data, "<f4").reshape(2, 4)
    assert np.array_equal(points, [[1, 2, 3, 7], [4, 5, 6, np.nan]], equal_nan=True)


def test_times_and_numbers_of_a_live_stream(tmp_path):
    frames = [a_frame(3, device_time=0.5), a_frame(5, device_time=0.75)]
    path = write_frames(tmp_path / "a.mcap", frames, layout="biotac", label="mug", meta={"a": 1})
    found = read_mcap(path)
    assert found.time == pytest.approx([0.03, 0.05], abs=1e-12)
    assert found.extra["sequence"].tolist() == [3, 5]
    assert found.extra["device_time"].tolist() == [0.5, 0.75]
    assert (found.label, found.meta) == ("mug", {"a": 1})
    with path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.metadata["layout"] == "biotac"
    assert json.loads(metadata.metadata["meta"]) == {"a": 1}


def test_what_some_frames_lack_is_missing(tmp_path, caplog):
    frames = [
        a_frame(0, extra={"temp": np.array([1.0]), "ups": np.array([4])}),
        a_frame(1, joint=np.array([0.5])),
        a_frame(2, extra={"temp": np.array([2.0]), "late": np.array([3.0])}),
    ]
    found = read_mcap(write_frames(tmp_path / "a.mcap", frames))
    assert np.array_equal(found.joint, [[np.nan], [0.5], [np.nan]], equal_nan=True)
    assert np.array_equal(found.extra["temp"], [[1], [np.nan], [2]], equal_nan=True)
    assert np.array_equal(found.extra["late"], [[np.nan], [np.nan], [3]], equal_nan=True)
    assert "ups" not in found.extra
    assert "left out extra/ups" in caplog.text


@pytest.mark.parametrize(
    ("frame", "why"),
    [
        (a_frame(2, tactile=np.zeros((3, 3))), "must have shape \\(2, 3\\)"),
        (a_frame(2, tactile=np.full((2, 3), np.inf)), "must hold finite readings"),
        (a_frame(2, joint=np.array([np.inf])), "must hold finite readings"),
    ],
    ids=["shape", "infinite", "joint"],
)
def test_frame_that_does_not_fit_is_left_out_and_told(tmp_path, caplog, frame, why):
    path = write_frames(tmp_path / "a.mcap", [a_frame(0), a_frame(1), frame, a_frame(3)])
    assert read_mcap(path).extra["sequence"].tolist() == [0, 1, 3]
    assert "a message is not a frame of this recording" in caplog.text
    with pytest.raises(ValueError, match=why):
        read_mcap(path, recover=False)


def test_frames_out_of_order_are_sorted_and_told(tmp_path, caplog):
    path = write_frames(tmp_path / "a.mcap", [a_frame(i) for i in (0, 2, 1, 2, 3)])
    assert read_mcap(path).extra["sequence"].tolist() == [0, 1, 2, 3]
    assert "4 of 5 were read" in caplog.text


def test_events_are_read_with_their_times(tmp_path):
    path = tmp_path / "a.mcap"
    with McapWriter(path, anchor=(10**18, 5 * 10**9)) as writer:
        writer.write_frame(a_frame(0))
        writer.write_event(6.5, "mark")
        writer.write_event(7.0, "tare", "by key")
        writer.write_event(float("nan"), "never")
    events = [
        {"time": 1.5, "kind": "mark", "text": ""},
        {"time": 2.0, "kind": "tare", "text": "by key"},
    ]
    assert read_mcap(path).meta["events"] == events
    write_mcap(read_mcap(path), tmp_path / "b.mcap")
    assert read_mcap(tmp_path / "b.mcap").meta["events"] == events
    assert "events" not in read_mcap(write_frames(tmp_path / "c.mcap", [a_frame(0)])).meta


def test_events_of_4096_bytes_are_read_and_longer_ones_left_out(tmp_path):
    path = tmp_path / "a.mcap"
    event = {"time": 6.5, "kind": "note", "text": "x" * 200}
    longest = 4096 - len(mcap_schemas.encode("tactile.Event", event)) + 200
    with McapWriter(path, anchor=ANCHOR) as writer:
        writer.write_frame(a_frame(0))
        for length in (longest, longest + 1):
            writer.write_event(6.5, "note", "x" * length)
    assert [len(event["text"]) for event in read_mcap(path).meta["events"]] == [longest]


def test_the_first_ten_thousand_events_are_read(tmp_path):
    with McapWriter(tmp_path / "a.mcap", anchor=ANCHOR) as writer:
        writer.write_frame(a_frame(0))
        for i in range(10_001):
            writer.write_event(6.0, str(i))
    kinds = [event["kind"] for event in read_mcap(tmp_path / "a.mcap").meta["events"]]
    assert kinds == [str(i) for i in range(10_000)]


def test_existing_file_is_kept_unless_asked(tmp_path):
    path = write_frames(tmp_path / "a.mcap", [a_frame(0)])
    with pytest.raises(FileExistsError, match="exists: choose another name"):
        McapWriter(path)
    assert read_mcap(path).num_frames == 1
    write_frames(path, [a_frame(0), a_frame(1)], overwrite=True)
    assert read_mcap(path, recover=False).num_frames == 2


def test_file_that_another_writer_has_open_is_not_replaced(tmp_path):
    pytest.importorskip("fcntl")
    with McapWriter(tmp_path / "a.mcap", anchor=ANCHOR) as writer:
        writer.write_frame(a_frame(0))
        with pytest.raises(BlockingIOError, match="locked by another process"):
            McapWriter(tmp_path / "a.mcap", overwrite=True)
    assert read_mcap(tmp_path / "a.mcap").num_frames == 1


def test_bad_arguments(tmp_path):
    with pytest.raises(ValueError, match="at least one frame"):
        write_mcap(a_recording().select(slice(0, 0)), tmp_path / "a.mcap")
    with pytest.raises(ValueError, match="'label' must be a text"):
        McapWriter(tmp_path / "a.mcap", label=1.5)
    with pytest.raises(ValueError, match="'unit' in 'meta'"):
        McapWriter(tmp_path / "a.mcap", meta={"unit": "kg"})
    assert [*tmp_path.iterdir()] == []
    with (
        McapWriter(tmp_path / "a.mcap") as writer,
        pytest.raises(ValueError, match="'t' must hold numbers or strings"),
    ):
        writer.write_frame(a_frame(0, extra={"t": np.array([object()])}))


def test_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[live\]'"):
        McapWriter(tmp_path / "a.mcap")
    assert [*tmp_path.iterdir()] == []


class Others:
    """A file that another program wrote."""

    def __init__(self, path, **settings):
        self.path = path
        self.file = path.open("wb")
        self.writer = Writer(self.file, **settings)
        self.writer.start()
        self.count = 0

    def channel(self, topic, schema="tactile.Frame", encoding="protobuf", data=None):
        data = mcap_schemas.message_schema("tactile.Frame") if data is None else data
        number = self.writer.register_schema(schema, encoding, data)
        return self.writer.register_channel(topic, encoding, number)

    def frame(self, channel, i):
        values = {"time": i / 10, "sequence": i, "shape": (1, 3), "tactile": [i, 0, 1]}
        self.message(channel, mcap_schemas.encode("tactile.Frame", values))

    def message(self, channel, data):
        self.count += 1
        self.writer.add_message(channel, self.count, data, self.count)

    def done(self):
        self.writer.finish()
        self.file.close()
        return self.path


@pytest.mark.parametrize(
    "settings",
    [
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"enable_crcs": False, "use_statistics": False, "use_summary_offsets": False},
    ],
    ids=["lz4", "none", "no chunks", "no checksums"],
)
@pytest.mark.parametrize("topic", ["tactile.Frame", "/left/skin"])
def test_files_of_others_are_read(tmp_path, settings, topic):
    others = Others(tmp_path / "a.mcap", **settings)
    camera = others.channel("/camera", "Image", "json", b"{}")
    skin = others.channel(topic)
    for i in range(3):
        others.message(camera, b"{}")
        others.frame(skin, i)
    found = read_mcap(others.done(), recover=False)
    assert found.time.tolist() == [0.0, 0.1, 0.2]
    assert found.tactile[:, 0].tolist() == [[0, 0, 1], [1, 0, 1], [2, 0, 1]]
    assert (found.label, found.meta, dict(found.extra)) == (None, {}, {})


def test_file_without_frames_lists_its_topics(tmp_path):
    others = Others(tmp_path / "a.mcap")
    others.message(others.channel("/camera", "Image", "json", b"{}"), b"{}")
    others.message(others.channel("/imu", "Imu", "json", b"{}"), b"{}")
    with pytest.raises(ValueError, match=r"topic 'tactile.Frame'.*got /camera, /imu"):
        read_mcap(others.done())


def test_frames_of_another_schema_are_refused(tmp_path):
    schema = descriptor_pb2.FileDescriptorSet.FromString(
        mcap_schemas.message_schema("tactile.Frame")
    )
    schema.file[1].message_type[0].field[5].number = 66
    others = Others(tmp_path / "a.mcap")
    others.frame(others.channel("tactile.Frame", data=schema.SerializeToString()), 1)
    with pytest.raises(ValueError, match=r"'tactile.Frame.tactile' must be float 6 \(got float 66"):
        read_mcap(others.done())
    others = Others(tmp_path / "b.mcap")
    others.frame(others.channel("tactile.Frame", data=b"\xff\xff"), 1)
    with pytest.raises(ValueError, match="it is not a protobuf schema"):
        read_mcap(others.done())


def test_newer_schema_with_more_fields_is_read(tmp_path):
    schema = descriptor_pb2.FileDescriptorSet.FromString(
        mcap_schemas.message_schema("tactile.Frame")
    )
    schema.file[1].message_type[0].field.add(name="more", number=99, type=5, label=1)
    others = Others(tmp_path / "a.mcap")
    channel = others.channel("tactile.Frame", data=schema.SerializeToString())
    values = {"time": 0.5, "shape": (1, 1), "tactile": [2]}
    others.message(
        channel, mcap_schemas.encode("tactile.Frame", values) + struct.pack("<BBB", 0x98, 6, 5)
    )
    assert read_mcap(others.done(), recover=False).tactile.tolist() == [[[2.0]]]


def test_actions_are_a_field_of_the_files_that_have_them_only(full, tmp_path):
    write_mcap(full, tmp_path / "a.mcap")
    write_mcap(replace(full, action=None), tmp_path / "b.mcap")
    for name, has_actions in (("a", True), ("b", False)):
        with open(tmp_path / f"{name}.mcap", "rb") as file:
            schemas = make_reader(file).get_summary().schemas.values()
        schema = next(schema.data for schema in schemas if schema.name == "tactile.Frame")
        assert schema == mcap_schemas.frame_schema(has_actions)
        assert (b"action" in schema) == has_actions
    # The schema of earlier versions, which files without actions keep.
    assert zlib.crc32(mcap_schemas.frame_schema(False)) == 1484627828


def test_actions_that_some_frames_lack_are_missing(tmp_path):
    with McapWriter(tmp_path / "a.mcap", has_actions=True) as writer:
        for i in range(3):
            frame = LiveFrame(i, i / 10, 0, None, np.ones((1, 1), np.float32))
            writer.write_frame(frame, action=np.array([i, 5.0]) if i else None)
    found = read_mcap(tmp_path / "a.mcap").action
    assert np.array_equal(found, [[np.nan, np.nan], [1, 5], [2, 5]], equal_nan=True)
    with McapWriter(tmp_path / "b.mcap") as writer:
        frame = LiveFrame(0, 0.0, 0, None, np.ones((1, 1), np.float32))
        with pytest.raises(ValueError, match="'action' must be None without has_actions=True"):
            writer.write_frame(frame, action=np.ones(2))


def test_newer_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.io.recording_mcap.VERSION", 2)
    write_mcap(a_recording(), tmp_path / "a.mcap")
    with pytest.raises(ValueError, match=r"format version 1 \(got 2\)"):
        read_mcap(tmp_path / "a.mcap")


def chunk(inside, size=None, packed=None, crc=None):
    packed = zstandard.compress(inside) if packed is None else packed
    size = len(inside) if size is None else size
    head = struct.pack("<QQQI", 0, 1, size, zlib.crc32(inside) if crc is None else crc)
    content = head + b"\x04\x00\x00\x00zstd" + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(content)) + content


@pytest.mark.parametrize(
    "bad",
    [
        chunk(b"", size=2**40),
        chunk(bytes(1000), size=2**26),
        chunk(bytes(2**26), size=100),
        chunk(b"a" * 100, packed=b"nothing"),
        struct.pack("<BQ", 6, 2**62),
        struct.pack("<BQ", 5, 2**28),
    ],
    ids=["huge", "lies", "bomb", "not packed", "long", "long message"],
)
def test_hostile_sizes_take_no_memory(tmp_path, caplog, bad):
    path = write_frames(tmp_path / "a.mcap", [a_frame(i) for i in range(4)])
    data = path.read_bytes()
    start = data.index(b"\x04\x00\x00\x00zstd") - 37
    place = start + 9 + struct.unpack_from("<Q", data, start + 1)[0]  # behind the frames
    path.write_bytes(data[:place] + bad + data[place:])
    tracemalloc.start()
    assert read_mcap(path).num_frames == 4
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()
    assert "is damaged or truncated" in caplog.text


def test_chunk_that_differs_from_its_checksum_only_is_left_out(tmp_path, caplog):
    path = write_frames(tmp_path / "a.mcap", [a_frame(i) for i in range(40)])
    data = path.read_bytes()
    places = [m.start() - 37 for m in re.finditer(b"\x04\x00\x00\x00zstd", data)]
    start, stop = places[1], places[2]
    _, length = struct.unpack_from("<BQ", data, start)
    content = data[start + 9 : start + 9 + length]
    inside = bytearray(zstandard.decompress(content[44:]))
    inside[-10] ^= 1  # of a reading
    another = chunk(bytes(inside), crc=struct.unpack_from("<I", content, 24)[0])
    path.write_bytes(data[:start] + another + data[start + 9 + length :])
    found = read_mcap(path)
    assert stop > start
    assert 0 < found.num_frames < 40
    assert (found.tactile[:, 0, 0] == found.extra["sequence"]).all()
    assert "a chunk differs from its checksum" in caplog.text


def test_frames_that_would_fill_the_memory_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.io.mcap_reader.ARRAY_BYTES", 10_000)
    monkeypatch.setattr("torch_geometric_tactile.io.mcap_reader.EXPANSION", 0)
    frames = [a_frame(i, tactile=np.zeros((100, 3))) for i in range(12)]
    path = write_frames(tmp_path / "a.mcap", frames)
    with pytest.raises(ValueError, match="allow_large=True"):
        read_mcap(path)
    assert read_mcap(path, allow_large=True).num_frames == 12


def test_log_is_silent_about_whole_files(tmp_path, caplog):
    caplog.set_level(logging.DEBUG)
    read_mcap(write_frames(tmp_path / "a.mcap", [a_frame(0), a_frame(4)]))
    assert caplog.text == ""


def test_text_of_a_message_that_is_no_utf_8_is_refused():
    with pytest.raises(ValueError, match=r"must be a tactile\.Event of protobuf"):
        mcap_schemas.decode("tactile.Event", b"\x12\x02\xff\xfe")  # the kind of an event


def test_number_with_the_bytes_of_a_text_is_passed_over():
    event = mcap_schemas.decode("tactile.Event", b"\x0a\x01x\x12\x01y")
    assert (event.kind, event.HasField("time")) == ("y", False)
