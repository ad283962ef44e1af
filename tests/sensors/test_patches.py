import json
import math

import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, expand_patches, grid

TILE = {"kind": "planar", "rows": [2, 2], "pitch": 2, "sparse_across": [[0, 0]]}
DOME = {"kind": "capsule", "rows": [3, 1], "pitch": 4, "radius": 10, "straight": 0}


def described(**changes):
    """Two tiles above one another: taxels 0 to 3 (row by row) and 4 to 7."""
    tile = {"digit": "pad", "link": "base", "shape": "tile"}
    content = {
        "name": "two_tiles",
        "unit": "mm",
        "shapes": {"tile": dict(TILE), "dome": {**DOME, "column_angle": 90}},
        "patches": [
            {"name": "low", **tile, "origin": [0, 0, 0], "cell": [2, 0]},
            {"name": "high", **tile, "origin": [0, 0, 5], "cell": [0, 0]},
        ],
        "joins": [{"kind": "seam", "from": ["low", "top"], "to": ["high", "bottom"]}],
    }
    return {**content, **changes}


def pairs(content, name):
    return {frozenset(edge) for edge in expand_patches(content)["adjacency"][name]}


def sets(*edges):
    return {frozenset(edge) for edge in edges}


INSIDE = sets((0, 2), (1, 3), (4, 6), (5, 7))  # along the columns
ACROSS = sets((0, 1), (2, 3), (4, 5), (6, 7))
SLANTED = sets((0, 3), (1, 2), (4, 7), (5, 6))


def test_planar_patch_by_hand():
    taxels = expand_patches(described())["taxels"]
    assert [taxel["pos"] for taxel in taxels[:4]] == [
        [0, -1, -1],
        [0, 1, -1],
        [0, -1, 1],
        [0, 1, 1],
    ]
    assert {tuple(taxel["normal"]) for taxel in taxels} == {(1, 0, 0)}
    assert [taxel["cell"] for taxel in taxels[:4]] == [[3, 0], [3, 1], [2, 0], [2, 1]]
    assert taxels[4] == {
        "pos": [0, -1, 4],
        "normal": [1, 0, 0],
        "tangent": [[0, 1, 0], [0, 0, 1]],
        "link": "base",
        "patch": "high",
        "digit": "pad",
        "cell": [1, 0],
    }


def test_seam_and_patch_edges_by_hand():
    ahead, diagonal = sets((2, 4), (3, 5)), sets((2, 5), (3, 4))
    content = described()
    assert pairs(content, "original") == INSIDE | ACROSS | ahead
    assert pairs(content, "slanted") == SLANTED | diagonal
    assert pairs(content, "dense") == INSIDE | ACROSS | SLANTED | ahead | diagonal
    assert pairs(content, "sparse") == INSIDE | sets((0, 1), (4, 5)) | ahead


def test_reversed_seam_meets_the_far_end():
    join = {"kind": "seam", "from": ["low", "right"], "to": ["high", "bottom"], "reverse": True}
    assert pairs(described(joins=[join]), "original") == INSIDE | ACROSS | sets((1, 5), (3, 4))


def test_seam_of_a_part_of_a_side():
    join = {"kind": "seam", "from": ["low", "top", 1, 1], "to": ["high", "bottom", 0, 0]}
    content = described(joins=[join])
    assert pairs(content, "dense") == INSIDE | ACROSS | SLANTED | sets((3, 4))
    assert pairs(content, "slanted") == SLANTED


def test_fan_by_hand():
    join = {"kind": "fan", "from": ["low", "top"], "to": ["high", "bottom"], "straight": 1}
    content = described(joins=[join])
    fan = sets((2, 5), (3, 4))
    assert pairs(content, "slanted") == SLANTED | fan
    assert pairs(content, "original") == INSIDE | ACROSS | fan | sets((3, 5))


def test_one_way_edge_is_in_its_adjacency_only():
    edge = {"from": ["high", 0, 1], "to": ["low", 0, 0]}
    adjacency = expand_patches(described(one_way={"dense": [edge]}))["adjacency"]
    assert [5, 0] in adjacency["dense"]
    assert [0, 5] not in adjacency["dense"]
    assert [5, 0] not in adjacency["original"]


