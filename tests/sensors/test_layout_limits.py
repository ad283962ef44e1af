r"""A layout file must not allocate memory for a claimed size, lose unknown keys, or fail without an
error that names the file.
"""

import copy
import json
import pickle

import pytest
import torch

from torch_geometric_tactile._texts import read_json
from torch_geometric_tactile.sensors import TaxelLayout, biotac_sp

TAXEL = {"pos": [0, 0, 0], "normal": [0, 0, 1], "link": "a", "cell": [0, 0]}
TILE = {"kind": "planar", "rows": [2, 2], "pitch": 2}
PATCH = {"name": "low", "digit": "pad", "link": "base", "shape": "tile", "origin": [0, 0, 0]}
SEAM = {"kind": "seam", "from": ["low", "top"], "to": ["low", "bottom"]}


def listed(**changes):
    return {"name": "one", "unit": "mm", "taxels": [TAXEL], **changes}


def taxel(**changes):
    return listed(taxels=[{**TAXEL, **changes}])


def tiles(**changes):
    return {"name": "t", "unit": "mm", "shapes": {"tile": TILE}, "patches": [PATCH], **changes}


def tile(**changes):
    return tiles(shapes={"tile": {**TILE, **changes}})


def patch(**changes):
    return tiles(patches=[{**PATCH, **changes}])


def join(**changes):
    return tiles(joins=[{**SEAM, **changes}])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "Expecting value"),
        ('{"name": "cut", ', "Expecting property name"),
        ("[1, 2]", r"must be a JSON object \(got list\)"),
        ("[" * 100_000, "must not be nested this deeply"),
        ('{"name": NaN}', r"numbers must be finite \(got NaN\)"),
        ('{"name": 1e999}', r"numbers must be finite \(got 1e999\)"),
        ('{"name": ' + "9" * 5000 + "}", "4300 digits"),
        ('{"name": "a", "name": "b"}', r"each key once \(got 'name' twice\)"),
        (listed(name="\ud800"), "'name' must be a string without surrogates"),
        (listed(sourse="x"), r"a layout must have only the keys .* \(got 'sourse'\)"),
        (listed(taxels={"pos": [0, 0, 0]}), "'taxels' must be a list"),
        (listed(taxels=[None]), "taxel 0 must have a 'pos'"),
        (taxel(pos=[0, True, 0]), "taxel 0 must have a 'pos' of two or three numbers"),
        (taxel(pos=[0, 10**400, 0]), "taxel 0 must have a 'pos' of two or three numbers"),
        (taxel(normam=[0, 0, 1]), r"taxel 0 must have only the keys .* \(got 'normam'\)"),
        (taxel(normal=[0, 0]), "'normal' of taxel 0 must be three numbers"),
        (taxel(tangent=[[1, 0, 0]]), "'tangent' of taxel 0 must be two axes of three numbers"),
        (taxel(cell=[0.5, 0]), r"'cell' of taxel 0 must be a row and a column \(got \[0.5, 0\]\)"),
        (listed(link_names=["a", 1]), "each of 'link_names' must be a string"),
        (listed(adjacency=[[0, 0]]), "'adjacency' must be a JSON object"),
        (listed(adjacency={"a": 5}), "adjacency 'a' must be a list of pairs"),
        (listed(adjacency={"a": [[0, False]]}), "adjacency 'a' must be a list of pairs"),
        (listed(adjacency={"a": [[0, 10**30]]}), "adjacency 'a' must be a list of pairs"),
        (tiles(taxels=[TAXEL]), r"must not have 'taxels' as well \(got both\)"),
        (tiles(shapes=[TILE]), "'shapes' must be a JSON object"),
        (tiles(jolns=[]), r"must have only the keys .* \(got 'jolns'\)"),
        (tiles(joins=5), "'joins' must be a list"),
        (tiles(one_way=[]), "'one_way' must be a JSON object"),
        (tiles(one_way={"densy": []}), r"'one_way' must have only the keys .* \(got 'densy'\)"),
        (tile(rows=[100000001]), r"must have at most 100000 taxels \(got 100000001\)"),
        (tile(rows=[10**40]), "must have at least one taxel each"),
        (tile(rows=[True]), "must have at least one taxel each"),
        (tile(pitch="2"), r"'pitch' of shape 'tile' must be a number \(got '2'\)"),
        (tile(sparse=[]), r"shape 'tile' must have only the keys .* \(got 'sparse'\)"),
        (tile(sparse_across=[5]), "'sparse_across' of shape 'tile' must list taxels"),
        (tile(kind=["planar"]), r"the kind of shape 'tile' must be one of .* \(got \['planar'\]\)"),
        (patch(name=["low"]), "the name of a patch must be a string"),
        (patch(shape=["tile"]), "the shape of patch 'low' must be one of"),
        (patch(column=[0, 0, 0]), r"'column' of patch 'low' must have a direction"),
        (patch(cell=[0]), r"'cell' of patch 'low' must be a row and a column \(got \[0\]\)"),
        (patch(orign=[0, 0, 0]), r"patch 'low' must have only the keys .* \(got 'orign'\)"),
        (patch(digit=1), r"the digit of patch 'low' must be a string \(got 1\)"),
        (join(reverse=1), r"'reverse' of a join must be true or false \(got 1\)"),
        (join(to=[["low"], "top"]), r"a join must name patches \(got \['low'\]\)"),
        (join(to=["low", None]), r"the side of a join must be one of .* \(got None\)"),
        (join(kind="fan", straight=1.0), r"'straight' of a fan must be 0 to 1 \(got 1.0\)"),
        (tiles(one_way={"dense": [{"from": 5, "to": 5}]}), "a one-way edge must join taxels"),
    ],
)
def test_load_refuses_and_names_the_file(content, message, tmp_path):
    path = tmp_path / "bad.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ValueError, match=rf"bad\.json' is not a taxel layout: .*{message}"):
        TaxelLayout.load(path)


