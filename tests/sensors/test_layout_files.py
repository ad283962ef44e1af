import json

import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, biotac_sp, grid


def two_taxels(**changes):
    content = {"name": "two", "unit": "mm", "taxels": [{"pos": [0, 0, 0]}, {"pos": [1, 2, 3]}]}
    return {**content, **changes}


def hand():
    return TaxelLayout(
        name="hand",
        pos=torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]]),
        normal=torch.eye(3),
        tangent=torch.eye(3)[torch.tensor([[1, 2], [2, 0], [0, 1]])],
        link=[2, 0, 0],
        patch=[1, 1, 0],
        digit=[1, 0, 1],
        link_names=("base", "spare", "tip"),
        patch_names=("left", "right"),
        digit_names=("index", "thumb"),
        image_map=[[0, 0], [0, 1], [2, 1]],
        adjacency={"chain": [[0, 1], [1, 2]], "none": torch.empty(2, 0)},
        source="invented",
    )


@pytest.mark.parametrize("layout", [hand(), grid(2, 3, pitch=0.004), allegro_uskin(), biotac_sp()])
def test_save_load_gives_the_same_layout(layout, tmp_path):
    layout.save(tmp_path / "layout.json")
    loaded = TaxelLayout.load(tmp_path / "layout.json")
    assert repr(loaded) == repr(layout)
    for key in ("pos", "normal", "tangent", "link", "patch", "digit", "image_map"):
        expected, found = getattr(layout, key), getattr(loaded, key)
        assert (found is None) if expected is None else found.equal(expected)
    for key in ("link_names", "patch_names", "digit_names", "source"):
        assert getattr(loaded, key) == getattr(layout, key)
    assert list(loaded.adjacency) == list(layout.adjacency)
    for name, edges in layout.adjacency.items():
        assert loaded.edge_index(name).equal(edges)
    assert [path.name for path in tmp_path.iterdir()] == ["layout.json"]


@pytest.mark.parametrize(("unit", "metres"), [("m", 2.0), ("mm", 0.002), ("in", 0.0508)])
def test_from_dict_converts_units(unit, metres):
    layout = TaxelLayout.from_dict(two_taxels(unit=unit))
    assert layout.pos[1].tolist() == pytest.approx([metres / 2, metres, metres * 1.5])


def test_from_dict_takes_flat_pads():
    layout = TaxelLayout.from_dict(two_taxels(taxels=[{"pos": [1, 2]}, {"pos": [3, 4]}]))
    assert layout.pos.equal(torch.tensor([[0.001, 0.002, 0.0], [0.003, 0.004, 0.0]]))


def test_load_edited_file_has_the_edit(tmp_path):
    path = tmp_path / "layout.json"
    biotac_sp().save(path)
    content = json.loads(path.read_text())
    content["taxels"][3]["pos"][0] += 0.001
    path.write_text(json.dumps(content))
    moved = TaxelLayout.load(path).pos - biotac_sp().pos
    assert moved[3, 0] == pytest.approx(0.001, rel=1e-4)
    assert moved.count_nonzero() == 1


def test_save_writes_one_taxel_a_line(tmp_path):
    biotac_sp().save(tmp_path / "layout.json")
    lines = (tmp_path / "layout.json").read_text().splitlines()
    assert sum('"pos"' in line for line in lines) == 24


def test_from_dict_names_segments_in_order_of_appearance():
    taxels = [{"pos": [0, 0, 0], "digit": "thumb"}, {"pos": [0, 0, 1], "digit": "index"}]
    layout = TaxelLayout.from_dict(two_taxels(taxels=taxels))
    assert layout.digit_names == ("thumb", "index")
    assert layout.digit.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"unit": "ft"}, r"'unit' must be one of \['m', 'mm', 'in'\] \(got 'ft'\)"),
        ({"taxels": []}, "'taxels' must hold at least one taxel"),
        ({"taxels": [{"pos": [0]}]}, r"taxel 0 must have a 'pos' of two or three .* \(got \[0\]\)"),
        (
            {"taxels": [{"pos": [0, 0]}, {"pos": [0, 0, 0]}]},
            "'pos' must have the same length for all taxels",
        ),
        ({"taxels": [{"pos": [0, 0, 0]}, {}]}, r"taxel 1 must have a 'pos' .* \(got None\)"),
        (
            {"taxels": [{"pos": [0, 0, 0], "link": "a"}, {"pos": [0, 0, 1]}]},
            r"'link' must be given for every taxel or for none \(missing for taxel 1",
        ),
        (
            {"taxels": [{"pos": [0, 0, 0], "link": "a"}], "link_names": ["b"]},
            r"'link_names' must name every link \(got \['b'\] without 'a'\)",
        ),
        ({"adjacency": {"a": [[0, 1], [1]]}}, "adjacency 'a' must be a list of pairs"),
        ({"adjacency": {"a": [[0, 2]]}}, "adjacency 'a' must join taxels 0 to 1"),
    ],
)
def test_load_rejects_and_names_the_file(changes, message, tmp_path):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(two_taxels(**changes)))
    with pytest.raises(ValueError, match=rf"bad\.json' is not a taxel layout: {message}"):
        TaxelLayout.load(path)


@pytest.mark.parametrize("key", ["name", "unit", "taxels"])
def test_from_dict_missing_key(key):
    content = two_taxels()
    del content[key]
    with pytest.raises(ValueError, match=f"a layout must have the key '{key}'"):
        TaxelLayout.from_dict(content)
