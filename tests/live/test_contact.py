"""Laws of the label "no contact": the same frames for predictor, table, judge and ONNX."""

import copy
import csv
import json
from dataclasses import replace

import numpy as np
import onnx_predictors as made
import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import NO_CONTACT, ContactRule, FrameInfo, Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.live import Judge, OnnxModel, Rest
from torch_geometric_tactile.predictor._network import Network
from torch_geometric_tactile.predictor._window_cut import WindowCut

pytestmark = pytest.mark.xdist_group("onnx_predictors")  # which makes each file once

SINGLE = ["frame", "tare"]
WINDOWS = ["window", "window_tare", "frames_tare", "stepped", "window_machine"]
NUM_REST = 30
RULES = [ContactRule(), ContactRule(200.0, min_taxels=3)]


def onnx_file(name):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    return made.onnx_file(name)


def recording(seed, num_frames=90):
    """At rest, then touched and released again and again, with missing readings."""
    draw = np.random.default_rng(seed)
    tactile = 30100 + 5 * draw.standard_normal((num_frames, 11, 3))
    for _ in range(3):
        start, length = draw.integers(NUM_REST, num_frames - 3), draw.integers(1, 12)
        taxels = draw.choice(11, draw.integers(3, 6), replace=False)
        tactile[start : start + length, taxels, draw.integers(3)] += draw.choice([-500.0, 500.0])
    missing = draw.random(tactile.shape) < 0.05
    missing[:NUM_REST] = False
    tactile[missing] = np.nan
    tactile[-3] = np.nan
    joint = draw.uniform(0, 1, (num_frames, 2))
    time = np.arange(num_frames) / 25
    return Recording(time=time, tactile=tactile.astype(np.float32), joint=joint)


def predicted(name, rule, whole):
    """Probabilities without the rule and with it, which rows lack contact, and their frames."""
    answers = []
    for each in (None, rule):
        predictor = copy.deepcopy(made.predictor(name))
        predictor.contact = each
        if each is not None or predictor.preparation.session.transforms:
            predictor.adapt_recording(whole, rest=NUM_REST / 25)
        answers.append(predictor.recording(whole))
    frames = range(whole.num_frames)
    if predictor.window is not None:
        frames = predictor.windows(whole)[1].tolist()
    return *answers, predictor.lacks_contact(whole), list(frames), predictor


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", [*SINGLE, *WINDOWS])
@pytest.mark.parametrize("seed", range(3))
def test_frames_with_contact_keep_their_numbers_and_others_have_none(name, rule, seed):
    whole = recording(seed)
    off, on, free, frames, predictor = predicted(name, rule, whole)
    assert 0 < free.sum() < len(free)
    assert torch.equal(on[~free].nan_to_num(-1), off[~free].nan_to_num(-1))
    assert on[free].isnan().all()
    labels = predictor.labels(on, free)
    assert [row == [NO_CONTACT] for row in labels] == free.tolist()
    known = predictor.labels(off)
    assert all(a == b for a, b, is_free in zip(labels, known, free, strict=True) if not is_free)
    # By hand: no frame of the window is touched, and one has readings.
    length = 1 if predictor.window is None else predictor.window.length
    touched = predictor.contact.is_contact(whole.tactile)
    empty = np.isnan(whole.tactile).all(axis=(1, 2))
    for i, is_free in zip(frames, free.tolist(), strict=True):
        window = slice(i - length + 1, i + 1)
        assert is_free == (not touched[window].any() and not empty[window].all())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["torch", pytest.param("onnx", marks=pytest.mark.full)])
