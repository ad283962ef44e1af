from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from small_models import FINGERS, LAYOUT, samples

from torch_geometric_tactile.nn import MSCNN
from torch_geometric_tactile.nn.models._hand_maps import PATTERNS
from torch_geometric_tactile.sensors import allegro_uskin, allegro_uskin_240, grid

HAND = allegro_uskin_240()
FINGER = ("index", "middle", "ring")
CELLS = {"I": 20, "II": 20, "III": 16, "IV": 18, "V": 21, "VI": 23, "VII": 18}
# The table of the paper; for VI and VII by arithmetic, since it has none.
FC_INPUTS = {
    "I": (1136, 376),
    "II": (1136, 376),
    "III": (912, 304),
    "IV": (1024, 340),
    "V": (1192, 394),
    "VI": (1304, 430),
    "VII": (1024, 340),
}


def patches(phalanx, tip, thumb_phalanx=None, thumb_tip=None):
    sizes = {f"{name}_{i}": phalanx for name in FINGER for i in (1, 2, 3)}
    sizes |= {f"{name}_tip": tip for name in FINGER}
    thumb = thumb_phalanx or phalanx
    return sizes | {"thumb_1": thumb, "thumb_2": thumb, "thumb_tip": thumb_tip or tip}


def digits(finger, thumb):
    return dict.fromkeys(FINGER, finger) | {"thumb": thumb}


def hand(*size):
    return {"hand": size}


# Every size of every map after each convolution.
SIZES = {
    "I": (hand(8, 7), hand(6, 5), hand(5, 4)),
    "II": (patches((2, 2), (4, 2), (3, 2), (4, 2)), hand(8, 6), hand(5, 4)),
    "III": (patches((2, 2), (4, 2)), patches((1, 1), (2, 1), thumb_tip=(3, 1)), hand(4, 4)),
    "IV": (patches((2, 2), (4, 2)), digits((7, 1), (7, 1)), hand(6, 3)),
    "V": (patches((3, 3), (5, 3)), digits((10, 2), (7, 2)), digits((6, 1), (3, 1))),
    "VI": (patches((3, 3), (5, 3)), patches((2, 2), (4, 2)), patches((1, 1), (3, 1))),
    "VII": (digits((8, 2), (6, 2)), digits((6, 1), (4, 1)), digits((5, 1), (3, 1))),
}
# Size of the filters and how many filter sets there are with and without sharing, by stage.
SETS = {
    "I": ([(9, 1, 1)], [(9, 1, 1)], [(4, 1, 1)]),
    "II": ([(9, 1, 9), (6, 1, 2), (9, 1, 4)], [(9, 1, 1)], [(12, 1, 1)]),
    "III": ([(9, 1, 11), (9, 1, 4)], [(4, 1, 11), (6, 1, 3), (4, 1, 1)], [(2, 1, 1)]),
    "IV": ([(9, 1, 11), (9, 1, 4)], [(8, 1, 3), (4, 1, 1)], [(4, 1, 1)]),
    "V": ([(4, 1, 11), (4, 1, 4)], [(10, 1, 3), (10, 1, 1)], [(10, 1, 3), (10, 1, 1)]),
    "VI": ([(4, 1, 11), (4, 1, 4)],) * 3,
    "VII": ([(8, 1, 3), (8, 1, 1)], [(6, 1, 3), (6, 1, 1)], [(2, 1, 3), (2, 1, 1)]),
}


def num_parameters(pattern, channels, shared):
    widths = {3: (3, 14, 28, 56), 1: (1, 5, 9, 18)}[channels]
    hidden = {3: 1200, 1: 400}[channels]
    total = (CELLS[pattern] * widths[-1] + 16 + 1) * hidden + (hidden + 1) * 20
    for i, stage in enumerate(SETS[pattern]):
        for cells, sets_if_shared, sets in stage:
            number = sets_if_shared if shared else sets
            total += number * (cells * widths[i] + 1) * widths[i + 1]
    return total


