import numpy as np
import pytest

from torch_geometric_tactile.sensors import biotac, grid
from torch_geometric_tactile.sim import BioTacModel, vibration

PLACE = np.array([-6.0, 0.0, -7.0]) / 1000  # m, in the middle of the pad


def response(model=None, normal=4.0, shear=(0.0, 0.0), place=PLACE, curvature=0.0):
    force = np.zeros((1, 3, 3))
    force[0, 0] = *shear, normal
    pressed = np.array([[normal, 0.0, 0.0]])
    places = np.broadcast_to(place, (1, 3, 3))
    return (model or BioTacModel()).response(force, pressed, places, biotac(), curvature)[0, :, 0]


def read(model, response, normal, seed=0, session=0):
    offsets = model.session(biotac(), np.random.default_rng(session))
    time = np.arange(len(response)) / 100
    return offsets, model.readings(response, normal, time, offsets, np.random.default_rng(seed))


def test_untouched_fingertip_rests_within_noise():
    model = BioTacModel(drift=0.0)
    assert np.all(response(normal=0.0) == 0)
    offsets, readings = read(model, np.zeros((400, 19, 3)), np.zeros((400, 3)))
    error = readings.tactile - offsets.offset
    assert np.abs(error.mean(axis=0)).max() < 5 * model.noise / 20
    assert error.std() == pytest.approx(model.noise, rel=0.05)
    assert np.array_equal(readings.tactile, readings.tactile.round())


def test_more_force_changes_more_until_it_saturates():
    model = BioTacModel()
    largest = [np.abs(response(normal=force)).max() for force in (1, 2, 4, 8, 16, 32)]
    assert np.all(np.diff(largest) > 0)
    assert response(normal=1e4).max() <= model.saturation
    assert largest[5] - largest[4] < 0.6 * (largest[4] - largest[3]) * 2


def test_near_electrodes_fall_and_far_ones_rise():
    change = response()
    pos = biotac().pos.numpy()
    far = ((pos - PLACE) ** 2).sum(axis=1).argsort()
    assert change[far[0]] > 100
    assert change[far[-1]] < 0
    assert change.argmax() in far[:3]


def test_shear_drags_the_pattern():
    x = biotac().pos[:, 0].numpy()

    def middle(shear):
        fall = response(BioTacModel(bulge=0.0), shear=shear)
        return (fall * x).sum() / fall.sum()

    assert middle((2.0, 0.0)) > middle((0.0, 0.0)) + 2e-4
    assert middle((-2.0, 0.0)) < middle((0.0, 0.0)) - 2e-4


def test_flat_objects_press_wider():
    flat, round_ = response(normal=6.0), response(normal=6.0, curvature=100.0)
    assert (flat > 200).sum() >= (round_ > 200).sum()
    assert flat.sum() > round_.sum()


def test_part_of_the_response_is_late():
    model = BioTacModel(noise=0.0, drift=0.0, gain_spread=0.0)
    step = np.zeros((200, 19, 3))
    step[50:] = 400.0
    offsets, readings = read(model, step, np.zeros((200, 3)))
    fall = (offsets.offset - readings.tactile)[:, 0, 0]
    assert fall[50] == pytest.approx(400 * (1 - model.lag + model.lag * 0.0645), abs=2)
    assert fall[-1] == pytest.approx(400, abs=2)


def test_fingertips_drift_by_so_much_in_ten_seconds():
    model = BioTacModel(drift=100.0, noise=0.0)
    drifts = []
    for seed in range(100):
        offsets, readings = read(model, np.zeros((1001, 19, 3)), np.zeros((1001, 3)), seed=seed)
        drifts.append(readings.tactile[-1] - offsets.offset.round())
    # Of a whole fingertip, and by 0.3 of that on some electrodes more than on others.
    assert np.std(drifts) == pytest.approx(100 * 1.09**0.5, rel=0.1)
    assert np.std(np.mean(drifts, axis=1)) == pytest.approx(100, rel=0.1)


def test_pressure_grows_with_force():
    model = BioTacModel(drift=0.0, pressure_noise=0.0)
    normal = np.array([[0.0, 1.0, 5.0]])
    offsets, readings = read(model, np.zeros((1, 19, 3)), normal)
    wanted = offsets.pressure_offset + offsets.pressure_gain * model.pressure_gain * normal
    assert np.allclose(readings.pressure, wanted, atol=0.51)


def test_sessions_differ_and_repeat():
    model = BioTacModel()
    first, again, other = (
        model.session(biotac(), np.random.default_rng(seed)) for seed in (0, 0, 1)
    )
    assert np.array_equal(first.offset, again.offset)
    assert np.abs(first.offset - other.offset).mean() > 60


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"noise": -1.0}, r"'noise' must be not negative and finite \(got -1.0\)"),
        ({"blur": 0.0}, r"'blur' must be positive and finite \(got 0.0\)"),
        ({"gain": float("nan")}, r"'gain' must be not negative and finite \(got nan\)"),
        ({"lag": 1.0}, r"'lag' must be at least 0 and below 1 \(got 1.0\)"),
    ],
)
def test_bad_constants_are_named(values, message):
    with pytest.raises(ValueError, match=message):
        BioTacModel(**values)


def test_bad_shapes_are_named():
    zeros = np.zeros((2, 3, 3))
    with pytest.raises(ValueError, match=r"'force', 'normal' and 'place' must have shapes"):
        BioTacModel().response(zeros, np.zeros((2, 2)), zeros, biotac())
    layout = grid(2, 2, 0.01)
    object.__setattr__(layout, "normal", None)
    with pytest.raises(ValueError, match=r"must have normals"):
        BioTacModel().response(zeros, np.zeros((2, 3)), zeros, layout)


def test_vibration_of_a_still_contact_is_noise_and_of_a_slide_is_not():
    normal, slide = np.full((300, 3), 4.0), np.zeros((300, 3))
    slide[150:, 1] = 0.05
    pac = vibration(normal, slide, np.random.default_rng(0)).astype(float)
    assert pac.shape == (100, 3, 22)
    assert pac[:, 0].std() == pytest.approx(3.0, rel=0.1)
    assert pac[55:, 1].std() > 10 * pac[:45, 1].std()
    assert pac.mean() == pytest.approx(2048, abs=2)


def test_vibration_follows_the_rate_of_the_force():
    normal = np.zeros((300, 1))
    normal[100:130, 0] = np.linspace(0, 3, 30)
    normal[130:] = 3.0
    pac = vibration(normal, np.zeros((300, 1)), np.random.default_rng(0)).astype(float)
    assert pac[36:42].mean() - 2048 == pytest.approx(1.5 * 3 / 29 * 300, rel=0.1)


def test_vibration_needs_whole_frames():
    with pytest.raises(ValueError, match=r"same shape \(3 \* T, num_fingers\) .* \(4, 3\)"):
        vibration(np.zeros((4, 3)), np.zeros((4, 3)), np.random.default_rng(0))
