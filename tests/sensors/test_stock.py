from pathlib import Path

import pytest

from torch_geometric_tactile.sensors import (
    HandKinematics,
    TaxelLayout,
    allegro_uskin,
    as_layout,
    biotac,
    biotac_sp,
    stock_layout,
    stock_names,
    stock_path,
    uskin_gripper,
)


@pytest.mark.parametrize("build", [allegro_uskin, biotac, biotac_sp, uskin_gripper])
def test_stock_layout_is_what_its_function_returns(build):
    layout = stock_layout(build.__name__)
    assert layout.name == build.__name__
    assert layout.matches(build())


def test_stock_paths_can_be_loaded():
    assert TaxelLayout.load(stock_path("layouts", "biotac")).num_taxels == 19
    assert HandKinematics.load(stock_path("chains", "allegro_right")).num_joints == 16


def test_unknown_name_lists_the_names():
    known = r"\['allegro_uskin', 'allegro_uskin_240', 'allegro_uskin_368', 'anyskin', .*\]"
    with pytest.raises(ValueError, match=rf"'name' must be one of {known} \(got 'allegro'\)"):
        stock_layout("allegro")
    with pytest.raises(ValueError, match=r"\['allegro_right'.*\] \(got 'allegro_uskin'\)"):
        stock_path("chains", "allegro_uskin")


def test_unknown_kind_lists_the_kinds():
    with pytest.raises(ValueError, match=r"'kind' must be one of .* \(got 'layout'\)"):
        stock_path("layout", "biotac")


def test_anyskin_is_a_cross_around_its_centre():
    layout = stock_layout("anyskin")
    assert layout.pos.sum(0).tolist() == [0, 0, 0]
    assert layout.pos.norm(dim=1).tolist() == pytest.approx([0, 0.007, 0.007, 0.007, 0.007])
    assert layout.image_map.tolist() == [[1, 1], [1, 0], [1, 2], [0, 1], [2, 1]]
    assert "our model" in layout.source


def test_gripper_has_two_patches_that_no_edge_joins():
    layout = uskin_gripper()
    assert repr(layout) == "TaxelLayout('uskin_gripper', num_taxels=32, patches=2, digits=2)"
    assert layout.link_names == layout.patch_names == ("finger_1", "finger_2")
    edges = layout.edge_index("original")
    assert edges.shape == (2, 96)  # 24 pairs of neighbours in a patch of 4 x 4, both ways
    assert bool((edges // 16).diff(dim=0).eq(0).all())
    length = (layout.pos[edges[0]] - layout.pos[edges[1]]).norm(dim=1)
    assert length.tolist() == pytest.approx([0.004667] * 96)
    assert layout.pos[:16].equal(layout.pos[16:])
    assert "our reading" in layout.source


def test_stock_names():
    assert {"allegro_uskin", "biotac_sp"} <= set(stock_names())
    assert "allegro_right" in stock_names("chains")


def test_as_layout_takes_a_layout_a_name_or_a_path(tmp_path, monkeypatch):
    layout = biotac()
    assert as_layout(layout) is layout
    assert as_layout("biotac").matches(layout)
    biotac_sp().save(tmp_path / "mine.json")
    biotac_sp().save(tmp_path / "biotac")
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path / "mine.json", str(tmp_path / "mine.json"), "mine.json", "./biotac"):
        assert as_layout(path).name == "biotac_sp"
    assert as_layout(Path("biotac")).name == "biotac_sp"
    assert as_layout("biotac").name == "biotac"


@pytest.mark.parametrize(
    ("name", "layout"),
    [
        ("uSPa44", "uspa44"),
        ("XR1844", "uspa44"),
        ("xr1944", "uspa44"),
        ("XR1946", "uspa46"),
        ("XR23AHRCPP", "allegro_uskin_368"),
        ("BioTac", "biotac"),
    ],
)
def test_layouts_have_the_names_of_products_in_any_case(name, layout):
    assert as_layout(name).name == stock_layout(name).name == layout
    assert stock_path("layouts", name).name == f"{layout}.json"


def test_a_left_hand_has_no_layout():
    with pytest.raises(ValueError, match=r"\(got 'XR23AHLCPP'\)"):
        as_layout("XR23AHLCPP")


def test_as_layout_names_a_missing_file():
    with pytest.raises(
        FileNotFoundError, match=r"no layout file 'glov.json': write one .*'biotac'"
    ):
        as_layout("glov.json")


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ("glove", r"'layout' must be one of \[.*'biotac_sp'.*\], or the path of a .*got 'glove'\)"),
        (24, r"'layout' must be a TaxelLayout, the name of a layout or the path .* \(got int\)"),
        (None, r"\(got NoneType\)"),
    ],
)
def test_as_layout_rejects(layout, message):
    with pytest.raises(ValueError, match=message):
        as_layout(layout)


def test_a_changed_layout_changes_no_other():
    changed = stock_layout("biotac")
    changed.pos.zero_()
    assert stock_layout("biotac").pos.abs().sum() > 0
    assert not stock_layout("biotac").matches(changed)
