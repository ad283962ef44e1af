# ruff: noqa: E402
import re
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch

for module in ("mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from live.numbered import NumberedSource, contents
from live.recorder_kills import kills

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.live import Recorder, Stream, StreamOverflow
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin, grid

SUFFIXES = ("a.mcap", "a.h5")


def no_wrong_frame(recording):
    numbers = recording.extra["sequence"].tolist()
    for place, number in enumerate(numbers):
        assert (recording.tactile[place] == contents(number)).all()
    return numbers


def record(path, source, **settings):
    stream = Stream(source)
    recorder = Recorder(path, stream, **settings)
    recorder.start()
    with stream:
        for _ in stream.subscribe("newest"):
            pass
    recorder.close()
    return recorder


@pytest.fixture(params=SUFFIXES)
def path(request, tmp_path):
    if request.param.endswith("h5"):
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    return tmp_path / request.param


def test_all_frames_of_a_stream_are_kept(path):
    recorder = record(path, NumberedSource(2000, count=400), label="mug")
    found = read_recording(path)
    assert no_wrong_frame(found) == list(range(400))
    assert recorder.frames == 400
    assert (found.label, found.meta["unit"], found.meta["source"]) == ("mug", "count", "numbered:")
    unix, monotonic = recorder.stream.anchor
    assert found.meta["recorded_at"] == unix / 1e9
    assert 0 < found.time[0] < 60
    assert abs(found.meta["recorded_at"] + found.time[0] - time.time()) < 60
    assert monotonic > 0


def test_close_keeps_what_came_before_it(path):
    stream = Stream(NumberedSource(1000))
    frames = stream.subscribe("all")
    recorder = Recorder(path, stream)
    with stream:
        recorder.start()
        for _ in range(50):
            last = frames.get(5)
        recorder.close()
        assert stream.state == "open"
    numbers = no_wrong_frame(read_recording(path))
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert numbers[-1] >= last.sequence
    recorder.close()
    recorder.event("late")
    assert recorder.frames == len(numbers)


def test_a_dead_source_is_raised_and_what_came_is_kept(path):
    stream = Stream(NumberedSource(2000, after=100, error=RuntimeError("burnt")))
    recorder = Recorder(path, stream)
    recorder.start()
    with stream:
        recorder._thread.join(10)
    assert str(recorder.error) == "burnt"
    with pytest.raises(RuntimeError, match="burnt"):
        recorder.close()
    assert no_wrong_frame(read_recording(path)) == list(range(100))


def test_a_stream_that_is_too_fast_is_an_error_at_the_end(path, monkeypatch):
    source = NumberedSource(5000, count=300)
    stream = Stream(source)
    recorder = Recorder(path, stream, size=8)
    go_on = threading.Event()
    real = Recorder._infinite_to_nan
    monkeypatch.setattr(
        Recorder, "_infinite_to_nan", lambda self, f: go_on.wait(10) and real(self, f)
    )
    recorder.start()
    with stream:
        for _ in stream.subscribe("all"):
            pass
    go_on.set()
    with pytest.raises(StreamOverflow, match="too slow"):
        recorder.close()
    numbers = no_wrong_frame(read_recording(path))
    assert numbers == list(range(len(numbers)))
    assert 8 <= len(numbers) < 300


def test_hdf5_that_cannot_be_made_leaves_the_mcap_file_and_says_what_to_do(tmp_path, caplog):
    def change(frame):
        shape = (24, 3) if frame.sequence < 5 else (25, 3)
        return LiveFrame(frame.sequence, frame.time, frame.received, None, np.zeros(shape, "f4"))

    pytest.importorskip("h5py", reason="needs the extra 'io'")
    with pytest.raises(
        ValueError, match=r"a.mcap' is damaged or truncated: .* must have shape \(24, 3\)"
    ):
        record(tmp_path / "a.h5", NumberedSource(1000, count=20, change=change))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    command = f"tactile convert {tmp_path}/a.mcap {tmp_path}/a.h5"
    assert command in caplog.text
    with pytest.raises(FileExistsError, match=re.escape(command)):
        Recorder(tmp_path / "a.h5", Stream(NumberedSource()), overwrite=True)
    assert main(command.split()[1:]) == 0
    assert read_recording(tmp_path / "a.h5").num_frames == 5


def test_hdf5_is_an_mcap_file_until_the_end_and_holds_the_events(tmp_path):
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    stream = Stream(NumberedSource(500))
    frames = stream.subscribe("all")
    with Recorder(tmp_path / "a.h5", stream) as recorder, stream:
        while frames.get(5).sequence < 200:
            pass
        recorder.event("mark")
        assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
        assert no_wrong_frame(read_recording(tmp_path / "a.mcap"))[:50] == list(range(50))
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
    found = read_recording(tmp_path / "a.h5")
    assert no_wrong_frame(found)[:200] == list(range(200))
    assert [event["kind"] for event in found.meta["events"]] == ["mark"]


def test_infinite_readings_are_missing(path, caplog):
    def change(frame):
        tactile = contents(frame.sequence)
        tactile[3, 1] = np.inf
        return LiveFrame(frame.sequence, frame.time, frame.received, 0.5, tactile)

    record(path, NumberedSource(1000, count=20, change=change))
    found = read_recording(path)
    assert found.missing.sum(axis=0).tolist() == [0, 0, 0, 20] + 20 * [0]
    assert found.extra["device_time"].tolist() == [0.5] * 20
    assert caplog.text.count("infinite readings are written as missing") == 1


def test_full_disk_is_raised_and_what_was_written_is_kept(path, monkeypatch, caplog):
    from torch_geometric_tactile.io import McapWriter

    target, path = path, path.with_suffix(".mcap")
    real = McapWriter.flush

    def flush(self):
        if path.stat().st_size > 5000:
            self._output.error = OSError(28, "No space left on device", str(path))
            raise self._output.error
        real(self)

    monkeypatch.setattr(McapWriter, "flush", flush)
    stream = Stream(NumberedSource(500))
    recorder = Recorder(target, stream)
    recorder.start()
    with stream:
        recorder._thread.join(20)
        assert isinstance(recorder.error, OSError)
    with pytest.raises(OSError, match=r"No space left on device.*a.mcap"):
        recorder.close()
    assert ("tactile convert" in caplog.text) == (target != path)
    numbers = no_wrong_frame(read_recording(path))
    assert numbers == list(range(len(numbers)))


def test_existing_file_is_kept_unless_asked(path):
    record(path, NumberedSource(2000, count=20))
    with pytest.raises(FileExistsError, match="or overwrite it"):
        Recorder(path, Stream(NumberedSource()))
    assert read_recording(path).num_frames == 20
    record(path, NumberedSource(2000, count=30), overwrite=True)
    assert read_recording(path).num_frames == 30


def test_no_frame_makes_no_file(path):
    recorder = record(path, NumberedSource(count=0))
    assert recorder.frames == 0
    assert not path.exists()


@pytest.mark.parametrize(
    ("name", "settings", "error", "match"),
    [
        ("a.npz", {}, ValueError, "must end in one of .mcap, .h5, .hdf5"),
        ("none/a.mcap", {}, FileNotFoundError, "create the folder first"),
        ("a.mcap", {"label": 0.5}, ValueError, "'label' must be"),
    ],
)
def test_bad_arguments(tmp_path, name, settings, error, match):
    with pytest.raises(error, match=match):
        Recorder(tmp_path / name, Stream(NumberedSource()), **settings)


def test_judgements_events_health_and_posed_points_are_kept(tmp_path):
    from io_messages import messages

    layout = allegro_uskin()

    def change(frame):
        tactile = np.full((384, 3), frame.sequence, dtype=np.float32)
        joint = np.full(16, 0.01 * frame.sequence)
        joint[0] = np.nan
        return LiveFrame(frame.sequence, frame.time, frame.received, None, tactile, joint)

    stream = Stream(NumberedSource(100, count=60, change=change))
    recorder = Recorder(tmp_path / "a.mcap", stream, layout=layout)
    recorder.event("begin", "before the first frame")
    recorder.start()
    judgement = SimpleNamespace(
        sequence=3,
        time=stream.anchor[1] / 1e9,
        probability=np.array([0.25, 0.75]),
        class_names=("slip", "stable"),
        label="stable",
        task="multiclass",
        latency={"total": 0.001},
    )
    with stream:
        for frame in stream.subscribe("all"):
            if frame.sequence == 3:
                recorder.judgement(judgement)
    recorder.close()
    ((_, event),) = messages(tmp_path / "a.mcap", "tactile.Event")
    assert event.kind == "begin"
    ((_, said),) = messages(tmp_path / "a.mcap", "tactile.Prediction")
    assert (said.label, said.latency, said.sequence) == ("stable", 0.001, 3)
    health = [message for _, message in messages(tmp_path / "a.mcap", "tactile.Health")]
    assert health[0].state == "open"
    clouds = [message for _, message in messages(tmp_path / "a.mcap", "foxglove.PointCloud")]
    assert 4 <= len(clouds) <= 8
    assert [field.name for field in clouds[0].fields] == ["x", "y", "z", "pressure", "shear"]
    assert clouds[0].frame_id == "palm_link"
    points = [np.frombuffer(cloud.data, "<f4").reshape(384, 5) for cloud in clouds]
    assert points[0][:, 3:].tolist() == [[0, 0]] * 384
    number = points[-1][0, 3]
    assert points[-1][:, 4] == pytest.approx(number * 2**0.5)
    import torch

    from torch_geometric_tactile.sensors import HandKinematics

    joint = torch.full((16,), 0.01 * float(number), dtype=torch.double)
    joint[0] = 0
    expected = HandKinematics.allegro().taxel_pose(layout, joint).pos.numpy()
    assert points[-1][:, :3] == pytest.approx(expected, abs=1e-6)
    assert read_recording(tmp_path / "a.mcap").meta["sensor"] == layout.name


def test_points_of_another_layout_do_not_end_a_recording(tmp_path, caplog):
    record(tmp_path / "a.mcap", NumberedSource(1000, count=20), layout=grid(2, 2, pitch=0.01))
    assert no_wrong_frame(read_recording(tmp_path / "a.mcap")) == list(range(20))
    assert "must have 4 taxels (got 24)" in caplog.text


def test_everything_is_loaded_before_the_source_is_opened(tmp_path, monkeypatch):
    from torch_geometric_tactile.live import _posed_points

    made = []

    class Slow(_posed_points.PosedPoints):
        def __init__(self, layout):
            made.append((threading.current_thread(), stream.state))
            super().__init__(layout)

    monkeypatch.setattr(_posed_points, "PosedPoints", Slow)
    stream = Stream(NumberedSource(1000, count=20))
    recorder = Recorder(tmp_path / "a.mcap", stream, layout="biotac_sp")
    assert made == [(threading.current_thread(), "closed")]
    recorder.start()
    with stream:
        for _ in stream.subscribe("newest"):
            pass
    recorder.close()
    assert len(made) == 1
    assert recorder.frames == 20


def test_flat_layout_and_one_channel():
    from torch_geometric_tactile.live._posed_points import PosedPoints

    points = PosedPoints(grid(1, 2, pitch=0.01))
    tactile = np.array([[3.0], [np.nan]], dtype=np.float32)
    pos, fields, frame_id = points(LiveFrame(0, 0.0, 0, None, tactile), np.ones((2, 1)))
    assert pos.shape == (2, 3)
    assert frame_id == "base"
    assert np.array_equal(fields["pressure"], [2, np.nan], equal_nan=True)
    assert [*fields] == ["pressure"]


def test_taxels_on_every_link_of_the_hand_are_posed():
    from torch_geometric_tactile.live._posed_points import PosedPoints

    hand = HandKinematics.allegro()
    links = torch.arange(len(hand.link_names))
    layout = TaxelLayout(
        "all", pos=torch.full((len(links), 3), 0.01), link=links, link_names=tuple(hand.link_names)
    )
    tactile = np.ones((len(links), 1), dtype=np.float32)
    joint = np.full(hand.num_joints, 0.3, dtype=np.float32)
    bent, straight = (
        PosedPoints(layout)(LiveFrame(0, 0.0, 0, None, tactile, angles), tactile)[0]
        for angles in (joint, 0 * joint)
    )
    assert not np.allclose(bent, straight)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".mcap", ".h5"])
