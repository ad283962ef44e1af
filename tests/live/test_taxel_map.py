import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.io._xela_messages import read_xela_messages
from torch_geometric_tactile.live import TaxelMap
from torch_geometric_tactile.sensors import allegro_uskin, allegro_uskin_368, as_layout

STOCK = ("xela_allegro_368", "xela_allegro_368_to_384", "xela_uspa44", "xela_uspa46")


@pytest.fixture(scope="module")
def xela():
    """The folder of XELA's files."""
    shared = Path(__file__).resolve().parents[3] / "shared" / "data"
    roots = [Path(os.environ.get("TACTILE_TEST_DATA") or shared), shared]
    for root in roots:
        if (root / "xela" / "allegro_taxel_maps").is_dir():
            return root / "xela"
    pytest.skip("XELA's files are not there; set TACTILE_TEST_DATA to the folder that has 'xela'")


def test_taxel_map_by_hand():
    taxel_map = TaxelMap([2, -1, 0], 3, layout="pad", source="a drawing")
    out = taxel_map.apply(np.float32([[1, 2], [3, 4], [5, 6]]))
    np.testing.assert_array_equal(out, [[5, 6], [math.nan, math.nan], [1, 2]])
    assert out.dtype == np.float32
    assert repr(taxel_map) == "TaxelMap(3 -> 3, missing=1, layout='pad')"


def test_taxel_map_leaves_the_readings_of_the_source_alone():
    tactile = np.ones((2, 1), dtype=np.float32)
    TaxelMap([-1, 1], 2).apply(tactile)
    assert tactile.tolist() == [[1], [1]]


def test_taxel_map_single_taxel_and_another_number():
    taxel_map = TaxelMap(np.array([0]), 1)
    assert taxel_map.apply(np.float32([[7]])).tolist() == [[7]]
    with pytest.raises(ValueError, match=r"'tactile' must have 1 taxels for this map \(got 2\)"):
        taxel_map.apply(np.zeros((2, 1), dtype=np.float32))


def test_taxel_map_round_trip(tmp_path):
    path = tmp_path / "map.json"
    TaxelMap([2, -1, 0], 3, layout="pad", source="a drawing").save(path)
    loaded = TaxelMap.load(path)
    assert loaded.index.tolist() == [2, -1, 0]
    assert (loaded.num_taxels, loaded.layout, loaded.source) == (3, "pad", "a drawing")
    assert TaxelMap.load(str(path)).index.tolist() == [2, -1, 0]


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (([0, 1], 0), "'num_taxels' must be a positive integer"),
        (([0, 1], True), "'num_taxels' must be a positive integer"),
        (([], 2), "'index' must be a list of integers"),
        (([[0], [1]], 2), "'index' must be a list of integers"),
        (([[0], [1, 2]], 2), "'index' must be a list of integers"),
        (([0.0, 1.0], 2), "'index' must be a list of integers"),
        (([0, 2], 2), r"'index' must hold indices from 0 to 1, or -1 .* \(got 2\)"),
        (([0, -2], 2), r"'index' must hold indices from 0 to 1, or -1 .* \(got -2\)"),
        (([1, 1], 2), r"'index' must hold each index at most once \(got 1 twice\)"),
    ],
    ids=str,
)
def test_taxel_map_bad_input_raises(arguments, match):
    with pytest.raises(ValueError, match=match):
        TaxelMap(*arguments)


@pytest.mark.parametrize("name", ["layout", "source"])
def test_taxel_map_layout_and_source_are_texts(name):
    with pytest.raises(ValueError, match=rf"'{name}' must be a string \(got int\)"):
        TaxelMap([0], 1, **{name: 3})


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("[0, 1]", "it must be a JSON object with 'index' and 'num_taxels'"),
        ('{"index": [0]}', "it must be a JSON object with 'index' and 'num_taxels'"),
        ('{"index": [5], "num_taxels": 2}', "'index' must hold indices"),
        ('{"index": [true, 1], "num_taxels": 2}', "'index' must be a list of integers .*boolean"),
        ('{"index": [0], "num_taxels": 2, "size": 1}', r"among .*\(got 'size'\)"),
        ('{"index": [1e3], "num_taxels": 2}', "'index' must be a list"),
        (f'{{"index": [{10**30}], "num_taxels": 2}}', "'index' must be a list"),
        ('{"index": "all", "num_taxels": 2}', "'index' must be a list"),
        ('{"index": [1', "is not a taxel map"),
    ],
)
def test_taxel_map_file_that_holds_none_raises(tmp_path, content, match):
    path = tmp_path / "map.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=match) as caught:
        TaxelMap.load(path)
    assert str(path) in str(caught.value)


def test_taxel_map_unknown_name_and_missing_file_raise(tmp_path):
    with pytest.raises(ValueError, match=r"must be one of \['xela_allegro_368', .*\(got 'hand'\)"):
        TaxelMap.load("hand")
    with pytest.raises(FileNotFoundError, match="nothing"):
        TaxelMap.load(tmp_path / "nothing.json")


@pytest.mark.parametrize("name", STOCK)
def test_stock_map_fits_its_layout(name):
    taxel_map = TaxelMap.load(name)
    assert len(taxel_map.index) == as_layout(taxel_map.layout).num_taxels
    assert taxel_map.source
    assert taxel_map.models


def test_stock_maps_are_all_tested():
    assert tuple(TaxelMap.names()) == STOCK


def test_map_of_368_taxels_misses_none():
    assert sorted(TaxelMap.load("xela_allegro_368").index.tolist()) == list(range(368))


