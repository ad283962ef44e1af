import copy
from pathlib import Path

import numpy as np
import onnx_predictors as made
import pytest

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.live import Judge, Judgement, Rest, Subscription

pytestmark = pytest.mark.xdist_group("onnx_predictors")  # which makes each file once

KINDS = ["torch", "onnx"]
EACH_KIND = ["torch", pytest.param("onnx", marks=pytest.mark.full)]


def model_of(name, kind):
    if kind == "torch":
        return made.predictor(name)
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    return made.onnx_file(name)


def judgements(judge, frames):
    return {judgement.sequence: judgement for judgement in judge.follow(frames)}


def assert_as_predicted(name, judged, recording, adapt):
    """The numbers of `tactile predict`, and its classes."""
    predictor = copy.deepcopy(made.predictor(name))
    frames = range(recording.num_frames)
    if adapt:
        predictor.adapt_recording(made.recording_at_rest(), rest=np.inf)
    if predictor.window is not None:
        frames = predictor.windows(recording)[1].tolist()
    probability = predictor.recording(recording)
    labels = predictor.labels(probability)
    rows = dict(zip(frames, probability.numpy(), strict=True))
    names = dict(zip(frames, labels, strict=True))
    assert judged.keys() <= rows.keys()
    for i, judgement in judged.items():
        np.testing.assert_allclose(judgement.probability, rows[i], rtol=0, atol=1e-5)
        assert [judgement.label] == names[i]


