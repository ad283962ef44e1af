"""Settings in words: no import path, no braces, and each unlike the others of its model."""

import re
from dataclasses import replace

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from compared import touches

from torch_geometric_tactile.experiments import comparison as comparing
from torch_geometric_tactile.experiments._compared_models import MODELS
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._setting_words import describe_setting
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings
from torch_geometric_tactile.reports._compare import comparison_markdown
from torch_geometric_tactile.sensors import grid

TASKS = {
    "frames": ComparedTask(grid(8, 8, 0.004), "accuracy", 500, num_channels=3),
    "windows": ComparedTask(grid(8, 8, 0.004), "accuracy", 500, num_frames=20, num_channels=3),
    "large": ComparedTask(grid(30, 40, 0.004), "accuracy", 200, tare={"by": "trial", "first": 5}),
    "numbers": ComparedTask(grid(4, 4, 0.004), "mae", 500),
}
_NO_WORDS = re.compile(r"[{}\[\]'\"_]|[A-Za-z]\.[A-Za-z]|[a-z][A-Z]|: ")


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_settings_of_all_models_are_words_and_differ(model, task):
    cell = model.to_cell(task)
    default = cell.transform
    if cell.config is not None and "data" in cell.config:
        default = cell.config["data"]["transform"]
    texts = [describe_setting(setting, default) for setting in cell.choice.settings]
    assert len(set(texts)) == len(texts) > 0
    for text in texts:
        assert text == text.strip()
        assert not _NO_WORDS.search(text), text


def step(name, **arguments):
    return {"class_path": f"torch_geometric_tactile.transforms.{name}", "init_args": arguments}


def chain(*steps):
    return {"class_path": "torch_geometric.transforms.Compose", "init_args": {"transforms": steps}}


SCALED = step("ZScore", scale_per="channel", with_mean=False)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({}, "the default"),
        ({"init_args": {}}, "the default"),
        ({"init_args": {"C": 10.0}}, "C = 10"),
        ({"init_args": {"C": 0.001, "width": 3.0}}, "C = 0.001, kernel width 3"),
        ({"model": {"init_args": {"taxel_dropout": 0.0}}}, "taxel dropout 0"),
        (
            {
                "optimizer": {"init_args": {"weight_decay": 0.1}},
                "model": {"init_args": {"dropout": 0.5}},
            },
            "weight decay 0.1, dropout 0.5",
        ),
        ({"transform": chain(step("SquareRoot"), SCALED)}, "square roots of the readings"),
        (
            {"init_args": {"C": 10.0}, "transform": chain(step("NormalizeRMS"), SCALED)},
            "C = 10, readings divided by their RMS",
        ),
        (
            {"transform": chain(step("ZScore", scale_per="channel"))},
            "mean of the training part subtracted",
        ),
        ({"transform": chain()}, "without scaling"),
        ({"model": {"init_args": {"pool": "mean"}}}, "the mean over the frames"),
        ({"model": {"init_args": {"max_taxels": 16}}}, "convolutions down to 16 taxels"),
        ({"train_transform": step("RandomShift", rows=2)}, "random shifts (rows 2)"),
        ({"data": {"train_transform": step("RandomNoise", std=0.1)}}, "random noise (std 0.1)"),
        ({"class_path": "my_nets.MyNet2D", "init_args": {"widths": [16, 32]}}, None),
        ({"model": {"init_args": {"act": "torch.nn.ReLU", "bias": True, "norm": None}}}, None),
    ],
)
def test_settings_in_words(setting, words):
    text = describe_setting(setting, chain(SCALED))
    assert not _NO_WORDS.search(text)
    if words is not None:
        assert text == words


def test_page_of_a_comparison_says_how_often_each_was_chosen(tmp_path):
    touches(tmp_path / "a.npz")
    settings = ComparisonSettings(models=("svm_rbf", "constant"), folds=3)
    source = data_source(tmp_path / "a.npz", grid="3x4")
    comparison = comparing.compare(source, settings, tmp_path / "out")
    tried = comparison.run.plan.experiments[0].choice.settings
    svm, constant = comparison.results
    chosen = tuple({"setting": tried[number]} for number in (0, -1, -1))
    page = comparison_markdown(replace(comparison, results=(replace(svm, chosen=chosen), constant)))
    both = "C = 1, kernel width 1; C = 10, kernel width 1, readings divided by their RMS (2 x)"
    assert f"| {both} |" in page
    assert "| the default (3 x) |" in page
