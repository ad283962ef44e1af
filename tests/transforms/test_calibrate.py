import json

import pytest
import torch
from predictor.test_round_trip import calibrated
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import Calibrate

LINEAR = [[1.0, 2.0], [0.5, 0.0], [0.25, 4.0]]  # offset, x, y


def forces(calibrate, *readings):
    return calibrate(Data(x=torch.tensor(readings))).x.tolist()


def test_cross_axis_matrix_by_hand():
    assert forces(Calibrate(LINEAR), [4.0, 8.0]) == [[1 + 2 + 2, 2 + 32]]


def test_products_of_channels_by_hand():
    terms = [[1.0], [10.0], [100.0], [1e3], [1e4], [1e5]]  # 1, x, y, xx, xy, yy
    found = forces(Calibrate(terms, degree=2), [2.0, 3.0])
    assert found == [[1 + 20 + 300 + 4e3 + 6e4 + 9e5]]
    assert forces(Calibrate([[0.0], [0.0], [0.0], [1.0]], degree=3), [3.0]) == [[27.0]]


def test_readings_are_scaled_to_their_range():
    # Within 10 to 30: z = (x - 20) / 10.
    calibrate = Calibrate([[1.0], [2.0]], low=[10.0], high=[30.0])
    assert forces(calibrate, [10.0], [20.0], [25.0]) == [[-1.0], [1.0], [2.0]]


@pytest.mark.parametrize(("degree", "size"), [(1, 4), (2, 10), (3, 20)])
def test_beyond_the_range_forces_go_on_along_the_tangent(degree, size):
    coefficients = torch.randn(size, 1)
    calibrate = Calibrate(coefficients, [0.0] * 3, [2.0] * 3, degree)
    step = torch.tensor([[1.0, 0.0, -1.0]], dtype=torch.double)  # out of the range at a corner
    corner = torch.tensor([[2.0, 1.5, 0.0]], dtype=torch.double)
    inside, edge, near, far = (
        calibrate(Data(x=corner + far * step)).x.item() for far in (-1e-6, 0, 1, 3)
    )
    assert near - edge == pytest.approx((edge - inside) / 1e-6, rel=1e-4)
    assert far - edge == pytest.approx(3 * (near - edge))


def test_which_readings_are_beyond():
    calibrate = Calibrate(torch.ones(2, 4, 1), torch.zeros(2, 3), torch.ones(2, 3))
    x = torch.tensor([[[0.0, 0.5, 1.0], [0.0, 0.5, 1.1]], [[-0.1, 0.5, 1.0], [1.0, 1.0, 1.0]]])
    expected = [[False, True], [True, False]]
    assert calibrate.beyond(StaticData(x=x)).tolist() == expected
    frames = torch.stack([x.clamp(0, 1), x], dim=2)
    windows = StaticData(x=join_frames(frames), num_frames=2)
    assert calibrate.beyond(windows).tolist() == expected
    assert not Calibrate(torch.ones(4, 1)).beyond(StaticData(x=x)).any()


def test_force_of_the_sensor_is_the_sum_over_taxels():
    x = torch.randn(3, 5, 3)
    coefficients = torch.randn(5, 4, 2)
    each = Calibrate(coefficients)(StaticData(x=x)).x
    whole = Calibrate(coefficients, per="sensor")(StaticData(x=x))
    torch.testing.assert_close(whole.force, each.sum(dim=1))
    assert whole.x.equal(x)
    one = Calibrate(coefficients, per="sensor")(Data(x=x[1]))
    torch.testing.assert_close(one.force, whole.force[1:2])
    batch = Batch.from_data_list([Data(x=sample) for sample in x])
    torch.testing.assert_close(Calibrate(coefficients, per="sensor")(batch).force, whole.force)


def test_frames_of_windows_are_mapped_one_by_one():
    frames = torch.randn(2, 6, 4, 3)
    for per in ("taxel", "sensor"):
        calibrate = calibrated(6, 10, 2, per=per)
        found = calibrate(StaticData(x=join_frames(frames), num_frames=4))
        each = [calibrate(StaticData(x=frames[:, :, t])) for t in range(4)]
        if per == "taxel":
            expected = join_frames(torch.stack([one.x for one in each], dim=2))
            torch.testing.assert_close(found.x, expected)
        else:
            expected = torch.stack([one.force for one in each], dim=2).flatten(1)
            torch.testing.assert_close(found.force, expected)


def test_what_follows_from_a_missing_reading_is_missing():
    x = torch.rand(2, 6, 3) + 2
    x[0, 1, 2] = torch.nan
    taxels = calibrated(6, 10, 2)(StaticData(x=x)).x
    assert taxels.isnan().nonzero().tolist() == [[0, 1, 0], [0, 1, 1]]
    sensor = calibrated(6, 10, 2, per="sensor")(StaticData(x=x)).force
    assert sensor.isnan().tolist() == [[True, True], [False, False]]