@pytest.mark.slow
@pytest.mark.parametrize("kind", EACH_KIND)
@pytest.mark.parametrize(
    "name",
    [
        "frame",
        *(
            pytest.param(name, marks=pytest.mark.full)
            for name in ("window", "stepped", "window_machine")
        ),
    ],
)
def test_judge_says_what_predict_says(name, kind):
    recording = made.recording()
    judged = judgements(Judge(model_of(name, kind)), made.live_frames(recording))
    first = 0 if name == "frame" else made.LENGTH - 1
    assert list(judged) == list(range(first, recording.num_frames))
    assert_as_predicted(name, judged, recording, adapt=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", EACH_KIND)
@pytest.mark.parametrize("name", ["tare", "window_tare", "frames_tare", "machine"])
def test_judge_measures_the_rest_as_predict_does(name, kind):
    recording = made.recording()
    rest = Rest(seconds=29 / 25, min_frames=30)
    judged = judgements(Judge(model_of(name, kind), rest), made.live_frames(recording))
    first = 29 + (0 if name in ("tare", "machine") else made.LENGTH - 1)
    assert list(judged) == list(range(first, recording.num_frames))
    assert_as_predicted(name, judged, recording, adapt=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["session", "window_tare", "frames_tare"])
def test_a_graph_measures_what_the_predictor_measures(name):
    recording = made.recording()
    judged = []
    for kind in KINDS:
        rest = Rest(seconds=1.0, min_frames=26)
        judged.append(judgements(Judge(model_of(name, kind), rest), made.live_frames(recording)))
    assert judged[0].keys() == judged[1].keys()
    assert len(judged[0]) > 20
    for i, one in judged[0].items():
        np.testing.assert_allclose(one.probability, judged[1][i].probability, rtol=0, atol=1e-5)


@pytest.fixture(params=EACH_KIND)
def judge(request):
    return Judge(model_of("window", request.param))


@pytest.mark.slow
def test_a_gap_empties_the_window(judge):
    frames = list(made.live_frames(made.recording()))
    whole = judgements(judge, frames)
    judge.reset()
    judged = judgements(judge, [*frames[:20], *frames[22:]])
    assert list(judged) == [*range(5, 20), *range(27, 60)]
    for i, one in judged.items():
        np.testing.assert_array_equal(one.probability, whole[i].probability)
    judge.reset()
    judge.max_lost = 2
    assert list(judgements(judge, [*frames[:20], *frames[22:]])) == [*range(5, 20), *range(22, 60)]
    judge.reset()  # a device that starts over
    assert list(judgements(judge, [*frames[:20], *frames[:20]])) == [*range(5, 20)]


@pytest.mark.slow
def test_the_newest_frame_is_judged_with_those_between(judge):
    frames = list(made.live_frames(made.recording()))
    whole = judgements(judge, frames)
    judge.reset()
    subscription = Subscription("drop_oldest", size=30)
    for frame in frames:
        subscription.put(frame)
    subscription.end()
    (last,) = judge.follow(subscription)
    assert last.sequence == 59
    np.testing.assert_array_equal(last.probability, whole[59].probability)
    with pytest.raises(ValueError, match=r"'subscription' must have policy 'all' or 'drop_oldest'"):
        next(judge.follow(Subscription("newest")))


def test_a_judgement_tells_its_latency():
    judge = Judge(made.predictor("frame"))
    frames = list(made.live_frames(made.recording()))
    judgement = judge(frames[40])
    latency = judgement.latency
    assert set(latency) == {"wait", "prepare", "model", "total"}
    parts = latency["wait"] + latency["prepare"] + latency["model"]
    assert abs(parts - latency["total"]) < 1e-9
    assert judgement.finished - judgement.received == pytest.approx(latency["total"] * 1e9)
    assert judgement.time == frames[40].time
    assert judgement.class_names == ("ball", "cube")


def judgement(probability, task="multiclass", threshold=None):
    names = ("a", "b", "c")[: len(probability)]
    return Judgement(0, 0.0, 0, 0, np.array(probability), names, task, {}, threshold)


def test_labels():
    assert judgement([0.2, 0.5, 0.3]).label == "b"
    assert judgement([0.6, 0.4], threshold=0.3).label == "b"
    assert judgement([0.6, 0.4], threshold=0.5).label == "a"
    assert judgement([0.6, 0.4, 0.7], "multilabel").label == "a;c"
    assert judgement([0.1, 0.4], "multilabel").label == ""
    assert judgement([np.nan, np.nan]).label == ""
    assert judgement([3.0], "regression").label == ""


@pytest.mark.slow
@pytest.mark.parametrize("kind", EACH_KIND)
def test_missing_readings_give_no_label(kind):
    judge = Judge(model_of("stepped", kind))
    frames = list(made.live_frames(made.recording()))
    frames[20].tactile[3, 1] = np.nan
    judged = judgements(judge, frames)
    missing = [i for i, one in judged.items() if np.isnan(one.probability).any()]
    receptive_field = made.predictor("stepped").model.receptive_field
    assert missing == list(range(20, 20 + receptive_field))
    assert judged[20].label == ""


@pytest.mark.slow
@pytest.mark.parametrize("kind", EACH_KIND)
def test_other_frames_are_refused(kind):
    judge = Judge(model_of("frame", kind))
    x, joint = np.zeros((11, 3), np.float32), np.zeros(2, np.float32)
    for shape in [(12, 3), (11, 2), (33,)]:
        with pytest.raises(ValueError, match=r"a frame must have shape \(11, 3\), the taxels of"):
            judge(LiveFrame(0, 0.0, 0, None, np.zeros(shape, np.float32), joint))
    for angles, given in [(None, "none"), (np.zeros(3, np.float32), "3")]:
        with pytest.raises(ValueError, match=rf"must have 2 joint angles.*\(got {given}\)"):
            judge(LiveFrame(0, 0.0, 0, None, x, angles))


@pytest.mark.slow
@pytest.mark.parametrize("kind", EACH_KIND)
def test_a_rest_may_be_given_as_readings(kind):
    recording = made.recording()
    rest = recording.tactile[:30].astype(np.float64).mean(axis=0)
    given = judgements(Judge(model_of("tare", kind), rest), made.live_frames(recording, 30))
    assert_as_predicted("tare", given, recording, adapt=True)
    with pytest.raises(ValueError, match="'rest' must be given: the model measures each session"):
        Judge(model_of("tare", kind))
    with pytest.raises(ValueError, match=r"'rest' must have shape \(11, 3\) \(got \(3, 11\)\)"):
        Judge(model_of("tare", kind), rest.T)


def test_retare_measures_anew():
    recording = made.recording(num_frames=90, rest=90)
    rest = Rest(seconds=0.4)
    judge = Judge(made.predictor("tare"), rest)
    frames = list(made.live_frames(recording))
    first = [judge(frame) for frame in frames[:40]]
    assert [one is not None for one in first] == [False] * 29 + [True] * 11
    rest.retare()
    later = [judge(frame) for frame in frames[40:]]
    assert [one is not None for one in later] == [False] * 29 + [True] * 21


def test_files_are_opened(tmp_path):
    made.predictor("frame").save(tmp_path / "a.predictor")
    judge = Judge(tmp_path / "a.predictor")
    assert repr(judge).startswith("Judge(PyTorch, 'small', classes=['ball', 'cube'], task='multi")
    with pytest.raises(FileNotFoundError):
        Judge(tmp_path / "b.predictor")


def test_bad_onnx_files(tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    onnx = pytest.importorskip("onnx", reason="needs the extra 'export'")
    path = tmp_path / "model.onnx"
    with pytest.raises(FileNotFoundError, match="there is no model"):
        Judge(path)
    path.write_bytes(b"no model")
    with pytest.raises(ValueError, match="is not an ONNX model"):
        Judge(path)
    info = onnx.helper.make_tensor_value_info("x", 1, [1])
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    out = onnx.helper.make_tensor_value_info("y", 1, [1])
    graph = onnx.helper.make_graph([node], "g", [info], [out])
    opset = [onnx.helper.make_opsetid("", 18)]
    model = onnx.helper.make_model(graph, opset_imports=opset, ir_version=9)
    for text, match in [
        (None, "must be a model that 'tactile export' wrote"),
        ('{"format": 2}', r"must have format 1 \(got 2\)"),
        ('{"format": 1}', "the metadata of .* cannot be read"),
        ("{", "the metadata of .* cannot be read"),
    ]:
        del model.metadata_props[:]
        if text is not None:
            model.metadata_props.add(key="torch_geometric_tactile", value=text)
        path.write_bytes(model.SerializeToString())
        with pytest.raises(ValueError, match=match):
            Judge(path)


@pytest.mark.slow
def test_any_flipped_bit_of_a_graph_is_noticed(tmp_path):
    whole = Path(model_of("frame", "onnx")).read_bytes()
    path = tmp_path / "a.onnx"
    path.write_bytes(whole)
    Judge(path)
    draw = np.random.default_rng(0)
    for place in draw.integers(0, len(whole), 60).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << draw.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"a\.onnx'"):
            Judge(path)
    path.write_bytes(whole[:-1])
    with pytest.raises(ValueError, match=r"a\.onnx'"):
        Judge(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frame", "window", "stepped"])
@pytest.mark.parametrize("infinity", [np.inf, -np.inf])
def test_infinite_readings_are_missing_in_both_forms(name, infinity):
    judged = []
    for value in (infinity, np.nan):
        recording = made.recording()
        recording.tactile[20, 4, 1] = value
        for kind in KINDS:
            judged.append(judgements(Judge(model_of(name, kind)), made.live_frames(recording)))
    for i, one in judged[0].items():
        for other in judged[1:]:
            assert other[i].label == one.label
            np.testing.assert_allclose(one.probability, other[i].probability, rtol=0, atol=1e-5)
    assert (judged[0][20].label == "") == (name != "frame")  # which fills what is missing
