# ruff: noqa: E402
import functools
import os

import numpy as np
import pytest

for module in ("mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from mcap.exceptions import McapError
from mcap.reader import make_reader

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.io import McapWriter, read_mcap, repair_mcap
from torch_geometric_tactile.io.mcap_reader import join_problems

RATE = 100
SECONDS = 3
PERIOD = 10**9 // RATE


@functools.cache
def contents(sequence):
    """What frame number ``sequence`` holds, and no other."""
    draw = np.random.default_rng(sequence)
    return draw.integers(0, 65536, (6, 3)).astype(np.float32)


def write_stream(path):
    """Writes a stream; returns the size of the file after each chunk, and the frames in it."""
    with McapWriter(path, meta={"unit": "count"}, anchor=(10**18, 0), label="mug") as writer:
        chunks = [(path.stat().st_size, 0)]
        for i in range(RATE * SECONDS):
            now = i * PERIOD
            writer.write_event(now / 1e9, "number", str(i))
            writer.write_frame(LiveFrame(i, now / 1e9, now, None, contents(i)))
            size = path.stat().st_size
            if size != chunks[-1][0]:
                chunks.append((size, i + 1))
    return chunks


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    path = tmp_path_factory.mktemp("stream") / "whole.mcap"
    return path, write_stream(path), path.read_bytes()


def no_wrong_frame(recording):
    """The numbers of the frames, after all that they hold was compared."""
    numbers = recording.extra["sequence"].tolist()
    assert numbers == sorted(set(numbers))
    for place, number in enumerate(numbers):
        assert (recording.tactile[place] == contents(number)).all()
        assert recording.time[place] == number * PERIOD / 1e9
    assert (recording.label, recording.meta["unit"]) == ("mug", "count")
    events = recording.meta.get("events", [])
    for event in events:
        number = int(event["text"])
        assert event == {"time": number * PERIOD / 1e9, "kind": "number", "text": str(number)}
    assert not events or {int(event["text"]) for event in events} >= set(numbers)
    return numbers


def test_chunks_are_closed_every_quarter_of_a_second(stream):
    counts = [frames for _, frames in stream[1]]
    assert np.diff(counts).max() <= 0.25 * RATE + 1
    assert len(counts) == pytest.approx(SECONDS / 0.25, abs=2)


def test_every_cut_loses_a_quarter_of_a_second_at_most(stream, tmp_path, caplog):
    _, chunks, data = stream
    draw = np.random.default_rng(0)
    path = tmp_path / "cut.mcap"
    for place in [chunks[-1][0] - 1, *draw.integers(chunks[1][0], len(data), 30).tolist()]:
        path.write_bytes(data[:place])
        caplog.clear()
        numbers = no_wrong_frame(read_mcap(path))
        assert numbers == list(range(len(numbers)))
        # A frame of which the cut file has one byte was written before the next chunk was closed.
        reached = next((frames for size, frames in chunks if size > place), RATE * SECONDS)
        assert (reached - len(numbers)) / RATE <= 0.3
        assert "is damaged or truncated" in caplog.text
    with pytest.raises(ValueError, match=r"is damaged or truncated.*--repair"):
        read_mcap(path, recover=False)


def test_stock_reader_reads_no_cut_file_but_each_repaired_one(stream, tmp_path):
    _, chunks, data = stream
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    path.write_bytes(data[: (chunks[-2][0] + chunks[-1][0]) // 2])
    with path.open("rb") as file, pytest.raises((McapError, EOFError)):
        [*make_reader(file).iter_messages()]
    report = repair_mcap(path, out)
    frames = report.messages["tactile.Frame"]
    assert report.messages == {"tactile.Event": frames, "tactile.Frame": frames}
    assert report.seconds == pytest.approx((frames - 1) / RATE)
    assert "it is truncated" in str(report)
    assert report.chunks == len(chunks) - 2
    assert report.skipped_bytes == path.stat().st_size - chunks[-2][0]
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages(topics="tactile.Frame")) == frames
    assert no_wrong_frame(read_mcap(out, recover=False)) == list(range(frames))


def test_five_of_many_problems_are_told():
    assert join_problems([*"abcdefg"]) == "a; b; c; d; e; and 2 more"


def test_repair_of_a_whole_file_says_so(stream, tmp_path):
    report = repair_mcap(stream[0], tmp_path / "out.mcap")
    assert report.damage == ()
    assert str(report).endswith("left out 0 bytes: no damage")
    assert report.messages["tactile.Frame"] == RATE * SECONDS


def test_damaged_chunks_are_left_out_and_told(stream, tmp_path, caplog):
    _, chunks, data = stream
    path = tmp_path / "damaged.mcap"
    for start, _ in chunks[:-1]:
        changed = bytearray(data)
        changed[start + 60] ^= 4  # inside of the compressed messages
        path.write_bytes(changed)
        caplog.clear()
        numbers = no_wrong_frame(read_mcap(path))
        assert 0 < RATE * SECONDS - len(numbers) <= 0.3 * RATE
        assert f"{len(numbers)} frames were read" in caplog.text
        if numbers[0] == 0 and numbers[-1] == RATE * SECONDS - 1:
            assert f"{RATE * SECONDS - len(numbers)} between them are missing" in caplog.text


def test_length_of_a_chunk_that_is_damaged_costs_that_chunk_or_what_follows(stream, tmp_path):
    _, chunks, data = stream
    path = tmp_path / "damaged.mcap"
    for start, before in chunks[1:-1]:
        place = data.index(b"\x06", start)
        for byte in (1, 2, 5):
            changed = bytearray(data)
            changed[place + byte] ^= 0x11
            path.write_bytes(changed)  # with the index, which says where the next chunk is
            assert len(no_wrong_frame(read_mcap(path))) >= RATE * (SECONDS - 0.3)
            path.write_bytes(changed[:-40])
            assert no_wrong_frame(read_mcap(path))[:before] == list(range(before))


def test_topics_are_known_without_the_first_chunk(stream, tmp_path, caplog):
    _, chunks, data = stream
    first = data.index(b"\x04\x00\x00\x00zstd")
    changed = bytearray(data[: chunks[-3][0]])  # and no index
    changed[first + 30] ^= 4
    path = tmp_path / "damaged.mcap"
    path.write_bytes(changed)
    numbers = no_wrong_frame(read_mcap(path))
    assert numbers[0] == chunks[1][1]
    assert "its table of topics is damaged" in caplog.text
    report = repair_mcap(path, tmp_path / "out.mcap")
    assert report.messages["tactile.Frame"] == len(numbers)
    assert no_wrong_frame(read_mcap(tmp_path / "out.mcap", recover=False)) == numbers


def test_repaired_files_keep_their_actions_and_schema(tmp_path):
    with McapWriter(tmp_path / "a.mcap", anchor=(10**18, 0), has_actions=True) as writer:
        for i in range(5):
            frame = LiveFrame(i, i / 10, i * 10**8, None, contents(i))
            writer.write_frame(frame, action=np.array([i]))
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[:-40])
    repair_mcap(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert read_mcap(tmp_path / "b.mcap", recover=False).action.ravel().tolist() == [*range(5)]
    with open(tmp_path / "b.mcap", "rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    assert b"action" in next(schema.data for schema in schemas if schema.name == "tactile.Frame")


def test_damaged_metadata_are_not_believed(stream, tmp_path, caplog):
    data = stream[2].replace(b'"mug"', b'"mum"', 1)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    found = read_mcap(path)
    assert found.label is None
    assert found.num_frames == RATE * SECONDS
    assert "label and metadata differ from their checksum" in caplog.text
    assert "its records differ from their checksum" in caplog.text


def test_beginning_that_is_damaged(stream, tmp_path, caplog):
    path = tmp_path / "damaged.mcap"
    content = bytes(500) + stream[2][500:]
    path.write_bytes(content)
    assert read_mcap(path).num_frames > 0
    assert "its beginning is damaged" in caplog.text
    report = repair_mcap(path, tmp_path / "out.mcap")
    assert report.skipped_bytes == stream[1][1][0]  # the first chunk begins in what is lost
    path.write_bytes(content[:-40])  # and no index, which says where chunks are
    with pytest.raises(ValueError, match=r"damaged.mcap' is not an MCAP file \(it begins with"):
        read_mcap(path)


@pytest.mark.parametrize(
    ("start", "new", "told"),
    [
        (-1, b"", "its end is damaged, or followed by other bytes"),
        (-1, b"\n\0", "its end is damaged, or followed by other bytes"),
        (-50, b"damaged", "its index differs from its checksum"),
        (-28, b"\xff" * 8, "its index cannot be read"),
    ],
)
def test_end_that_is_damaged_is_told(stream, tmp_path, caplog, start, new, told):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(stream[2][:start] + new + stream[2][start:][len(new) or 1 :])
    assert len(no_wrong_frame(read_mcap(path))) == RATE * SECONDS
    assert told in caplog.text


def test_nothing_to_save(tmp_path, stream):
    path = tmp_path / "a.mcap"
    path.write_bytes(stream[2][:1000])
    with pytest.raises(ValueError, match=r"a.mcap' must have the topic 'tactile.Frame'"):
        read_mcap(path)
    with pytest.raises(ValueError, match=r"a.mcap' holds no readable message"):
        repair_mcap(path, tmp_path / "b.mcap")
    footer = stream[2][-37:]
    for content in (b"no such file" * 100, footer, footer[:9] + footer[-8:], b""):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a.mcap' is not an MCAP file"):
            read_mcap(path)
    with pytest.raises(ValueError, match="must be a new file"):
        repair_mcap(path, path)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_full_disk_keeps_what_was_written(tmp_path, monkeypatch, caplog):
    path = tmp_path / "a.mcap"
    real, room = os.write, 15_000

    def write(handle, data):
        nonlocal room
        part = bytes(data)[:room]
        room -= len(part)
        if not part:
            raise OSError(28, "No space left on device")
        return real(handle, part)

    writer = McapWriter(path, meta={"unit": "count"}, anchor=(10**18, 0), label="mug")
    monkeypatch.setattr("os.write", write)
    frames = [
        LiveFrame(i, i * PERIOD / 1e9, i * PERIOD, None, contents(i)) for i in range(RATE * SECONDS)
    ]
    with pytest.raises(OSError, match=r"No space left on device.*a.mcap") as first:
        [writer.write_frame(frame) for frame in frames]
    monkeypatch.undo()
    written = path.stat().st_size
    with pytest.raises(OSError, match="No space left") as again:
        writer.flush()
    assert again.value is first.value
    writer.close()
    assert path.stat().st_size == written
    numbers = no_wrong_frame(read_mcap(path))
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > RATE
    assert "it is truncated, or still being written" in caplog.text
    assert "cut or damaged" not in caplog.text  # the half chunk was removed
