"""The settings of a configuration beside those that a checkpoint was trained by."""

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch

from torch_geometric_tactile.training._checkpoint_file import compare_settings


def section(class_path="nets.Net", num_classes=2, label_smoothing=0.1, **init_args):
    arguments = {"width": 4, "sizes": [1, 2], "layout": "pad", **init_args}
    model = {"class_path": class_path, "init_args": arguments}
    return {"model": model, "num_classes": num_classes, "label_smoothing": label_smoothing}


@pytest.fixture
def path(tmp_path):
    torch.save({"state_dict": {}, "config": section()}, tmp_path / "a.ckpt")
    return tmp_path / "a.ckpt"


@pytest.mark.parametrize(
    "config",
    [
        section(),
        section(class_path="Net"),
        section(width="4e0", sizes=(1.0, 2)),  # numbers may be texts
        section(depth=3),
        section(layout="glove"),  # which is compared by its taxels, elsewhere
        {"optimizer": "Adam"},
    ],
)
def test_settings_of_the_same_model_pass(path, caplog, config):
    compare_settings(config, path)
    assert not caplog.text
    torch.save({"state_dict": {}, "config": config}, path)
    compare_settings(section(), path)


@pytest.mark.parametrize(
    ("config", "difference"),
    [
        (
            section("nets.Other", width=5),
            r"\('model.model' is Other here and Net in the checkpoint\)",
        ),
        (section(width=5), r"\('model.model.init_args.width' is 5 here and 4 in the checkpoint\)"),
        (
            section(sizes=[1, 3]),
            r"'model.model.init_args.sizes' is \[1, 3\] here and \[1, 2\] in the check",
        ),
        (section(num_classes=3), r"'model.num_classes' is 3 here and 2 in the checkpoint"),
    ],
)
def test_settings_of_another_model_are_an_error(path, config, difference):
    with pytest.raises(ValueError, match=rf"a\.ckpt' must match the model in .*{difference}"):
        compare_settings(config, path)


def test_settings_of_the_training_may_differ(path, caplog):
    compare_settings(section(label_smoothing=0.2), path)
    assert "'model.label_smoothing' is 0.2 here and 0.1 in the checkpoint" in caplog.text
    torch.save({"state_dict": {}, "config": None}, path)
    compare_settings(section(width=5), path)  # nothing is known of its model
