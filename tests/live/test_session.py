# ruff: noqa: E402
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

for module in ("mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from live.numbered import SHAPE, NumberedSource, contents
from recordings import noisy_recording

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import ContactRule, LiveFrame
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.live import (
    Callback,
    Health,
    Judge,
    Judgement,
    LiveSession,
    ReplaySource,
    Rest,
    Status,
    StreamEnded,
)
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.sensors import biotac_sp


def recording(count=120, offset=0.0):
    return noisy_recording(count, *SHAPE, offset=offset, meta={"unit": "count"})


@pytest.fixture(scope="module")
def predictor():
    torch.manual_seed(0)
    layout = biotac_sp()
    model = TaxelNet(layout, 2, in_channels=SHAPE[1])
    return Predictor(model, layout, class_names=["hold", "slip"], num_channels=SHAPE[1])


class Noted(Callback):
    def __init__(self):
        self.called = []
        self.judgements = []

    def on_start(self, session):
        self.called.append("start")

    def on_frame(self, session, frame):
        self.called.append("frame")

    def on_judgement(self, session, judgement):
        self.called.append("judgement")
        self.judgements.append(judgement)

    def on_health(self, session, health):
        self.called.append("health")

    def on_end(self, session):
        self.called.append("end")


def messages(path, topic):
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages([topic])]


def test_everything_at_once(predictor, tmp_path):
    whole = recording()
    noted, statuses = Noted(), []
    source = ReplaySource(whole, speed=0)
    session = LiveSession(source, judge=Judge(predictor), policy="all", callbacks=[noted])
    session.record(tmp_path / "a.mcap", label="mug")
    with session:
        session.run(on_status=statuses.append)
    kept = read_recording(tmp_path / "a.mcap")
    assert (kept.tactile == whole.tactile).all()
    assert kept.label == "mug"
    assert len(messages(tmp_path / "a.mcap", "tactile.Prediction")) == len(whole.time)
    got = np.array([judgement.probability for judgement in noted.judgements])
    np.testing.assert_allclose(got, predictor.recording(whole).numpy(), rtol=0, atol=1e-5)
    assert [one for one in noted.called if one != "health"] == [
        "start",
        *["frame", "judgement"] * len(whole.time),
        "end",
    ]
    assert "health" in noted.called
    assert session.judged == statuses[-1].health.frames == len(whole.time)
    assert statuses[-1].recorded is not None
    assert statuses[-1].latency > 0


@pytest.mark.parametrize("method", ["on_start", "on_frame", "on_judgement", "on_end"])
def test_error_of_a_callback_ends_it_and_keeps_the_recording(predictor, tmp_path, method):
    class Broken(Callback):
        pass

    def fail(self, *arguments):
        raise RuntimeError("the gripper is stuck")

    setattr(Broken, method, fail)
    source = NumberedSource(2000, count=200)
    session = LiveSession(source, judge=Judge(predictor), callbacks=[Broken()])
    session.record(tmp_path / "a.mcap")
    with pytest.raises(RuntimeError, match="the gripper is stuck"), session:
        session.run()
    assert session.stream.state != "open"
    if (tmp_path / "a.mcap").exists():
        kept = read_recording(tmp_path / "a.mcap")
        numbers = kept.extra["sequence"].tolist()
        assert (kept.tactile == np.array([contents(number) for number in numbers])).all()


def test_error_of_the_source_is_raised_and_ends_callbacks():
    noted = Noted()
    source = NumberedSource(2000, after=20, error=ZeroDivisionError("of the driver"))
    session = LiveSession(source, callbacks=[noted])
    with pytest.raises(ZeroDivisionError, match="of the driver"), session:
        session.run()
    assert noted.called[-1 if noted.called[-1] == "end" else -2] == "end"


