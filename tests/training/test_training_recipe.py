import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.training import training_recipe


@pytest.mark.parametrize(
    ("num_samples", "batch_size", "max_epochs"),
    [(1, 16, 60), (191, 16, 60), (600, 25, 60), (3200, 64, 30), (4000, 64, 24), (10**6, 64, 15)],
)
def test_training_recipe(num_samples, batch_size, max_epochs):
    recipe = training_recipe(num_samples)
    assert recipe == (batch_size, max_epochs, 4e-3, 0.03, 0.1)


def test_training_recipe_bad_number():
    with pytest.raises(ValueError, match=r"'num_samples' must be at least 1 \(got 0\)"):
        training_recipe(0)
