"""Windows and trials as samples of a comparison: what is cut, split, scaled and refused."""

import logging

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from moving import motions

from torch_geometric_tactile.data import Recording, StaticDataset, Trials, Windows
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._compared_models import MODELS, select_models
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._held_out import choice_parts
from torch_geometric_tactile.experiments.advice import to_dict
from torch_geometric_tactile.experiments.compared_windows import FrameCut, data_source, describe_cut
from torch_geometric_tactile.experiments.comparison import (
    ComparisonSettings,
    comparison_plan,
    summarize,
)
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.reports._compare import comparison_markdown
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import Resample, fit_transform

OF_FRAMES = {"temporal", "grasp_gcn", "lstm", "temporal_cnn", "svm_signal"}
POSED = {"posed_taxel_net", "posed_forest", "posed_ridge"}
LAYOUT = grid(3, 4, 0.005)


def plan(folder, cut=None, settings=None, selection=None, **changes):
    motions(folder / "a.npz", **changes)
    source = data_source(folder / "a.npz", grid="3x4", cut=cut)
    return comparison_plan(source, settings, selection=selection)


def numbered(num_trials=12, frames=40):
    """Readings that are the number of their frame."""
    number = np.arange(num_trials * frames, dtype=np.float32)
    return np.broadcast_to(number[:, None, None, None], (len(number), 3, 4, 2))


def names(found):
    return {cell.experiment for cell in found.table.cells}


def test_windows_of_a_file_are_compared(tmp_path):
    found = plan(tmp_path, FrameCut(window=12))
    assert (found.facts.num_samples, found.facts.num_frames) == (12 * 3, 12)
    assert names(found) == {model.name for model in MODELS} - POSED - {"bmf_cnn"}
    assert found.protocols[0].protocol.describe() == "5 folds by trial, stratified by y"
    frames = StaticDataset.from_arrays(**arrays(motions(tmp_path / "a.npz")), layout=LAYOUT)
    assert found.data.load().data.x.equal(Windows(frames, 12, 12).data.x)


def arrays(content):
    chosen = {key: torch.from_numpy(content[key]) for key in ("y", "trial", "time")}
    return {"x": torch.from_numpy(content["x"].reshape(-1, 12, 2)), **chosen}


def test_whole_trials_are_resampled(tmp_path):
    found = plan(tmp_path, FrameCut(trials=10))
    content = arrays(motions(tmp_path / "a.npz"))
    frames = StaticDataset.from_arrays(**content, layout=LAYOUT)
    expected = Trials(frames, ragged="pad", pre_transform=Resample(10))
    assert found.data.load().data.x.equal(expected.data.x)
    assert (found.facts.num_samples, found.facts.num_frames) == (12, 10)