@pytest.mark.parametrize("name", [*SINGLE, *WINDOWS])
def test_a_judge_says_what_the_predictor_says(name, kind):
    model = made.predictor(name) if kind == "torch" else onnx_file(name)
    for seed, rule in enumerate(RULES):
        whole = recording(seed)
        _, on, free, frames, predictor = predicted(name, rule, whole)
        labels = predictor.labels(on, free)
        rest = Rest(seconds=(NUM_REST - 1) / 25, min_frames=NUM_REST)
        judge = Judge(model, rest, contact=rule)
        judged = {j.sequence: j for j in judge.follow(made.live_frames(whole))}
        first = NUM_REST - 1 + judge.length - 1  # the last frame of the rest is judged
        assert list(judged) == [i for i in frames if i >= first]
        for i, is_free, row, expected in zip(frames, free.tolist(), on, labels, strict=True):
            if i < first:
                continue
            assert judged[i].lacks_contact == is_free
            assert judged[i].label == ";".join(expected)
            np.testing.assert_allclose(judged[i].probability, row.numpy(), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_a_judge_without_a_rule_says_what_it_said(tmp_path):
    frames = list(made.live_frames(recording(0)))
    judge = Judge(made.predictor("frame"), Rest(1.0))
    assert judge.contact is None
    assert not judge.measures_rest
    judged = [judge(frame) for frame in frames]
    assert not any(j.lacks_contact for j in judged)
    assert len(judged) == len(frames)  # it waits for no rest


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frame", "window"])
def test_the_files_of_a_predictor_keep_its_rule(name, tmp_path):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    from torch_geometric_tactile.predictor import export_onnx

    whole = recording(1)
    _, on, free, _, predictor = predicted(name, ContactRule(min_taxels=1), whole)
    predictor.save(tmp_path / "a.predictor")
    read = Predictor.load(tmp_path / "a.predictor")
    assert read.contact == predictor.contact
    assert torch.equal(read.recording(whole).nan_to_num(-1), on.nan_to_num(-1))
    read.save(tmp_path / "b.predictor")
    assert (tmp_path / "a.predictor").read_bytes() == (tmp_path / "b.predictor").read_bytes()
    exported = export_onnx(read, tmp_path / "a.onnx")
    assert json.loads(json.dumps(exported.metadata))["contact"]["min_taxels"] == 1
    model = OnnxModel(tmp_path / "a.onnx")
    assert model.contact == predictor.contact
    out = model.recording(whole)
    np.testing.assert_array_equal(np.isnan(out).all(axis=1), on.isnan().all(dim=1).numpy())
    np.testing.assert_allclose(out, on.numpy(), rtol=0, atol=1e-5)
    for path in ("a.predictor", "a.onnx"):  # with the rest of the file
        judge = Judge(tmp_path / path)
        judged = list(judge.follow(made.live_frames(whole)))
        assert [j.lacks_contact for j in judged] == free.tolist()


def test_a_rest_that_was_measured_elsewhere_is_that_of_the_rule():
    whole = recording(2)
    center = whole.tactile[:NUM_REST].mean(axis=0)
    judge = Judge(made.predictor("tare"), center, contact=ContactRule(200.0))
    judged = list(judge.follow(made.live_frames(whole)))
    expected = ContactRule(200.0, rest=center).lacks_contact(whole.tactile)
    assert [j.lacks_contact for j in judged] == expected.tolist()
    assert 0 < expected.sum() < len(expected)
    with pytest.raises(ValueError, match="readings without their noise"):
        Judge(made.predictor("tare"), center, contact=ContactRule())
    with pytest.raises(ValueError, match=r"'rest' must be a Rest.*\(got None\)"):
        Judge(made.predictor("frame"), contact=ContactRule(200.0))


@pytest.mark.parametrize("name", [*SINGLE, "window"])
def test_the_table_of_predict_says_what_the_predictor_says(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    whole = recording(1)
    write_recording(whole, "a.npz")
    made.predictor(name).save("a.predictor")
    _, on, free, frames, predictor = predicted(name, ContactRule(), whole)
    rest = ["--rest", str(NUM_REST / 25)]
    assert main(["predict", "a.predictor", "a.npz", *rest, "--contact", "--no-picture"]) == 0
    assert f"no contact {int(free.sum())}" in capsys.readouterr().out
    with open("predictions.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == frames
    assert [row["prediction"] for row in rows] == [
        ";".join(row) for row in predictor.labels(on, free)
    ]
    found = np.array([[float(row["p_ball"]), float(row["p_cube"])] for row in rows])
    np.testing.assert_allclose(found, on.numpy(), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_after_a_gap_a_window_has_only_new_frames():
    still = recording(0).tactile[:NUM_REST]
    whole = np.concatenate([still, still[:6] + 500, still[:20]])
    rule = ContactRule().measured(still)
    judge = Judge(made.predictor("window"), contact=rule)
    joint = np.zeros((len(whole), 2))
    frames = made.live_frames(
        Recording(time=np.arange(len(whole)) / 25, tactile=whole, joint=joint)
    )
    judged = {j.sequence: j for j in judge.follow(f for f in frames if not 36 <= f.sequence < 40)}
    assert [i for i, j in judged.items() if not j.lacks_contact] == [*range(30, 36)]
    assert min(i for i in judged if i >= 40) == 40 + made.LENGTH - 1


@pytest.mark.slow
def test_the_graph_is_compared_without_the_rule(tmp_path):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    from torch_geometric_tactile.predictor import export_onnx

    predictor = copy.deepcopy(made.predictor("frame"))
    predictor.contact = ContactRule(1e9, rest=np.zeros((11, 3)))  # nothing is ever contact
    assert export_onnx(predictor, tmp_path / "a.onnx").difference < 1e-5
    assert predictor.contact == ContactRule(1e9)


TRIALS = [("error", 90), ("pad", 90), ("pad", 60), ("crop_start", 30), ("crop_end", 40)]


@pytest.mark.parametrize(("ragged", "length"), TRIALS)
@pytest.mark.parametrize("touched", [2, 50, 85, None])
def test_a_trial_lacks_contact_if_all_that_is_cut_of_it_does(ragged, length, touched):
    cut = WindowCut(length, 0, ragged)
    predictor = copy.deepcopy(made.predictor("window"))
    predictor.preparation.window = cut
    tactile = np.zeros((90, 11, 3), np.float32)
    if touched is not None:
        tactile[touched] = 9
    predictor.contact = ContactRule(5.0, rest=np.zeros((11, 3)))
    whole = Recording(time=np.arange(90) / 25, tactile=tactile, joint=np.zeros((90, 2)))
    frames = range(90)
    if ragged.startswith("crop"):
        frames = frames[-length:] if ragged == "crop_start" else frames[:length]
    assert predictor.lacks_contact(whole).tolist() == [touched not in frames]


def test_a_recording_of_another_rate_is_asked_as_it_is_resampled():
    predictor = copy.deepcopy(made.predictor("window"))
    predictor.preparation.info = FrameInfo(rate=25.0)
    predictor.contact = ContactRule(200.0).measured(recording(0).tactile[:NUM_REST])
    whole = recording(0)
    fast = replace(whole, time=whole.time / 2)
    with pytest.raises(ValueError, match="resample it"):
        predictor.lacks_contact(fast)
    free = predictor.lacks_contact(fast, resample=True)
    probability = predictor.recording(fast, resample=True)
    assert probability[free].isnan().all()
    expected = predictor.lacks_contact(fast.resample(25.0))
    assert free.tolist() == expected.tolist()
    assert 0 < free.sum() < len(free) < 50


@pytest.mark.parametrize("name", [*SINGLE, "window"])
def test_readings_are_asked_as_recordings_are(name):
    whole = recording(2)
    *_, free, _, predictor = predicted(name, ContactRule(), whole)
    x, joint = whole.tactile, whole.joint
    if name == "window":
        x, joint = predictor.windows(whole)[0].x, joint[made.LENGTH - 1 :]
    assert predictor.lacks_contact(x).tolist() == free.tolist()
    assert predictor(x, joint)[free].isnan().all()
    assert predictor(x[0], joint[0]).isnan().all() == free[0]


def test_the_rule_of_a_predictor_is_checked_and_stays():
    predictor = copy.deepcopy(made.predictor("frame"))
    with pytest.raises(ValueError, match="'contact' must be a ContactRule or None"):
        predictor.contact = 5.0
    with pytest.raises(ValueError, match=r"'rest' of the contact rule must have shape \(11, 3\)"):
        predictor.contact = ContactRule(5.0, rest=np.zeros((11, 2)))
    predictor.contact = ContactRule(5.0)
    assert predictor.with_tare().contact == ContactRule(5.0)
    with pytest.raises(ValueError, match=r"'rest' must be the number of .* the contact rule"):
        predictor.adapt_recording(recording(0))
    with pytest.raises(ValueError, match="must have the readings at rest"):
        predictor.recording(recording(0))
    assert predictor.adapt(recording(0).tactile[:5], recording(0).joint[:5]) == 0
    assert predictor.contact.is_measured
    predictor.contact = None
    assert not predictor.lacks_contact(recording(0)).any()
    with pytest.raises(ValueError, match="measures sessions: 'adapt' is not needed"):
        predictor.adapt(recording(0).tactile[:5], recording(0).joint[:5])


def test_a_tare_tells_how_long_the_rest_is():
    whole = recording(1)
    predictor = copy.deepcopy(made.predictor("tare"))  # of the first 30 frames
    predictor.preparation.info = FrameInfo(rate=25.0)
    predictor.contact = ContactRule(200.0)
    predictor.adapt_recording(whole)
    expected = whole.tactile[:30].astype(np.float64).mean(axis=0)
    np.testing.assert_allclose(predictor.contact.rest, expected)


def test_labels_of_regressions_and_of_another_number_of_rows():
    network = Network(torch.nn.Identity(), ("a", "b"), "regression")
    numbers = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    assert network.labels(numbers, torch.tensor([False, True])) == [[], [NO_CONTACT]]
    with pytest.raises(ValueError, match="'lacks_contact' must have 2 rows"):
        network.labels(numbers, torch.tensor([False]))
    with pytest.raises(ValueError, match="a regression has no labels"):
        network.labels(numbers)
