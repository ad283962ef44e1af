import numpy as np

from torch_geometric_tactile.live._viewer.rest import ViewerRest


def reading(value, shape=(2, 1)):
    return np.full(shape, value, dtype=np.float32)


def test_rest_is_the_mean_of_the_first_second():
    rest = ViewerRest()
    assert rest.relative(10.0, reading(4.0)).tolist() == [[0.0], [0.0]]
    assert rest.relative(10.5, reading(8.0)).tolist() == [[2.0], [2.0]]
    assert rest.kind == "measuring"
    rest.relative(11.0, reading(6.0))
    assert rest.kind == "measured"
    assert rest.mean.tolist() == [[6.0], [6.0]]
    assert rest.relative(11.1, reading(16.0)).tolist() == [[10.0], [10.0]]
    assert rest.mean.tolist() == [[6.0], [6.0]]


def test_missing_readings_are_left_out_of_the_mean():
    rest = ViewerRest()
    rest.relative(0.0, np.array([[np.nan], [np.nan]]))
    rest.relative(0.1, np.array([[3.0], [np.nan]]))
    out = rest.relative(2.0, np.array([[5.0], [np.nan]]))
    assert out[0] == 1.0
    assert np.isnan(out[1])


def test_again_measures_the_next_second():
    rest = ViewerRest()
    for time in (0.0, 2.0):
        rest.relative(time, reading(1.0))
    rest.again()
    assert rest.kind == "measuring"
    assert rest.relative(3.0, reading(7.0)).tolist() == [[0.0], [0.0]]


def test_given_rest_goes_first_where_it_fits():
    rest = ViewerRest()
    rest.given = reading(5.0)
    assert rest.kind == "given"
    assert rest.relative(0.0, reading(7.0)).tolist() == [[2.0], [2.0]]
    assert rest.relative(0.0, reading(7.0, (3, 1))).tolist() == [[0.0]] * 3


def test_other_number_of_taxels_begins_anew():
    rest = ViewerRest()
    for time in (0.0, 2.0):
        rest.relative(time, reading(1.0))
    assert rest.relative(3.0, reading(9.0, (4, 3))).tolist() == [[0.0] * 3] * 4
    assert rest.kind == "measuring"
