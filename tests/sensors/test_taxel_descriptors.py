"""Descriptors of what a layout feels, by hand and by what they must not depend on."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import skew

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    descriptor_names,
    grid,
    icub_hand,
    taxel_descriptors,
)

PAD = grid(6, 8, 0.004)


def described(x, layout=PAD, **kwargs):
    found = taxel_descriptors(x, layout, **kwargs)
    names = descriptor_names(layout)
    assert found.shape[-1] == len(names) * x.shape[-1]
    return dict(zip(names, found[..., : len(names)].unbind(-1), strict=True))


@pytest.fixture
def x():
    return torch.randn(3, 48, 1, generator=torch.Generator().manual_seed(0))


def test_statistics_are_those_of_numpy(x):
    found, values = described(x), x[..., 0].double().numpy()
    expected = {
        "mean": values.mean(axis=1),
        "deviation": values.std(axis=1),
        "largest": np.abs(values).max(axis=1),
        "skewness": skew(values, axis=1),
        "area_0.5": (values > 0.5).mean(axis=1),
    }
    for percent in (2, 10, 25, 50, 75, 90, 98):
        expected[f"quantile_{percent}"] = np.percentile(values, percent, axis=1)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_places_are_weighted_by_the_readings(x):
    found = described(x)
    place = PAD.pos.double() - (PAD.pos.amax(dim=0) + PAD.pos.amin(dim=0)).double() / 2
    place = place / place.abs().max()  # the longer side of the pad goes from -1 to 1
    weight = x[0, :, 0].double().abs()
    centre = (weight @ place) / weight.sum()
    off = place - centre
    moments = (off.t() * weight) @ off / weight.sum()
    for axis, letter in enumerate("xyz"):
        assert float(found[f"centroid_{letter}"][0]) == pytest.approx(float(centre[axis]), abs=1e-5)
    assert float(found["moment_xy"][0]) == pytest.approx(float(moments[0, 1]), abs=1e-5)
    sizes = torch.linalg.eigvalsh(moments).flip(0)
    for i, size in enumerate(sizes.tolist()):
        assert float(found[f"extent_{i + 1}"][0]) == pytest.approx(size, abs=1e-5)


def test_a_flat_layout_has_no_third_extent():
    names = descriptor_names(grid(3, 4, pitch=0.01))
    found = taxel_descriptors(torch.randn(50, 12, 1), grid(3, 4, pitch=0.01))
    assert found[:, names.index("extent_3")].tolist() == [0.0] * 50  # no rounding errors
    assert (found[:, names.index("extent_2")] > 1e-3).all()


def test_contact_of_one_taxel_and_of_all():
    one = torch.zeros(48, 1)
    one[20] = 2.0
    spot, flat = described(one), described(torch.full((48, 1), 2.0))
    assert float(spot["area_1"]) == pytest.approx(1 / 48)
    assert float(flat["area_1"]) == 1
    assert float(spot["contrast_largest"]) == 2
    assert float(flat["contrast_largest"]) == float(flat["contrast_mean"]) == 0
    assert float(spot["contrast_correlation"]) < 0.3
    assert all(math.isfinite(value) for value in [*map(float, flat.values())])


def test_a_slope_rises_in_its_direction():
    place = PAD.axes()[0, :2] @ PAD.pos.t()
    for angle in (0, 45, 90, 225):
        turn = math.radians(angle)
        ramp = math.cos(turn) * place[0] + math.sin(turn) * place[1]
        rises = {
            name.rpartition("_")[2]: float(value)
            for name, value in described(100 * ramp.unsqueeze(1)).items()
            if name.startswith("slope_whole")
        }
        assert max(rises, key=rises.get) == str(angle)
        assert rises[str((angle + 180) % 360)] == 0
        assert sum(value**4 for value in rises.values()) == pytest.approx(1, abs=1e-5)


def test_slopes_depend_on_no_scale_and_no_offset(x):
    found, other = described(x), described(7 * x + 3)
    for name, value in found.items():
        if name.startswith("slope"):
            torch.testing.assert_close(other[name], value, atol=1e-4, rtol=1e-4)


def test_cells_follow_patches_digits_and_size():
    hand = descriptor_names(allegro_uskin())
    assert sum(name.startswith("mean_cell") for name in hand) == len(allegro_uskin().patch_names)
    assert sum(name.startswith("slope_part") for name in hand) == 8 * 5  # four fingers and a palm
    assert sum(name.startswith("mean_cell") for name in descriptor_names(biotac_sp())) == 9
    tips = descriptor_names(icub_hand())
    assert sum(name.startswith("mean_cell") for name in tips) == 10  # two of each fingertip
    few = TaxelLayout("few", pos=torch.rand(3, 3, generator=torch.Generator().manual_seed(0)))
    assert sum(name.startswith("mean_cell") for name in descriptor_names(few)) == 3


def test_a_patch_is_its_own_cell():
    layout = allegro_uskin()
    x = torch.zeros(384, 1)
    x[layout.patch == 4] = 1.0
    found = described(x, layout)
    means = [float(value) for name, value in found.items() if name.startswith("mean_cell")]
    assert sorted(means) == [0.0] * (len(means) - 1) + [1.0]


@pytest.mark.parametrize("layout", [PAD, biotac_sp(), allegro_uskin()], ids=lambda one: one.name)
def test_missing_readings_count_as_their_neighbours(layout):
    x = torch.rand(4, layout.num_taxels, 2, generator=torch.Generator().manual_seed(0))
    whole = taxel_descriptors(x, layout)
    x[0, 5] = torch.nan
    x[1, ::2, 0] = torch.nan
    x[2] = torch.nan
    found = taxel_descriptors(x, layout)
    assert found.isfinite().all()
    assert found[3].equal(whole[3])
    assert float((found[0] - whole[0]).abs().median()) < 0.05


def test_one_taxel_and_one_sample():
    spot = TaxelLayout("spot", pos=torch.zeros(1, 3))
    assert taxel_descriptors(torch.ones(1, 2), spot).isfinite().all()
    x = torch.rand(5, 48, 2, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(taxel_descriptors(x[3], PAD), taxel_descriptors(x, PAD)[3])


def test_posed_taxels_move_the_centroid(x):
    moved = PAD.pos + torch.tensor([0.01, 0.0, 0.02])
    found, still = described(x, pos=moved), described(x)
    side = float((PAD.pos.amax(dim=0) - PAD.pos.amin(dim=0)).max())
    for letter, step in (("x", 0.01), ("y", 0.0), ("z", 0.02)):
        name = f"centroid_{letter}"
        torch.testing.assert_close(found[name], still[name] + 2 * step / side, atol=1e-4, rtol=0)
    torch.testing.assert_close(found["moment_xx"], still["moment_xx"], atol=1e-4, rtol=0)


def test_other_taxels_are_refused():
    with pytest.raises(ValueError, match=r"'x' must have shape \(48, .*layout 'grid_6x8'.*\(9, 1"):
        taxel_descriptors(torch.zeros(9, 1), PAD)


def test_precision_is_that_of_the_readings(x):
    found = taxel_descriptors(x.double(), PAD)
    assert found.dtype == torch.double
    torch.testing.assert_close(found.float(), taxel_descriptors(x, PAD), atol=1e-4, rtol=1e-4)
    assert taxel_descriptors((10 * x).int(), PAD).dtype == torch.float