def test_horizon_takes_the_label_ahead(tmp_path):
    y = np.tile(np.arange(40) // 20, 12)
    dataset = plan(tmp_path, FrameCut(window=10, horizon=5), y=y).data.load()
    assert dataset.column("y").view(12, 3).tolist() == [[0, 1, 1]] * 12
    last = plan(tmp_path, FrameCut(window=10), y=y).data.load()
    assert last.column("y").view(12, 4).tolist() == [[0, 0, 1, 1]] * 12


def test_models_say_what_they_need():
    frames = ComparedTask(LAYOUT, "accuracy", 100)
    windows = ComparedTask(LAYOUT, "accuracy", 100, num_frames=20, num_channels=2)
    assert not OF_FRAMES & {model.name for model in select_models(None, frames)}
    assert not POSED & {model.name for model in select_models(None, windows)}
    with pytest.raises(ValueError, match=r"got 'lstm', but the samples are single frames: cut win"):
        select_models(["lstm"], frames)
    with pytest.raises(ValueError, match=r"got 'posed_ridge', but it is for single frames"):
        select_models(["posed_ridge"], windows)


@pytest.mark.parametrize("num_frames", [2, 16, 60, 64, 65, 128, 129, 700])
def test_temporal_model_rests_on_all_frames(num_frames):
    task = ComparedTask(LAYOUT, "accuracy", 100, num_frames=num_frames)
    (model,) = select_models(["temporal"], task)
    arguments = model.to_cell(task).config["model"]["model"]["init_args"]
    reach = TemporalTaxelNet(LAYOUT, 2, **arguments).receptive_field
    assert max(64, num_frames) <= reach < 2 * max(64, num_frames)


def test_frames_of_a_window_have_one_scale(tmp_path):
    found = plan(tmp_path, FrameCut(window=20))
    dataset = found.data.load()
    task = ComparedTask.from_dataset(dataset, "accuracy", 60, num_frames=found.facts.num_frames)
    assert (task.num_frames, task.num_channels) == (20, 2)
    grown = dataset.data
    ramp, offset = torch.arange(20.0).repeat(2), torch.arange(24.0)[:, None, None]
    grown.x = ramp + offset * torch.ones(24, 12, 1)
    x = fit_transform(build_object(task.transform(scaled=True)), grown).x.view(24, 12, 2, 20)
    steps = x[..., 1:] - x[..., :-1]
    assert steps.allclose(steps[0, 0, 0, 0])  # the ramp is one: of every frame it would be gone
    assert steps[0, 0, 0, 0] > 0.05
    assert x.mean(dim=(0, 3)).abs().max() < 1e-5


@pytest.mark.parametrize("by", ["trial", "group"])
def test_no_frame_is_on_both_sides(tmp_path, by):
    settings = ComparisonSettings(models=("constant",), by=by, folds=3)
    group = np.arange(12).repeat(40) // 2
    cut = FrameCut(window=8, hop=3, horizon=4)
    found = plan(tmp_path, cut, settings, x=numbered(), group=group)
    for experiment in found.experiments:
        parts = choice_parts(experiment)
        seen = [set(part.data.x.long().view(-1).tolist()) for part in (parts.train, parts.test)]
        chosen = [set(part.data.x.long().view(-1).tolist()) for part in (parts.fit, parts.val)]
        assert all([*seen, *chosen])
        assert not seen[0] & seen[1]
        assert not chosen[0] & chosen[1]
        trials = [set(part.column("trial").tolist()) for part in (parts.train, parts.test)]
        assert not trials[0] & trials[1]


def test_windows_that_do_not_overlap_may_be_split_one_by_one(tmp_path, caplog):
    settings = ComparisonSettings(models=("constant",), by="frame", folds=3)
    with caplog.at_level(logging.WARNING):
        found = plan(tmp_path, FrameCut(window=10), settings, x=numbered())
    assert "windows are split one by one" in caplog.text
    train, test = found.data.parts(found.protocols[0].protocol, 0, 0)
    seen = [set(part.data.x.long().view(-1).tolist()) for part in (train, test)]
    assert not seen[0] & seen[1]


REST = {"key": "trial", "first": 4}


@pytest.mark.parametrize("cut", [FrameCut(window=12, hop=5), FrameCut(trials=15)])
def test_rest_is_subtracted_before_cutting(tmp_path, cut):
    offset = np.arange(12).repeat(40)[:, None, None, None] * np.ones((1, 3, 4, 2))
    content = motions(tmp_path / "b.npz")
    settings = ComparisonSettings(tare=REST)
    found = plan(tmp_path, cut, settings, x=content["x"] + 100 * offset)
    tared = content["x"].reshape(12, 40, 3, 4, 2)
    tared = tared - tared[:, :4].mean(axis=1, keepdims=True)
    expected = plan(tmp_path, cut, x=tared.reshape(-1, 3, 4, 2)).data.load().data.x
    assert found.data.load().data.x.allclose(expected, atol=1e-3)
    batch = found.data.load().batch(torch.tensor([3])).x
    assert batch.allclose(expected[3:4], atol=1e-3)
    steps = [
        step["class_path"] for step in found.experiments[0].transform["init_args"]["transforms"]
    ]
    assert not any(step.endswith("Tare") for step in steps)
    assert "the reading at rest of each trial was subtracted first" in describe_cut(found.data)


def folder(path, frames=40):
    """Recordings whose readings are the number of their frame, with two objects."""
    for i, name in enumerate(f"{kind}_{k:03}" for kind in ("cup", "mug") for k in range(4)):
        tactile = np.full((frames, 12, 1), 0.0) + np.arange(frames)[:, None, None] + 1000 * i
        write_npz(Recording(time=np.arange(frames) / 100, tactile=tactile), path / f"{name}.npz")


def test_stride_chooses_the_frames_of_windows(tmp_path):
    folder(tmp_path)
    source = data_source(tmp_path, grid="3x4", cut=FrameCut(window=5))
    settings = ComparisonSettings(models=("constant",), folds=3)
    found = comparison_plan(source, settings, selection={"stride": 4})
    dataset = found.data.load()
    assert len(dataset) == 8 * 2
    assert dataset.data.x[1, 0].tolist() == [20, 24, 28, 32, 36]
    assert found.facts.class_names == ("cup", "mug")
    whole = comparison_plan(source, settings)
    held = [plan.data.parts(plan.protocols[0].protocol, 0, 1)[1] for plan in (found, whole)]
    trials = [set(part.column("trial").tolist()) for part in held]
    assert trials[0] == trials[1]


def test_arguments_reach_the_frames(tmp_path):
    folder(tmp_path)
    cut = FrameCut(window=5)
    source = data_source(tmp_path, grid="3x4", arguments={"stride": 8}, cut=cut)
    assert source.load().data.x[0, 0].tolist() == [0, 8, 16, 24, 32]
    assert source.with_arguments({"stride": 2}).load().data.x[0, 0].tolist() == [0, 2, 4, 6, 8]
    chosen = data_source(tmp_path, grid="3x4").with_arguments({}, {"stride": 4})
    assert cut.cut(chosen).load().data.x[0, 0].tolist() == [0, 4, 8, 12, 16]


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({}, r"one of 'window' and 'trials' must be given \(got none\)"),
        ({"window": 20, "trials": 60}, r"only one of 'window' and 'trials' .* \(got 20 and 60\)"),
        ({"hop": 5}, r"'hop' must come with 'window', .* \(got 5 without\)"),
        ({"horizon": 5, "trials": 60}, r"'horizon' must come with 'window', .* \(got 5 without\)"),
        ({"window": 1}, r"'window' must be at least 2 \(got 1\)"),
        ({"trials": 1}, r"'trials' must be at least 2 \(got 1\)"),
        ({"window": 5, "hop": 0}, r"'hop' must be at least 1 \(got 0\)"),
        ({"window": 5, "horizon": 0}, r"'horizon' must be at least 1 \(got 0\)"),
    ],
)
def test_wrong_cuts_are_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        FrameCut(**arguments)


