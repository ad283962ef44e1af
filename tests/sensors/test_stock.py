import pytest

from torch_geometric_tactile.sensors import (
    HandKinematics,
    TaxelLayout,
    allegro_uskin,
    biotac,
    biotac_sp,
    stock_layout,
    stock_path,
)


@pytest.mark.parametrize("build", [allegro_uskin, biotac, biotac_sp])
def test_stock_layout_is_what_its_function_returns(build):
    layout = stock_layout(build.__name__)
    assert layout.name == build.__name__
    assert layout.matches(build())


def test_stock_paths_can_be_loaded():
    assert TaxelLayout.load(stock_path("layouts", "biotac")).num_taxels == 19
    assert HandKinematics.load(stock_path("chains", "allegro_right")).num_joints == 16


def test_unknown_name_lists_the_names():
    known = r"\['allegro_uskin', 'allegro_uskin_240', 'biotac', 'biotac_sp'.*\]"
    with pytest.raises(ValueError, match=rf"'name' must be one of {known} \(got 'allegro'\)"):
        stock_layout("allegro")
    with pytest.raises(ValueError, match=r"\['allegro_right'.*\] \(got 'allegro_uskin'\)"):
        stock_path("chains", "allegro_uskin")


def test_unknown_kind_lists_the_kinds():
    with pytest.raises(ValueError, match=r"'kind' must be one of .* \(got 'layout'\)"):
        stock_path("layout", "biotac")
