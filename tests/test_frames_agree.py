r"""A data set, its predictor, a judge and a graph in ONNX see the same windows of a recording."""

import math

import numpy as np
import pytest
import torch

from torch_geometric_tactile import Predictor, nn, transforms
from torch_geometric_tactile.data import FrameInfo, LiveFrame, Recording, Windows
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.live import Judge
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 2, pitch=0.004)
LENGTH = 4


def recording(seed, rate, label="a", num_gaps=2, jitter=0.0, since=0.0, unit="count", frames=150):
    """Frames of a clock that jitters, with gaps longer than five frames."""
    draw = np.random.default_rng(seed)
    time = np.arange(frames) / rate
    time += draw.uniform(-jitter, jitter, frames) / rate
    for at in draw.choice(np.arange(10, frames - 10), num_gaps, replace=False):
        time[at:] += draw.uniform(7, 500) / rate
    tactile = draw.normal(size=(frames, 4, 1)).cumsum(axis=0)
    meta = {"unit": unit, "object": label}
    return Recording(
        time=since + np.maximum.accumulate(time), tactile=tactile, label=label, meta=meta
    )


def trained(frames, hop=3, **options):
    """A predictor whose numbers are those of a network that was not trained."""
    windows = Windows(frames, LENGTH, hop, **options)
    torch.manual_seed(0)
    model = nn.TemporalTaxelNet(LAYOUT, 2, in_channels=1)
    scale = transforms.ZScore().fit(windows.batch(range(len(windows))))
    return windows, Predictor.from_dataset(model.eval(), windows, scale)


def live_answers(model, recording, offset=0.0):
    judge, answers = Judge(model), {}
    for i, (time, tactile) in enumerate(zip(recording.time, recording.tactile, strict=True)):
        judgement = judge(LiveFrame(i, float(time) + offset, 0, None, tactile))
        if judgement is not None:
            answers[i] = judgement.probability
    return answers


THINNINGS = [
    {"stride": 1},
    {"stride": 3},
    {"rate_share": 0.5},
    {"rate_share": 0.37},
]


@pytest.fixture(scope="module")
def onnx_of(tmp_path_factory):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    from torch_geometric_tactile.predictor import export_onnx

    def export(predictor):
        path = tmp_path_factory.mktemp("onnx") / "model.onnx"
        export_onnx(predictor, path)
        return path

    return export


def frames_and_recordings(seed, thinning, **options):
    draw = np.random.default_rng(100 + seed)
    rate = float(np.round(10 ** draw.uniform(1, 3), 1))
    jitter, since = draw.choice([0.0, 0.2]), draw.choice([0.0, 1.7e9])
    recordings = [
        recording(seed + 10 * i, rate, "ab"[i % 2], jitter=jitter, since=since, **options)
        for i in range(3)
    ]
    chosen = dict(thinning)
    if "rate_share" in chosen:
        chosen["rate"] = chosen.pop("rate_share") * rate
    frames = RecordingFrames(layout=LAYOUT, recordings=recordings, target="label", **chosen)
    return frames, recordings


@pytest.mark.parametrize("thinning", THINNINGS, ids=str)
@pytest.mark.parametrize("seed", range(6))
def test_windows_of_data_set_predictor_and_judge_are_the_same(seed, thinning):
    frames, recordings = frames_and_recordings(seed, thinning)
    windows, predictor = trained(frames)
    assert windows.num_gaps > 0
    for i, one in enumerate(recordings):
        chosen = (windows.trial == i).nonzero().view(-1)
        cut, last = predictor.windows(one)
        assert torch.equal(cut.x, windows.data.index_select(chosen).x)
        np.testing.assert_array_equal(one.time[last], windows.time[chosen])
        expected = predictor.recording(one).numpy()
        answers = live_answers(predictor, one, offset=float(seed))
        assert {*last.tolist()} <= answers.keys()
        found = np.stack([answers[j] for j in last.tolist()])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.parametrize("thinning", THINNINGS[1:3], ids=str)
def test_a_graph_in_onnx_sees_the_same_windows(thinning, onnx_of):
    from torch_geometric_tactile.live import OnnxModel

    frames, recordings = frames_and_recordings(1, thinning)
    _, predictor = trained(frames)
    path = onnx_of(predictor)
    for one in recordings:
        expected = predictor.recording(one).numpy()
        np.testing.assert_allclose(OnnxModel(path).recording(one), expected, rtol=0, atol=1e-5)
        live, graph = live_answers(predictor, one), live_answers(path, one)
        assert live.keys() == graph.keys()
        for i, answer in live.items():
            np.testing.assert_allclose(graph[i], answer, rtol=0, atol=1e-5)


def test_a_saved_predictor_remembers(tmp_path):
    frames, recordings = frames_and_recordings(2, {"stride": 3})
    _, predictor = trained(frames)
    predictor.save(tmp_path / "model.predictor")
    loaded = Predictor.load(tmp_path / "model.predictor")
    assert loaded.info == predictor.info
    assert (loaded.info.stride, loaded.info.unit) == (3, "count")
    assert torch.equal(loaded.windows(recordings[0])[1], predictor.windows(recordings[0])[1])


def test_another_rate_is_refused_with_both_numbers_or_resampled():
    made = [recording(i, 100.0, "ab"[i % 2]) for i in range(2)]
    _, predictor = trained(RecordingFrames(layout=LAYOUT, recordings=made, target="label"))
    slow = recording(5, 50.0)
    with pytest.raises(ValueError, match=r"100 frames per second.*got 50.*--resample"):
        predictor.recording(slow)
    expected = predictor.recording(slow.resample(predictor.info.rate))
    assert torch.equal(predictor.recording(slow, resample=True), expected)