PARTS = np.tile(np.repeat([0, 2], 20), 12)
GROUPS = np.arange(12 * 40) // 140  # another one in the middle of trial 3


@pytest.mark.parametrize(
    ("cut", "settings", "changes", "match"),
    [
        (
            {"window": 41},
            {},
            {},
            r"at most 40 frames, the length of the longest trial, .* \(got 41\)",
        ),
        (
            {"window": 30, "horizon": 11},
            {},
            {},
            r"'horizon' must be within the trial of at least one window \(got 11",
        ),
        ({"window": 5}, {}, {"trial": None}, "'dataset' must have a 'trial' for each frame"),
        ({"trials": 9}, {}, {"trial": None}, "'dataset' must have a 'trial' for each frame"),
        ({"trials": 9}, {}, {"y": np.tile(np.arange(40) % 2, 12)}, "'y' must be the same in all f"),
        ({"window": 9, "hop": 8}, {"by": "frame"}, {}, r"'by' must be 'trial' .* at least 9"),
        (
            {"window": 9, "horizon": 2},
            {"by": "frame"},
            {},
            r"windows and the frames of their labels overlap .* at least 11",
        ),
        ({"window": 9}, {"by": "given"}, {"part": PARTS}, r"'part' must be the same in all frames"),
        ({"window": 9}, {"by": "group"}, {"group": GROUPS}, r"'group' must be .* in trial 3\)"),
        ({"window": 9}, {"tare": {"key": "session"}}, {}, r"'tare' must be of each trial"),
        ({"window": 9}, {"models": ("posed_forest",)}, {}, r"got 'posed_forest', but it is for si"),
        (None, {"models": ("temporal",)}, {}, r"got 'temporal', but the samples are single frames"),
    ],
)
def test_data_that_cannot_be_cut_is_refused(tmp_path, cut, settings, changes, match):
    with pytest.raises(ValueError, match=match):
        plan(tmp_path, cut and FrameCut(**cut), ComparisonSettings(**settings), **changes)