def given(batch_size=3, dtype=torch.float):
    return samples(batch_size, 240, 3, dtype=dtype), samples(batch_size, 16, dtype=dtype, seed=1)


def model_of(pattern, dtype=torch.float, **more):
    torch.manual_seed(0)
    return MSCNN(HAND, pattern=pattern, hidden_channels=7, **more).to(dtype)


def test_repr():
    assert str(MSCNN()) == "MSCNN(240, 20, pattern='IV', channels=3, num_joints=16)"
    shared = MSCNN(FINGERS, 3, pattern="VI", share_weights=True, channels=1, num_joints=0)
    expected = "MSCNN(11, 3, pattern='VI', share_weights=True, channels=1, num_joints=0)"
    assert str(shared) == expected
    assert repr(shared.stages[0].convs[0]) == (
        "MapConv(1, 5, maps=3, size=(4, 4), filter=(2, 2), stride=1, share_weights=True)"
    )


@pytest.mark.parametrize("channels", [3, 1])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_sizes_are_those_of_the_paper(pattern, channels):
    model = MSCNN(pattern=pattern, channels=channels)
    found = tuple({one.name: one.size for one in stage.maps} for stage in model.stages)
    assert found == SIZES[pattern]
    assert model.head.in_channels == FC_INPUTS[pattern][channels == 1]
    assert model.head.in_channels == CELLS[pattern] * {3: 56, 1: 18}[channels] + 16
    assert model.head.widths == ({3: 1200, 1: 400}[channels],)
    x, joint = given(2)
    assert model(x, joint=joint).shape == (2, 20)


@pytest.mark.parametrize("shared", [False, True], ids=["different", "shared"])
@pytest.mark.parametrize("channels", [3, 1])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_number_of_parameters(pattern, channels, shared):
    with torch.device("meta"):
        model = MSCNN(pattern=pattern, channels=channels, share_weights=shared)
    found = sum(parameter.numel() for parameter in model.parameters())
    assert found == num_parameters(pattern, channels, shared)


def test_pattern_1_shares_nothing_and_all_others_do():
    for pattern in PATTERNS:
        counts = [num_parameters(pattern, 3, shared) for shared in (False, True)]
        assert (counts[0] == counts[1]) == (pattern == "I")


def test_thumb_of_pattern_2_has_its_own_filters():
    convs = model_of("II", share_weights=True).stages[0].convs
    found = {(conv.in_size, conv.filter_size, conv.num_maps, len(conv.weight)) for conv in convs}
    assert found == {
        ((4, 4), (3, 3), 9, 1),
        ((6, 4), (3, 3), 4, 1),
        ((4, 4), (2, 3), 2, 1),
    }


def maps_by_name(layout, level):
    """Which taxel is on each cell of each map, straight from the layout's tables."""
    if level == "hand":
        chosen = {"hand": torch.ones(len(layout), dtype=torch.bool)}
    elif level == "finger":
        chosen = {n: layout.digit == i for i, n in enumerate(layout.digit_names)}
    else:
        chosen = {n: layout.patch == i for i, n in enumerate(layout.patch_names)}
    maps = {}
    for name, mask in chosen.items():
        place = layout.image_map[mask] - layout.image_map[mask].amin(dim=0)
        cell = torch.full(tuple((place.amax(dim=0) + 1).tolist()), -1)
        cell[place[:, 0], place[:, 1]] = mask.nonzero().view(-1)
        maps[name] = cell
    return maps


def parts_of(name):
    """The maps that a finger or the hand is put together of: fingertip first."""
    if name == "hand":
        return (*FINGER, "thumb")
    return [f"{name}_{i}" for i in (("tip", 2, 1) if name == "thumb" else ("tip", 3, 2, 1))]