def test_source_that_is_not_there_leaves_nothing(tmp_path):
    session = LiveSession(ReplaySource(tmp_path / "none.h5"))
    session.record(tmp_path / "a.mcap")
    with pytest.raises(FileNotFoundError, match=r"none\.h5"):
        session.open()
    session.close()
    assert not (tmp_path / "a.mcap").exists()
    with pytest.raises(StreamEnded):
        session.stream.subscribe().get(timeout=0)


def test_tare_subtracts_the_rest(predictor):
    whole = recording(offset=500.0)
    noted = Noted()
    rest = Rest(seconds=0.03, min_frames=20, max_movement=1e6)
    judge = Judge(predictor, rest)
    source = ReplaySource(whole, speed=10)
    session = LiveSession(source, judge=judge, tare=True, policy="all", callbacks=[noted])
    with session:
        session.run()
    first = noted.judgements[0].sequence
    assert 19 <= first < 60
    tared = whole.tactile - whole.tactile[: first + 1].astype(np.float64).mean(0)
    wanted = predictor(tared[first:].astype(np.float32)).numpy()
    got = np.array([judgement.probability for judgement in noted.judgements])
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize("tare", [False, True])
def test_frames_without_contact_are_labelled(predictor, tare, tmp_path):
    whole = recording(offset=500.0)
    whole.tactile[80:100, 3:6, 1] += 200
    noted = Noted()
    judge = Judge(predictor, Rest(seconds=0.05), contact=ContactRule())
    source = ReplaySource(whole, speed=4)
    session = LiveSession(source, judge=judge, tare=tare, policy="all", callbacks=[noted])
    session.record(tmp_path / "a.mcap")
    with session:
        session.run()
    assert noted.judgements[0].sequence < 80  # from the end of the rest on
    assert {j.sequence for j in noted.judgements if not j.lacks_contact} == {*range(80, 100)}
    for each in noted.judgements:
        assert (each.label == "no contact") == each.lacks_contact
        assert np.isnan(each.probability).all() == each.lacks_contact
    assert len(messages(tmp_path / "a.mcap", "tactile.Prediction")) == len(noted.judgements)


def test_a_tare_anew_measures_the_contact_rule_anew(predictor):
    judge = Judge(predictor, Rest(seconds=0.4), contact=ContactRule())
    whole = recording()
    whole.tactile[60:] += 500  # another rest
    said = []
    for i, tactile in enumerate(whole.tactile):
        if i == 60:
            judge.rest.retare()
        judgement = judge(LiveFrame(i, i / 100, 10**7 * i, None, tactile))
        said.append(judgement is None or judgement.lacks_contact)
    assert all(said)
    assert judge.contact.rest.mean() > 400


def test_drift_is_measured_every_quarter_of_a_second(predictor, monkeypatch):
    looked = []
    monkeypatch.setattr(Rest, "drift", lambda self, frame: looked.append(frame.time))
    rest = Rest(seconds=0.03, min_frames=20, max_movement=1e6)
    source = ReplaySource(recording(), speed=10)
    with LiveSession(source, judge=Judge(predictor, rest), tare=True, policy="all") as session:
        session.run()
    steps = np.diff(looked)
    assert len(looked) > 0
    assert not len(steps) or steps.min() >= 0.25


def test_tare_needs_a_rest(predictor):
    with pytest.raises(ValueError, match="'rest' must be given"):
        LiveSession(NumberedSource(), judge=Judge(predictor), tare=True)


def test_new_rest_is_kept_as_an_event(predictor, tmp_path):
    class Retare(Callback):
        def on_judgement(self, session, judgement):
            if session.judged == 1:
                session.tare()

    rest = Rest(seconds=0.01, min_frames=10, max_movement=1e6)
    session = LiveSession(
        ReplaySource(recording(), speed=10),
        judge=Judge(predictor, rest),
        tare=True,
        policy="all",
        callbacks=[Retare()],
    )
    session.record(tmp_path / "a.mcap")
    with session:
        session.run()
    kinds = [kind for _, kind, _ in rest.events]
    assert kinds[:3] == ["rest", "retare", "rest"]
    events = messages(tmp_path / "a.mcap", "tactile.Event")
    assert sum(b"retare" in event for event in events) == 1
    assert rest.number == 2