def test_single_frames_have_no_rate():
    made = [recording(i, rate, "ab"[i % 2]) for i, rate in enumerate((100.0, 50.0))]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label")
    torch.manual_seed(0)
    predictor = Predictor.from_dataset(nn.TaxelNet(LAYOUT, 2, in_channels=1).eval(), frames)
    assert len(predictor.recording(recording(5, 20.0))) == 150
    with pytest.raises(ValueError, match=r"readings in count.*got newton"):
        predictor.recording(recording(5, 20.0, unit="newton"))


def test_recordings_of_two_rates_are_one_set_of_windows_at_a_selected_rate():
    made = [recording(i, rate, "ab"[i % 2]) for i, rate in enumerate((100.0, 50.0))]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label")
    with pytest.raises(ValueError, match="got 50 frames per second in '1' and 100 in '0'"):
        Windows(frames, LENGTH)
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label", rate=25.0)
    windows, predictor = trained(frames)
    assert windows.info.frame_rate == 25.0
    for i, one in enumerate(made):
        chosen = (windows.trial == i).nonzero().view(-1)
        assert torch.equal(predictor.windows(one)[0].x, windows.data.index_select(chosen).x)
    assert len(predictor.windows(recording(5, 200.0))[0].x) > 0
    with pytest.raises(ValueError, match=r"at least 25 frames per second.*got 20"):
        predictor.recording(recording(5, 20.0))


def test_a_slice_of_a_data_set_is_a_stride():
    made = [recording(i, 100.0, "ab"[i % 2]) for i in range(2)]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label")
    assert frames[::4].info.stride == 4
    _, predictor = trained(frames[::4])
    assert predictor.info.frame_rate == pytest.approx(25.0)


def test_frames_drawn_at_random_make_no_windows():
    made = [recording(i, 100.0, "ab"[i % 2]) for i in range(2)]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label", samples_per_trial=20)
    with pytest.raises(ValueError, match="regular intervals"):
        Windows(frames, LENGTH)


def test_data_of_events_has_no_gaps():
    made = [recording(i, 100.0, "ab"[i % 2]) for i in range(2)]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label")
    windows, predictor = trained(frames, max_gap=math.inf)
    assert windows.num_gaps == 0
    assert FrameInfo.from_dict(predictor.info.to_dict()).max_gap == math.inf
    assert len(predictor.windows(made[0])[1]) == (150 - LENGTH) // 3 + 1


def test_one_lost_frame_is_no_gap_and_six_are():
    made = [recording(i, 100.0, "ab"[i % 2], num_gaps=0) for i in range(2)]
    _, predictor = trained(RecordingFrames(layout=LAYOUT, recordings=made, target="label"))
    for lost, expected in ((1, range(20, 23)), (6, range(0))):
        judge, answered = Judge(predictor), []
        for i in [*range(20), *range(20 + lost, 40)][:23]:
            frame = LiveFrame(i, i / 100, 0, None, made[0].tactile[i])
            if judge(frame) is not None:
                answered.append(i - lost)
        assert [i for i in answered if i >= 20] == list(expected)


def test_a_judge_measures_the_rate_and_tells_another_one(caplog):
    made = [recording(i, 100.0, "ab"[i % 2], num_gaps=0) for i in range(2)]
    _, predictor = trained(RecordingFrames(layout=LAYOUT, recordings=made, target="label"))
    judge = Judge(predictor)
    keep = np.random.default_rng(0).random(400) > 0.2  # lost frames lower no rate
    for i in range(400):
        if i < 250 or keep[i]:
            time = i / 100 if i < 250 else 2.5 + (i - 250) / 50
            judge(LiveFrame(i, time, 0, None, made[0].tactile[0]))
        if i < 99:
            assert judge.rate is None
        if i == 249:
            assert judge.rate == pytest.approx(100.0)
            assert judge.note == ""
    assert judge.rate == pytest.approx(50.0, rel=0.03)
    assert judge.note.startswith("wrong rate: ")
    assert judge.note.endswith("instead of 100 Hz")
    assert caplog.text.count("wrong rate") == 1


def test_a_resampled_data_set_has_a_predictor_that_resamples(tmp_path):
    made = [recording(i, rate, "ab"[i % 2]) for i, rate in enumerate((100.0, 50.0))]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label", resample=40.0)
    windows, predictor = trained(frames)
    assert (windows.info.rate, windows.info.resampled) == (40.0, True)
    predictor.save(tmp_path / "model.predictor")
    loaded = Predictor.load(tmp_path / "model.predictor")
    for i, one in enumerate(made):
        chosen = (windows.trial == i).nonzero().view(-1)
        assert torch.equal(loaded.windows(one)[0].x, windows.data.index_select(chosen).x)


def test_predict_names_the_rest_of_the_training():
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    from torch_geometric_tactile.experiments.source import _tare_trials

    made = [recording(i, 50.0, "ab"[i % 2], num_gaps=0) for i in range(2)]
    frames = RecordingFrames(layout=LAYOUT, recordings=made, target="label", stride=5)
    tared = _tare_trials(frames, first=8)
    _, predictor = trained(tared)
    assert predictor.info.rest == pytest.approx(0.75)  # eight frames, 0.1 s apart
    rested = []
    for seconds in (0.2, 0.8, 3.0):
        predictor.adapt_recording(made[0], rest=seconds)
        rested.append(predictor.recording(made[0]))
    assert not torch.equal(rested[0], rested[1])
    assert not torch.equal(rested[1], rested[2])
    predictor.adapt_recording(made[0])  # as many frames as in training
    assert torch.equal(predictor.recording(made[0]), rested[1])