def naive(model, x, joint):
    """The network with one torch.nn.functional.conv2d for each map, as the paper draws it."""
    table = PATTERNS[model.pattern]
    x = x[..., 2:] if model.num_channels == 1 else x
    padded = F.pad(x, (0, 0, 0, 1))  # -1 is the last one, zero
    maps = {
        n: padded[:, c].permute(0, 3, 1, 2) for n, c in maps_by_name(HAND, table[0].level).items()
    }
    for stage, convs in zip(table, model.stages, strict=True):
        if stage.level in ("finger", "hand") and "index_tip" in maps:
            maps = {n: torch.cat([maps[p] for p in parts_of(n)], 2) for n in (*FINGER, "thumb")}
        if stage.level == "hand" and "index" in maps:
            maps = {"hand": torch.cat([maps[p] for p in parts_of("hand")], 3)}
        out = {}
        for conv, names in groups_of(convs, maps, stage):
            for i, name in enumerate(names):
                k = 0 if model.share_weights else i
                weight = conv.weight[k].permute(3, 2, 0, 1)
                bias, stride = conv.bias[k], stage.stride
                out[name] = F.conv2d(maps[name], weight, bias, stride=stride).relu()
        maps = {name: out[name] for name in (one.name for one in convs.maps)}
    rows = {name: value.flatten(2).transpose(1, 2) for name, value in maps.items()}
    order = [name for _, names in groups_of(convs, maps, None) for name in names]
    return model.head(torch.cat([torch.cat([rows[n] for n in order], 1).flatten(1), joint], 1))


def groups_of(convs, maps, stage):
    """Each MapConv with the names of its maps, by the cells that it writes."""
    first = 0
    for conv in convs.convs:
        cells = conv.num_maps * conv.out_size[0] * conv.out_size[1]
        inside = [one for one in convs.maps if first <= one.cell.min() < first + cells]
        inside.sort(key=lambda one: one.cell.min())
        yield conv, [one.name for one in inside]
        first += cells


@pytest.mark.parametrize("shared", [False, True], ids=["different", "shared"])
@pytest.mark.parametrize("channels", [3, 1])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_all_maps_at_once_are_one_convolution_after_the_other(pattern, channels, shared):
    model = model_of(pattern, torch.double, channels=channels, share_weights=shared)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    x, joint = given(dtype=torch.double)
    x.requires_grad_()
    found, expected = model(x, joint=joint), naive(model, x, joint)
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)
    leaves = [x, *model.parameters()]
    grads = [torch.autograd.grad(out.square().sum(), leaves) for out in (found, expected)]
    for ours, theirs in zip(*grads, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-8, atol=1e-8)


def test_value_by_hand():
    # Filters of ones sum up what is below them; with VI each patch ends in one cell, to which one
    # way leads from each of its corners.
    model = MSCNN(FINGERS, 1, pattern="VI", channels=1, num_joints=2, hidden_channels=1)
    widths = (5, 9)
    with torch.no_grad():
        for name, weight in model.named_parameters():
            weight.fill_(1.0 if name.endswith("weight") else 0.0)
    x = torch.arange(1.0, 12).view(1, 11, 1)
    total = 18 * widths[0] * widths[1] * x.sum()
    assert model(x, joint=torch.tensor([[0.5, 2.0]])).item() == total + 2.5


def test_one_channel_is_the_normal_force():
    model = model_of("IV", channels=1)
    x, joint = given()
    out = model(x, joint=joint)
    assert torch.equal(model(x[..., 2:], joint=joint), out)
    changed = x.clone()
    changed[..., :2] += 1.0
    assert torch.equal(model(changed, joint=joint), out)
    assert not torch.equal(model(x + 1.0, joint=joint), out)