def test_dome_by_hand():
    patch = {"name": "tip", "digit": "pad", "link": "base", "shape": "dome", "origin": [0, 0, 1]}
    taxels = expand_patches(described(patches=[patch], joins=[]))["taxels"]
    # Three columns 90 degrees apart, and one taxel 4 mm, or 0.4 rad, up the dome.
    pos = torch.tensor([taxel["pos"] for taxel in taxels])
    bend = torch.tensor(0.4)
    top = [10 * float(bend.cos()), 0.0, 1 + 10 * float(bend.sin())]
    expected = torch.tensor([[0, -10, 1], [10, 0, 1], [0, 10, 1], top])
    assert torch.allclose(pos, expected, atol=1e-6)
    normal = torch.tensor([taxel["normal"] for taxel in taxels])
    assert torch.allclose(normal, (expected - torch.tensor([0.0, 0.0, 1.0])) / 10, atol=1e-6)


def test_directions_turn_a_patch():
    content = described()
    content["patches"][0] |= {"column": [2, 0, 0], "row": [0, 2, 0]}  # of any length
    taxels = expand_patches(content)["taxels"]
    assert [taxel["pos"] for taxel in taxels[:4]] == [
        [-1, -1, 0],
        [1, -1, 0],
        [-1, 1, 0],
        [1, 1, 0],
    ]
    assert taxels[0]["normal"] == [0, 0, 1]
    assert taxels[0]["tangent"] == [[1, 0, 0], [0, 1, 0]]


def test_axes_of_a_dome_lie_on_the_skin_with_y_along_the_rows():
    patch = {"name": "tip", "digit": "pad", "link": "base", "shape": "dome", "origin": [0, 0, 1]}
    taxels = expand_patches(described(patches=[patch], joins=[]))["taxels"]
    bend = math.sin(0.4), math.cos(0.4)
    expected = [
        [[1, 0, 0], [0, 0, 1]],
        [[0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, 0, 1]],
        [[0, 1, 0], [-bend[0], 0, bend[1]]],
    ]
    found = torch.tensor([taxel["tangent"] for taxel in taxels])
    torch.testing.assert_close(found, torch.tensor(expected), atol=1e-6, rtol=0)


def test_axes_at_the_pole_of_a_dome_go_on_over_it():
    shapes = {"dome": {**DOME, "rows": [1, 1], "pitch": 10 * math.pi / 2, "column_angle": 0}}
    patch = {"name": "tip", "digit": "pad", "link": "base", "shape": "dome", "origin": [0, 0, 1]}
    pole = expand_patches(described(shapes=shapes, patches=[patch], joins=[]))["taxels"][1]
    assert pole["normal"] == [0, 0, 1]
    assert pole["tangent"] == [[0, 1, 0], [-1, 0, 0]]


def test_patch_of_one_taxel():
    shapes = {"tile": {"kind": "planar", "rows": [1], "pitch": 2}}
    layout = TaxelLayout.from_dict(described(shapes=shapes))
    assert layout.num_taxels == 2
    assert layout.edge_index("original").tolist() == [[0, 1], [1, 0]]
    assert layout.edge_index("slanted").shape == (2, 0)


def test_edges_of_a_planar_patch_are_those_of_a_grid():
    shapes = {"tile": {"kind": "planar", "rows": [5, 5, 5], "pitch": 2}}
    patches = described()["patches"][:1]
    layout = TaxelLayout.from_dict(described(shapes=shapes, patches=patches, joins=[]))
    for name in ("original", "slanted", "dense"):
        expected = set(map(tuple, grid(3, 5, 0.002).edge_index(name).t().tolist()))
        assert set(map(tuple, layout.edge_index(name).t().tolist())) == expected


def test_own_adjacency_stands_beside_the_four():
    content = described(adjacency={"ring": [[0, 7]]})
    assert expand_patches(content)["adjacency"].keys() == {
        "sparse", "slanted", "original", "dense", "ring"
    }  # fmt: skip


def test_description_is_not_edited():
    content = described()
    before = json.dumps(content)
    expand_patches(content)
    assert json.dumps(content) == before