def test_killed_recorder_loses_a_quarter_of_a_second(suffix):
    for kill in kills(2, rate=500, suffix=suffix):
        assert kill.wrong == 0
        assert kill.kept > 0
        assert kill.seconds <= 0.3


def test_annotations_begin_and_end_and_the_open_one_ends_with_the_recording(path):
    stream = Stream(NumberedSource(1000))
    frames = stream.subscribe("all")
    recorder = Recorder(path, stream)
    assert recorder.annotate("early") is None  # before the first frame
    assert recorder.annotation == "early"
    with stream:
        recorder.start()
        for label in ("hold", "hold", "slip", "hold"):
            for _ in range(30):
                frames.get(5)
            recorder.annotate(label)
        assert recorder.annotation == "hold"
        seconds = recorder.event("mark")
        with pytest.raises(ValueError, match="printable"):
            recorder.annotate("")
        for _ in range(30):
            frames.get(5)
        recorder.close()
    found = read_recording(path)
    early, hold, slip, last = found.annotations
    assert [a.label for a in found.annotations] == ["early", "hold", "slip", "hold"]
    assert early.start < found.time[0] < early.end == hold.start < hold.end < slip.start
    assert (slip.end, last.end) == (last.start, found.time[-1])
    (event,) = found.meta["events"]
    assert event["time"] - found.time[0] == pytest.approx(seconds, abs=1e-6)
    assert seconds > last.start - found.time[0]