def test_a_reading_that_never_changed_does_no_harm():
    calibrate = Calibrate([[1.0], [2.0]], low=[5.0], high=[5.0])
    assert forces(calibrate, [5.0], [6.0]) == [[1.0], [3.0]]


def test_file_by_hand_and_again(tmp_path):
    path = tmp_path / "a.json"
    content = {"coefficients": LINEAR, "reading_unit": "microtesla", "force_unit": "newton"}
    path.write_text(json.dumps(content))
    assert forces(Calibrate.load(path), [4.0, 8.0]) == [[5.0, 34.0]]
    first = calibrated(6, 10, 2, per="sensor", units=("count", "unit of the file"))
    first.save(path)
    again = Calibrate.load(path)
    assert repr(again) == repr(first)
    assert again.source == "a press"
    for name in ("coefficients", "low", "high"):
        assert getattr(again, name).equal(getattr(first, name))
    assert again.to_dict() == json.loads(path.read_text())


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"coefficients": None}, "must have the key 'coefficients'"),
        ({"force_unit": None}, "must have the key 'force_unit'"),
        ({"force_unit": "gram"}, "'units' must be .* 'unit of the file'"),
        ({"coefficients": [[1.0], ["2"]]}, "'coefficients' must be lists of finite numbers"),
        ({"coefficients": "12"}, "'coefficients' must be lists of finite numbers"),
        ({"coefficients": [[1.0, 2.0], [1.0]]}, "'coefficients' must be lists of equal length"),
        ({"coefficients": [[True], [1.0]]}, "'coefficients' must be lists of finite numbers"),
        ({"coefficients": [[[[1.0]]]]}, "'coefficients' must be lists of finite numbers"),
        ({"coefficients": [1.0, 2.0]}, r"must have shape \(num_terms, num_forces\).*\(2,\)"),
        ({"degree": 3}, "a row for the constant and for each product of up to 3 channels"),
        ({"degree": True}, "'degree' must be 1, 2 or 3"),
        ({"degree": 4}, "'degree' must be 1, 2 or 3"),
        ({"per": "hand"}, "'per' must be one of"),
        ({"low": [1.0, 2.0]}, "'low' and 'high' must be given together"),
        ({"low": [1.0], "high": [2.0]}, r"'low' must have shape \(2,\)"),
        ({"low": [1.0, 3.0], "high": [2.0, 2.0]}, "'low' must not be above 'high'"),
        ({"source": 3}, "'source' must be a string"),
        ({"lows": [1.0]}, "must have only the keys .* 'lows'"),
    ],
)
def test_file_that_is_no_calibration(change, text, tmp_path):
    content = {"coefficients": LINEAR, "reading_unit": "count", "force_unit": "newton"}
    content |= change
    path = tmp_path / "a.json"
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
    with pytest.raises(ValueError, match=rf"a.json' is not a calibration: .*{text}"):
        Calibrate.load(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="write one with 'tactile calibrate'"):
        Calibrate.load(tmp_path / "a.json")


def test_bad_input():
    with pytest.raises(ValueError, match="'coefficients' must be finite"):
        Calibrate(torch.tensor([[1.0], [torch.inf]]))
    with pytest.raises(ValueError, match=r"'x' must have 3 channels.*\(got 2\)"):
        Calibrate(torch.ones(4, 1))(Data(x=torch.zeros(5, 2)))
    with pytest.raises(ValueError, match=r"must have 6 taxels, as in the calibration \(got 5\)"):
        Calibrate(torch.ones(6, 4, 1))(Data(x=torch.zeros(5, 3)))
    batch = Batch.from_data_list([Data(x=torch.zeros(2, 3)), Data(x=torch.zeros(4, 3))])
    with pytest.raises(ValueError, match="the same number of taxels"):
        Calibrate(torch.ones(4, 1), per="sensor")(batch)


def test_force_of_a_single_taxel():
    calibrate = Calibrate(LINEAR, per="sensor")
    assert calibrate(Data(x=torch.zeros(1, 2))).force.tolist() == [[1.0, 2.0]]


def test_a_predictor_and_its_file_calibrate_frames_and_streams_alike(tmp_path):
    layout = grid(2, 3, pitch=0.01)
    model = TactileFNN(layout, 2, channels={"tactile": 2}, widths=(4,), pools=(1,))
    predictor = Predictor(model, layout, transform=calibrated(6, 10, 2))
    predictor.save(tmp_path / "a.predictor")
    again = Predictor.load(tmp_path / "a.predictor")
    x = torch.rand(4, 6, 3) + 2
    expected = calibrated(6, 10, 2)(StaticData(x=x)).x
    for one in (predictor, again):
        assert one.prepare(x).x.equal(expected)
        assert one.preparation.prepare_frame(x[1]).x[0].equal(expected[1])
        torch.testing.assert_close(one(x[1]), predictor(x)[1])
    assert again.preparation.transforms[0].source == "a press"