class ReadyWindows(StaticDataset):
    """Windows that somebody else cut."""

    def __init__(self):
        self.layout = LAYOUT
        super().__init__(None)

    def read(self):
        from torch_geometric_tactile.data import StaticData

        y = torch.arange(12) % 2
        x = torch.rand(12, 12, 8)
        return StaticData(x=x, y=y, trial=torch.arange(12), num_frames=4), {}


def test_windows_of_another_class_are_compared_but_not_tared():
    source = DataSource(f"{__name__}.ReadyWindows")
    found = comparison_plan(source)
    assert (found.facts.num_frames, describe_cut(found.data)) == (4, "")
    assert names(found) >= OF_FRAMES
    with pytest.raises(ValueError, match="'tare' must be left out for samples of several frames"):
        comparison_plan(source, ComparisonSettings(tare=REST))


def test_windows_of_an_object_are_not_tared_without_their_frames():
    source = DataSource("torch_geometric_tactile.data.Windows", {"dataset": None, "length": 3})
    with pytest.raises(ValueError, match="unless the source has the 'dataset'"):
        comparison_plan(source, ComparisonSettings(tare=REST))


def test_place_of_the_file_is_no_part_of_a_result(tmp_path):
    codes = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        found = plan(tmp_path / name, FrameCut(window=9), ComparisonSettings(tare=REST))
        codes.append({experiment.code for experiment in found.experiments})
    assert codes[0] == codes[1]
    other = plan(tmp_path / "one", FrameCut(window=9, hop=8), ComparisonSettings(tare=REST))
    assert not {experiment.code for experiment in other.experiments} & codes[0]


@pytest.mark.parametrize(
    ("cut", "text"),
    [
        (None, ""),
        ({"window": 9}, "A sample is a window of 9 frames, without overlap, with the label of"),
        (
            {"window": 9, "hop": 2, "horizon": 3},
            "one every 2 frames, with the label of the frame 3 frames after",
        ),
        ({"trials": 20}, "A sample is a whole trial, resampled to 20 frames."),
    ],
)
def test_page_says_what_a_sample_is(tmp_path, cut, text):
    found = plan(tmp_path, cut and FrameCut(**cut))
    comparison = summarize(PlanRun(found, [], 0, {}, len(found.experiments)))
    page = comparison_markdown(comparison)
    assert text in page
    assert ("temporal, lstm, temporal_cnn and minirocket process the frames" in page) == (
        cut is not None
    )
    assert to_dict(comparison)["data"]["num_frames"] == (cut and (cut.get("trials") or 9))


def test_what_is_left_out_is_said_once_and_on_the_page(tmp_path, caplog):
    content = motions(tmp_path / "a.npz")
    kept = (content["trial"] != 5) | (np.arange(len(content["y"])) % 40 < 9)
    shorter = {key: value[kept] for key, value in content.items()}
    with caplog.at_level(logging.WARNING):
        found = plan(tmp_path, FrameCut(window=20, horizon=15), **shorter)
    assert caplog.text.count("1 of 12 trials are left out") == 1
    comparison = summarize(PlanRun(found, [], 0, {}, len(found.experiments)))
    assert (
        "Left out: trials shorter than a window: 1; windows whose label lies beyond the end of "
        "their trial: 11."
    ) in comparison_markdown(comparison)
