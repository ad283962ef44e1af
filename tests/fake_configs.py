"""Configurations of short, quiet trainings on generated readings."""

SCALED = {"class_path": "torch_geometric_tactile.transforms.SessionZScore"}


def fake_dataset(num_samples, **more):
    """The section of a generated data set, joined with two neighbours each."""
    return {
        "class_path": "torch_geometric_tactile.datasets.FakeTactileDataset",
        "init_args": {
            "num_samples": num_samples,
            **more,
            "pre_transform": {
                "class_path": "torch_geometric_tactile.transforms.KNNGraph",
                "init_args": {"k": 2},
            },
        },
    }


def fake_config(model, num_samples, *, epochs=1, is_logged=False, **data):
    """A configuration that trains one of our models for an epoch, without a folder of the run
    unless it is logged."""
    return {
        "model": {"model": {"class_path": f"torch_geometric_tactile.nn.models.{model}"}},
        "data": {"dataset": fake_dataset(num_samples), **data},
        "trainer": {
            "max_epochs": epochs,
            "accelerator": "cpu",
            "enable_progress_bar": False,
            "enable_model_summary": False,
            **({} if is_logged else {"logger": False}),
        },
    }