def test_map_to_384_taxels_has_the_phalanges():
    # A taxel of both layouts has the same patch, and the same place on its link.
    own, full = allegro_uskin_368(), allegro_uskin()
    of_368 = TaxelMap.load("xela_allegro_368").index.tolist()
    of_384 = TaxelMap.load("xela_allegro_368_to_384").index.tolist()
    assert sum(place >= 0 for place in of_384) == 11 * 16
    for taxel, place in enumerate(of_384):
        patch = full.patch_names[int(full.patch[taxel])]
        assert (place >= 0) == (not patch.endswith("_tip") and not patch.startswith("palm"))
        if place >= 0:
            other = of_368.index(place)
            assert own.patch_names[int(own.patch[other])] == patch
            assert own.pos[other].equal(full.pos[taxel])


def picture(path):
    """Rows of a picture of XELA's: the place of a taxel in a message, or -1."""
    rows, row = [], []
    for line in path.read_text().splitlines():
        text = line.strip()
        if text.startswith("- - "):
            row = [int(text[4:])]
            rows.append(row)
        elif text.startswith("- "):
            row.append(int(text[2:]))
    return np.array(rows)


def test_map_of_368_taxels_is_xelas_picture(xela):
    cells = allegro_uskin_368().image_map.numpy()
    right = picture(xela / "allegro_taxel_maps" / "pattern_rahv4.yaml")
    left = picture(xela / "allegro_taxel_maps" / "pattern_lahv4.yaml")
    assert right.shape == (31, 26)
    index = TaxelMap.load("xela_allegro_368").index
    np.testing.assert_array_equal(right[cells[:, 0], cells[:, 1]], index)
    np.testing.assert_array_equal(left, right[:, ::-1])  # a left hand is the mirrored right one


def test_map_of_368_taxels_has_the_patches_of_xelas_model(xela):
    # `12: x_taxel_0_02_uSPa44_04_joint`: finger 0, patch 2, from the base.
    text = (xela / "allegro_taxel_maps" / "taxel_joint_map_new.yaml").read_text()
    named = dict(line.split(": ") for line in text.splitlines()[1:])
    fingers = ("thumb", "index", "middle", "ring")
    layout, index = allegro_uskin_368(), TaxelMap.load("xela_allegro_368").index
    for taxel, place in enumerate(index.tolist()):
        _, _, _, patch, kind, *_ = named[f"  {place}"].split("_")
        name = layout.patch_names[int(layout.patch[taxel])]
        expected = {"uSPa44": "planar", "uSCuAH": "tip", "uSPa46": "palm"}[kind]
        if expected == "palm":
            assert name.startswith("palm")
            continue
        finger, segment = fingers[int(patch[0])], int(patch[1])
        segment = segment if finger == "thumb" else segment + 1
        assert name == (f"{finger}_tip" if expected == "tip" else f"{finger}_{segment}")


@pytest.mark.parametrize("name", ["uspa44", "uspa46"])
def test_xela_numbers_the_patches_of_its_hand_alike(xela, name):
    # `12: x_taxel_0_02_uSPa44_04_joint`: taxel 4 of a patch uSPa44. In XELA's picture of the hand a
    # patch is turned by quarter turns, but its numbers follow one another along the same rows.
    layout = as_layout(name)
    rows, columns = (layout.image_map.amax(dim=0) + 1).tolist()
    image = picture(xela / "allegro_taxel_maps" / "pattern_rahv4.yaml")
    text = (xela / "allegro_taxel_maps" / "taxel_joint_map_new.yaml").read_text()
    patches = {}
    for place, joint in (line.split(": ") for line in text.splitlines()[1:]):
        _, _, _, patch, kind, number, _ = joint.split("_")
        if kind.lower() == name:
            cell = np.argwhere(image == int(place))[0]
            patches.setdefault(patch, {})[int(number) - 1] = cell
    assert len(patches) == {"uspa44": 11, "uspa46": 3}[name]
    for cells in patches.values():
        along, down = cells[1] - cells[0], cells[columns] - cells[0]
        assert abs(along).sum() == 1
        assert down.tolist() == [along[1], -along[0]]  # not mirrored
        for taxel in range(rows * columns):
            expected = cells[0] + taxel // columns * down + taxel % columns * along
            np.testing.assert_array_equal(cells[taxel], expected)


def test_corners_of_real_patches_of_4_by_6_have_high_counts_at_rest(xela):
    tactile = read_xela_messages(xela / "ws_messages" / "uSPa46.json").tactile[0]
    for pressure in (tactile[:24, 2], tactile[24:, 2]):
        assert {0, 5, 18, 23} <= set((-pressure).argsort()[:6].tolist())


@pytest.mark.parametrize("name", ["XR23AHRCPP", "XR23AHLCPP"])
def test_real_messages_of_368_taxels(xela, name):
    path = xela / "ws_messages" / f"{name}.json"
    tactile = read_xela_messages(path).tactile[0]
    sensor = json.loads(path.read_text()[path.read_text().index("{") :], strict=False)["1"]
    integer = np.float32(sensor["integer"]).reshape(368, 3)
    np.testing.assert_array_equal(tactile, integer)
    mapped = TaxelMap.load("xela_allegro_368").apply(tactile)
    layout = allegro_uskin_368()
    # By hand from the picture: message place 0 is at the thumb's right edge, place 83 at the
    # index finger's very tip, place 245 in the corner of the lower palm patch.
    cells = layout.image_map.tolist()
    for place, cell in ((0, [17, 25]), (83, [0, 17]), (245, [30, 8]), (367, [5, 0])):
        np.testing.assert_array_equal(mapped[cells.index(cell)], integer[place])
    to_384 = TaxelMap.load("xela_allegro_368_to_384").apply(tactile)
    assert np.isnan(to_384).all(axis=1).sum() == 384 - 176