def test_order_of_taxels_in_the_layout_does_not_matter():
    order = torch.randperm(240, generator=torch.Generator().manual_seed(0))
    parts = {key: getattr(HAND, key)[order] for key in ("pos", "patch", "digit", "image_map")}
    turned = replace(
        HAND,
        name="turned",
        normal=None,
        tangent=None,
        link=None,
        adjacency={},
        link_names=("a",),
        **parts,
    )
    x, joint = given()
    for pattern in PATTERNS:
        torch.manual_seed(0)
        other = MSCNN(turned, pattern=pattern, hidden_channels=7)
        out = other(x[:, order], joint=joint)
        torch.testing.assert_close(out, model_of(pattern)(x, joint=joint), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_taxel_and_joint_counts_but_at_the_edge_of_pattern_1(pattern):
    model = model_of(pattern, torch.double)
    x, joint = given(20, torch.double)
    x.requires_grad_()
    joint.requires_grad_()
    model(x, joint=joint).square().sum().backward()
    seen = (x.grad != 0).any(dim=0).any(dim=1)
    # With a stride of two no filter of pattern I reaches the last row and column.
    row, column = HAND.image_map.T
    assert seen.equal((row < 17) & (column < 15) if pattern == "I" else torch.ones_like(seen))
    assert (joint.grad != 0).any(dim=0).all()


@pytest.mark.parametrize("channels", [3, 1])
def test_weights_begin_as_in_the_paper(channels):
    torch.manual_seed(0)
    model = MSCNN(pattern="IV", channels=channels)
    for name, parameter in model.named_parameters():
        if name.endswith("bias"):
            assert not parameter.any()
        else:
            assert parameter.abs().max() <= 0.2
            if parameter.numel() > 3000:  # cut at two deviations, a normal has 0.88 of them left
                assert parameter.std().item() == pytest.approx(0.088, abs=0.003)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    model.reset_parameters()
    after = model.state_dict()
    assert all(not torch.equal(before[n], after[n]) for n in after if n.endswith("weight"))


@pytest.mark.full
@pytest.mark.parametrize("pattern", ["I", "II", "IV", "VII"])
def test_compiles_in_one_graph(pattern):
    torch.compiler.reset()
    model, (x, joint) = model_of(pattern), given()
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(x, joint=joint), model(x, joint=joint))


def side_by_side():
    place = HAND.image_map.clone()
    base = HAND.patch == HAND.patch_names.index("index_1")
    place[base] += torch.tensor([-4, 30])
    return replace(HAND, image_map=place)


def across():
    digit = HAND.digit.clone()
    digit[0] = 3
    return replace(HAND, digit=digit)


def without_thumb():
    names = [name if name != "thumb" else "other" for name in HAND.digit_names]
    return replace(HAND, digit_names=tuple(names))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: MSCNN(pattern="VIII"), r"'pattern' must be one of \['I', .*\] \(got 'VIII'\)"),
        (lambda: MSCNN(pattern=4), r"'pattern' must be one of .* \(got 4\)"),
        (lambda: MSCNN(channels=2), r"'channels' must be 3 or 1 \(got 2\)"),
        (lambda: MSCNN(LAYOUT), r"on which no patch overlaps another \(got 'first' of 'small'\)"),
        (lambda: MSCNN(allegro_uskin()), r"patches of a digit one above the other \(got 'palm_"),
        (lambda: MSCNN(side_by_side()), r"the patches of a digit one above the other \(got "),
        (lambda: MSCNN(across()), r"'layout' must have each patch on one digit \(got 'index_1' on"),
        (
            lambda: MSCNN(without_thumb()),
            r"neighbouring maps the same number of rows \(got {.*'other': \(5, ",
        ),
        (
            lambda: MSCNN(FINGERS, pattern="IV"),
            r"filters that fit on its maps \(got \(2, 2\) for \(1",
        ),
        (lambda: MSCNN(grid(3, 3, 0.01)), r"filters that fit .* for \(1, 1\) cells of 'digit'"),
    ],
)
def test_bad_input_is_refused(make, match):
    with pytest.raises(ValueError, match=match):
        make()
