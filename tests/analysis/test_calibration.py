"""The fit recovers what is known, and its errors are those of recordings that had no part in it."""

import numpy as np
import pytest
import torch
from sklearn.linear_model import Ridge

from torch_geometric_tactile.analysis import fit_calibration
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.sim import SkinModel
from torch_geometric_tactile.transforms import Calibrate

LAYOUT = grid(2, 2, pitch=0.005)
REST, FRAMES = 10, 40
PART = np.repeat([0, 1, 2], REST + LAYOUT.num_taxels * FRAMES)
LOCAL = {"spread": 0.0, "lag": 0.0}


def pressed(seed, **parts):
    """Readings less those at rest, and forces in newtons: a probe presses one taxel after another;
    what it does to the others is not measured."""
    draw = np.random.default_rng(seed)
    force = np.zeros((REST + LAYOUT.num_taxels * FRAMES, LAYOUT.num_taxels, 3))
    known = np.full(force.shape, np.nan)
    for taxel in range(LAYOUT.num_taxels):
        rows = slice(REST + taxel * FRAMES, REST + (taxel + 1) * FRAMES)
        shear, pressure = draw.uniform(-1.5, 1.5, (FRAMES, 2)), draw.uniform(0, 4, (FRAMES, 1))
        force[rows, taxel] = known[rows, taxel] = np.hstack([shear, pressure])
    time = 0.05 * np.arange(len(force))
    x = SkinModel(**LOCAL, **parts).readings(force, time, LAYOUT, draw)
    return x - x[:REST].mean(axis=0), known


def three_runs(**parts):
    x, force = zip(*(pressed(seed, **parts) for seed in range(3)), strict=True)
    return np.concatenate(x), np.concatenate(force), PART


def linear(num_frames=60, noise=0.0, parts=3):
    draw = torch.Generator().manual_seed(0)
    x = torch.randn(num_frames, 2, 3, generator=draw, dtype=torch.double)
    force = (x * torch.tensor([[1.0, 2.0, 3.0], [0.0, -1.0, 5.0]])).sum(dim=(1, 2)) + 7
    force += noise * torch.randn(num_frames, generator=draw)
    return x, force, torch.arange(num_frames) * parts // num_frames


def test_cross_axis_matrix_of_a_simulated_skin_is_recovered():
    unlimited = {"saturation": (np.inf,) * 3}
    fit = fit_calibration(*three_runs(**unlimited), per="taxel")
    assert fit.degrees == (1, 1, 1)
    assert fit.rmse.max() < 0.012  # newtons, of forces that deviate by
    assert fit.deviation.min() > 0.8
    calibrate = fit.calibrate
    assert repr(calibrate).startswith("Calibrate(3 -> 3, num_taxels=4, degree=1, per='taxel'")
    half = (calibrate.high - calibrate.low) / 2
    found = (calibrate.coefficients[:, 1:] / half.unsqueeze(-1)).numpy()
    quiet = SkinModel(**LOCAL, **unlimited, drift=0, noise=0, quantize=False)
    press = np.zeros((4, 4, 3))
    press[1:] = np.eye(3)[:, None]
    counts = quiet.readings(press, np.arange(4.0), LAYOUT)
    mixed = np.linalg.inv((counts[1:] - counts[0]).transpose(1, 0, 2))  # newtons a count
    assert np.abs(found - mixed).max() < 0.005 * np.abs(mixed).max()


def test_curves_of_a_skin_that_saturates_are_fitted():
    data = three_runs()
    fit = fit_calibration(*data, per="taxel")
    straight = fit_calibration(*data, per="taxel", degrees=[1])
    assert fit.calibrate.degree == 3
    assert fit.rmse[:, 2].max() < 0.009
    assert straight.rmse[:, 2].min() > 0.02


def test_calibration_does_what_its_errors_say():
    # Fitted by scikit-learn on what is left, with the one setting that there is.
    x, force, part = linear(noise=1.0)
    fit = fit_calibration(x, force, part, degrees=[1], strengths=[0.5])
    for number in range(3):
        rest = part != number
        low, high = x[rest].amin(0), x[rest].amax(0)
        z = ((2 * x - low - high) / (high - low)).flatten(1).numpy()
        guess = Ridge(0.5).fit(z[rest], force[rest]).predict(z[~rest])
        expected = np.sqrt(np.square(guess - force[~rest].numpy()).mean())
        assert fit.rmse[number].item() == pytest.approx(expected)
    z = ((2 * x - x.amin(0) - x.amax(0)) / (x.amax(0) - x.amin(0))).flatten(1).numpy()
    expected = Ridge(0.5).fit(z, force).predict(z)
    found = fit.calibrate(StaticData(x=x)).force[:, 0]
    np.testing.assert_allclose(found, expected)
    assert fit.calibrate.low.equal(x.amin(0))
    assert fit.calibrate.high.equal(x.amax(0))
    assert f"left out: {fit.rmse[0].item():.4g}, " in fit.calibrate.source


@pytest.mark.parametrize("parts", [2, 3, 4])
def test_what_is_left_out_has_no_part_in_the_choice(parts):
    # If the guess stays, squares of the error to force + g and force - g add up.
    x, force, part = linear(num_frames=80, noise=0.5, parts=parts)
    g = torch.where(part == parts - 1, 10 * x[:, 0, 0] ** 3, 0)
    fits = [fit_calibration(x, force + sign * g, part) for sign in (0, 1, -1)]
    same, more, less = (fit.rmse[-1, 0].item() ** 2 for fit in fits)
    size = g[part == parts - 1].square().mean().item()
    assert more + less == pytest.approx(2 * same + 2 * size, rel=1e-9)
    assert {fit.degrees[-1] for fit in fits} == {1}


