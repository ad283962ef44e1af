import copy

import numpy as np
import onnx_predictors as made
import pytest

from torch_geometric_tactile.live import Judge, Rest

KINDS = ["torch", "onnx"]


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
    if predictor.window is not None:
        windows, last = predictor.windows(recording)
        frames = last.tolist()
        if adapt:
            predictor.adapt_windows(windows)
    elif adapt:
        predictor.adapt(recording.tactile, recording.joint, recording.time)
    probability = predictor.recording(recording)
    labels = predictor.labels(probability)
    rows = dict(zip(frames, probability.numpy(), strict=True))
    names = dict(zip(frames, labels, strict=True))
    assert judged.keys() <= rows.keys()
    for i, judgement in judged.items():
        np.testing.assert_allclose(judgement.probability, rows[i], rtol=0, atol=1e-5)
        assert [judgement.label] == names[i]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["frame", "window", "stepped"])
def test_judge_says_what_predict_says(name, kind):
    recording = made.recording()
    judged = judgements(Judge(model_of(name, kind)), made.live_frames(recording))
    first = 0 if name == "frame" else made.LENGTH - 1
    assert list(judged) == list(range(first, recording.num_frames))
    assert_as_predicted(name, judged, recording, adapt=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["tare", "window_tare"])
def test_judge_measures_the_rest_as_predict_does(name, kind):
    recording = made.recording()
    rest = Rest(seconds=29 / 25, min_frames=30)
    judged = judgements(Judge(model_of(name, kind), rest), made.live_frames(recording))
    first = 29 + (0 if name == "tare" else made.LENGTH - 1)
    assert list(judged) == list(range(first, recording.num_frames))
    assert_as_predicted(name, judged, recording, adapt=True)