def test_recordings_begin_and_end_at_any_time(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session = LiveSession(NumberedSource(500))
    with session:
        first = session.toggle_recording()
        with pytest.raises(ValueError, match="a recording to"):
            session.record("b.mcap")
        session.run(seconds=0.3)
        assert session.toggle_recording() == first
        assert session.recorder is None
        session.record("b.mcap")
        session.run(seconds=0.3)
    for path in (first, "b.mcap"):
        kept = read_recording(path)
        numbers = kept.extra["sequence"]
        assert (np.diff(numbers) == 1).all()
        assert (kept.tactile[-1] == contents(numbers[-1])).all()
    assert session.stop_recording() is None


def test_stop_from_a_callback_and_from_a_thread():
    class Stop(Callback):
        def on_frame(self, session, frame):
            if frame.sequence >= 20:
                session.stop()

    session = LiveSession(NumberedSource(1000), callbacks=[Stop()])
    with session:
        session.run()
    assert session.stream.health().frames >= 20
    session = LiveSession(NumberedSource(100))
    timer = threading.Timer(0.2, session.stop)
    timer.start()
    with session:
        session.run()
    timer.join()
    assert session.stream.state == "closed"
    session.close()  # again


def judgement(probability, names, task="multiclass"):
    return Judgement(0, 0.0, 0, 0, np.array(probability), tuple(names), task, {})


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (judgement([0.07, 0.93], ["hold", "slip"]), "slip 93 %"),
        (judgement([0.4, 0.6], ["hold", "slip; late"]), "slip; late 60 %"),
        (judgement([np.nan, np.nan], ["hold", "slip"]), "no answer (readings are missing)"),
        (judgement([0.9, 0.2, 0.7], ["a", "b", "c"], "multilabel"), "a, c"),
        (judgement([0.1, 0.2], ["a", "b"], "multilabel"), "none of the labels"),
        (judgement([1.23456, -2], ["x", "y"], "regression"), "x 1.235 y -2"),
        (replace(judgement([np.nan], ["x"], "regression"), lacks_contact=True), "no contact"),
    ],
    ids=["class", "semicolon", "missing", "labels", "no label", "numbers", "no contact"],
)
def test_status_is_one_line(said, text):
    health = Health("open", frames=9, rate=100.0, age=0.001)
    line = Status(health, said, 0.0021, 9, "keep still").line()
    assert line == f"{health.line()}  {text}  latency 2.1 ms  recorded 9  keep still"


def test_status_tells_first_what_to_do_while_there_is_no_prediction():
    health = Health("open", frames=51, rate=100.0, age=0.001)
    line = Status(health, None, None, 51, Rest(1.0).status()).line()
    assert line.startswith("keep the sensor untouched: 0 still frames so far  100.0 Hz")


@pytest.mark.parametrize("state", ["silent", "lost"])
def test_status_without_frames_shows_no_old_prediction(state):
    health = Health(state, frames=9, age=2.0)
    said = judgement([0.07, 0.93], ["hold", "slip"])
    line = Status(health, said, 0.0021, 9, "keep still").line()
    assert line == f"keep still  {health.line()}  recorded 9"


def test_status_without_a_model():
    health = Health("silent", frames=9, rate=0.0, age=1.5)
    assert Status(health, None, None, None, "").line() == health.line()


def test_status_tells_first_which_annotation_is_open():
    health = Health("open", frames=9, rate=100.0, age=0.001)
    line = Status(health, None, None, 9, "keep still", "slip").line()
    assert line == f"[slip]  keep still  {health.line()}  recorded 9"


def test_repr(predictor):
    session = LiveSession(NumberedSource(), judge=Judge(predictor))
    assert repr(session) == (
        "LiveSession(NumberedSource('numbered:'), judge=Judge(PyTorch, 'biotac_sp', "
        "classes=['hold', 'slip'], task='multiclass', length=1))"
    )