def test_forces_that_were_not_measured_do_not_count():
    x, force, part = linear(noise=0.5)
    masked = torch.where(torch.arange(60) % 2 == 0, force, torch.nan)
    found, expected = (
        fit_calibration(x, masked, part),
        fit_calibration(x[::2], force[::2], part[::2]),
    )
    assert found.rmse.equal(expected.rmse)
    assert found.num_forces == 30
    assert found.calibrate.to_dict() == expected.calibrate.to_dict()
    x[4, 1, 2] = torch.nan  # nor those that follow from a missing reading
    assert fit_calibration(x, masked, part).num_forces == 29


def test_order_of_frames_among_recordings_does_not_matter():
    x, force, part = linear(noise=0.5, parts=2)
    order = torch.arange(60).view(2, 30).T.flatten()  # recordings in turn
    first = fit_calibration(x, force, part)
    second = fit_calibration(x[order], force[order], part[order])
    torch.testing.assert_close(first.rmse, second.rmse)
    assert first.degrees == second.degrees


def test_share_beyond_the_range_of_the_others():
    x, force, part = linear()
    x = x.clamp(-1, 1)
    x[part == 2, 0, 0] *= 5
    fit = fit_calibration(x, force, part, degrees=[1])
    share = (x[part == 2, 0, 0].abs() > 1).double().mean()
    assert fit.beyond.tolist() == [0.0, 0.0, share.item()]
    assert share > 0.3


def test_several_forces_of_one_sensor():
    x, force, part = linear()
    fit = fit_calibration(x, torch.stack([force, -2 * force], dim=1), part, degrees=[1])
    assert fit.rmse.shape == fit.deviation.shape == (3, 2)
    torch.testing.assert_close(fit.deviation[:, 1], 2 * fit.deviation[:, 0])
    found = fit.calibrate(StaticData(x=x)).force
    torch.testing.assert_close(found, torch.stack([force, -2 * force], dim=1), rtol=0, atol=1e-3)


def test_degrees_with_too_many_terms_are_passed_over():
    x = torch.rand(6, 600, 3)
    fit = fit_calibration(x, x.sum(dim=(1, 2)), torch.arange(6) // 2, strengths=[1.0])
    assert fit.calibrate.degree < 3
    with pytest.raises(ValueError, match=r"'degrees' must yield at most 10000 terms \(got \{3: 12"):
        fit_calibration(x, x.sum(dim=(1, 2)), torch.arange(6) // 2, degrees=[3])


def test_bad_input():
    x, force, part = linear()
    with pytest.raises(ValueError, match=r"at least two recordings, .*\(got 1\)"):
        fit_calibration(x, force, torch.zeros(60))
    with pytest.raises(ValueError, match=r"measured in each recording \(got none in 1\)"):
        fit_calibration(x, torch.where(part == 1, torch.nan, force), part)
    with pytest.raises(ValueError, match=r"'force' must have shape \(60, 'num_forces'\), per se"):
        fit_calibration(x, force[1:], part)
    with pytest.raises(ValueError, match=r"'force' must have shape \(60, 2, 'num_forces'\), per t"):
        fit_calibration(x, force, part, per="taxel")
    with pytest.raises(ValueError, match="'force' must be finite, or NaN"):
        fit_calibration(x, force / 0, part)
    with pytest.raises(ValueError, match=r"'x' must have shape"):
        fit_calibration(x[:, 0], force, part)
    with pytest.raises(ValueError, match="'recording' must have a number per frame"):
        fit_calibration(x, force, part[1:])
    with pytest.raises(ValueError, match="'per' must be 'taxel' or 'sensor'"):
        fit_calibration(x, force, part, per="hand")
    of_taxels = torch.full((60, 2, 1), torch.nan, dtype=torch.double)
    of_taxels[:, 0, 0] = force
    of_taxels[part == 0, 1, 0] = force[part == 0]
    with pytest.raises(ValueError, match=r"at least two recordings, .* fewer on taxel 1\)"):
        fit_calibration(x, of_taxels, part, per="taxel")


# What ridge regression had in an independent check, in the unit of the file: of readings as they
# are and quadratic, whichever is less for a run.
EFLESH = {"normal_force": (170, 45, 45), "shear_force": (79, 67)}


@pytest.mark.full
@pytest.mark.parametrize("kind", EFLESH)
def test_published_runs_are_no_worse_than_ridge(kind, eflesh_probe):
    runs = [read_recording(folder) for folder in sorted((eflesh_probe / kind).iterdir())]
    x = np.concatenate([run.tactile for run in runs])
    force = np.concatenate([run.extra["force"] for run in runs])
    part = np.repeat(np.arange(len(runs)), [run.num_frames for run in runs])
    units = ("unit of the file", "unit of the file")
    fit = fit_calibration(x, force, part, units=units)
    assert fit.rmse[:, 0].lt(torch.tensor(EFLESH[kind])).all(), fit.rmse
    assert fit.calibrate.units == units
    # Frames at random would say that it is better than it is.
    mixed = np.random.default_rng(0).permutation(part)
    flattered = fit_calibration(x, force, mixed, degrees=[3], strengths=[fit.strength])
    assert flattered.rmse.mean() < 0.75 * fit.rmse.mean()


def test_calibration_is_built_of_what_was_fitted():
    fit = fit_calibration(*linear(), source="presses")
    assert isinstance(fit.calibrate, Calibrate)
    assert fit.calibrate.source.startswith("presses; ridge of strength ")