def shape(**changes):
    return {"shapes": {"tile": {**TILE, **changes}}}


def patches(**changes):
    return {"patches": [{**described()["patches"][0], **changes}], "joins": []}


def without(key, item):
    return {name: value for name, value in item.items() if name != key}


def join(**changes):
    return {"joins": [{**described()["joins"][0], **changes}]}


FAN = {"kind": "fan", "from": ["low", "top"], "to": ["high", "bottom"]}
LOW = described()["patches"][0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"patches": [{}]}, r"a patch must have the key 'name' \(got \[\]\)"),
        ({"patches": ["low"]}, r"a patch must be a JSON object \(got 'low'\)"),
        ({"patches": [LOW, LOW]}, "'patches' must have different names"),
        ({"patches": [without("shape", LOW)]}, "patch 'low' must have the key 'shape'"),
        (
            patches(shape="round"),
            r"shape of patch 'low' must be one of \['dome', 'tile'\] \(got 'round'\)",
        ),
        (patches(row=[0, 1, 1]), "'column' and 'row' of patch 'low' must be at right angles"),
        ({"shapes": {"tile": without("rows", TILE)}}, "shape 'tile' must have the key 'rows'"),
        ({"shapes": {"tile": DOME}}, "shape 'tile' must have the key 'column_angle'"),
        (shape(pitch=-2), r"'pitch' of shape 'tile' must not be negative \(got -2\)"),
        (shape(pitch=0), "'pitch' of shape 'tile' must not be zero"),
        (shape(kind="ball"), r"must be one of \['capsule', 'planar'\] \(got 'ball'\)"),
        (shape(rows=[2, 1]), r"must be all even or all odd.*\(got \[2, 1\]\)"),
        (shape(rows=[]), r"must have at least one taxel each \(got \[\]\)"),
        (shape(sparse_across=[[0, 1]]), r"a neighbour to their right \(got \[0, 1\]\)"),
        ({"joins": [without("to", FAN)]}, "a join must have the key 'to'"),
        ({"joins": [FAN]}, "a fan must have the key 'straight'"),
        (join(kind="glue"), r"must be 'seam' or 'fan' \(got 'glue'\)"),
        (join(to="high"), r"an end of a join must be \[patch, side\] or .* \(got 'high'\)"),
        (join(to=["high", "top", 0]), r"an end of a join must be \[patch, side\] or .*, 0\]\)"),
        (join(to=["high", "top", 0, 2]), r"must be from 0 to 1 \(got \[0, 2\]\)"),
        (join(to=["high", "top", 0, "1"]), r"must be from 0 to 1 \(got \[0, '1'\]\)"),
        (join(to=["high", "top", 0, 0]), r"must be equally long \(got 2 and 1\)"),
        (join(to=["far", "top"]), r"a join must name patches \(got 'far'\)"),
        (join(to=["high", "front"]), r"the side of a join must be one of .* \(got 'front'\)"),
        (
            {"one_way": {"dense": [{"from": ["low", 0, 0]}]}},
            "a one-way edge must have the key 'to'",
        ),
        (
            {"one_way": {"dense": [{"from": ["low", 0, 0], "to": ["low", 0, 2]}]}},
            r"a one-way edge must join taxels.*\(got \['low', 0, 2\]\)",
        ),
    ],
)
def test_expand_patches_rejects(changes, message):
    with pytest.raises(ValueError, match=message):
        expand_patches(described(**changes))


@pytest.mark.parametrize("key", ["shapes", "patches"])
def test_missing_key(key):
    with pytest.raises(ValueError, match=f"a layout of patches must have the key '{key}'"):
        expand_patches(without(key, described()))


def test_places_and_normals_have_nine_digits():
    shape = {**DOME, "column_angle": 7, "pitch": 1 / 3}
    content = described(shapes={"tile": {**TILE, "pitch": 2 / 3}, "dome": shape})
    content["patches"][0]["shape"] = "dome"
    del content["joins"]
    taxels = expand_patches(content)["taxels"]
    numbers = [number for taxel in taxels for key in ("pos", "normal") for number in taxel[key]]
    assert all(number == round(number, 9) for number in numbers)
    assert any(number != round(number, 8) for number in numbers)