def test_the_contents_that_are_changed_above_are_good():
    assert TaxelLayout.from_dict(listed()).num_taxels == 1
    assert TaxelLayout.from_dict(tiles(joins=[SEAM])).num_taxels == 4


def test_names_of_links_are_kept_where_taxels_name_none():
    content = {"name": "one", "unit": "mm", "taxels": [{"pos": [0, 0, 0]}], "link_names": ["tip"]}
    assert TaxelLayout.from_dict(content).link_names == ("tip",)


def test_a_fan_of_too_many_pairs_is_refused_before_it_is_made():
    content = tile(rows=[2000, 2000])
    fan = {"kind": "fan", "from": ["low", "top"], "to": ["low", "bottom"], "straight": 0}
    with pytest.raises(ValueError, match=r"at most 1000000 pairs .* \(got 4000000\)"):
        TaxelLayout.from_dict({**content, "joins": [fan]})


def test_files_that_are_none_or_too_large(tmp_path):
    with pytest.raises(ValueError, match="is not a taxel layout: it must be a regular file"):
        TaxelLayout.load("/dev/zero")
    with pytest.raises(ValueError, match="is not a taxel layout: it must be a regular file"):
        TaxelLayout.load(tmp_path)
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(ValueError, match="it must not exceed 134217728 bytes"):
        read_json(path)


@pytest.mark.parametrize(
    "again", [lambda it: it, copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))]
)
def test_adjacency_of_a_layout_and_of_its_copies_cannot_be_edited(again):
    layout = again(biotac_sp())
    assert layout.pos.equal(biotac_sp().pos)
    assert layout.normal.equal(biotac_sp().normal)
    assert list(layout.adjacency) == list(biotac_sp().adjacency)
    with pytest.raises(TypeError, match="does not support item assignment"):
        layout.adjacency["own"] = torch.zeros(2, 0, dtype=torch.long)
