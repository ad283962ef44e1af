"""Random transforms of readings, for training."""

import math
from dataclasses import replace

import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, biotac, grid
from torch_geometric_tactile.transforms import (
    DropPatches,
    DropTaxels,
    RandomContrast,
    RandomGain,
    RandomInversion,
    RandomMirror,
    RandomNoise,
    RandomOffset,
    RandomShift,
    RandomTimeShift,
)

PAD = grid(3, 4, 0.01)
PATCHES = replace(PAD, patch=torch.arange(12) // 4, patch_names=("a", "b", "c"))
HALVES = [0, 0, 1, 1] * 3


def samples(num_samples=5, **kwargs):
    draw = torch.Generator().manual_seed(0)
    return StaticData(x=torch.rand(num_samples, 12, 2, generator=draw), **kwargs)


def makers():
    return [
        lambda **own: RandomNoise(0.5, **own),
        lambda **own: RandomGain(0.5, **own),
        lambda **own: RandomGain(0.5, HALVES, **own),
        lambda **own: RandomOffset(0.5, HALVES, **own),
        lambda **own: RandomMirror(PAD, **own),
        lambda **own: RandomMirror(PAD, along="rows", negate=1, **own),
        lambda **own: RandomShift(PAD, 1, 2, **own),
        lambda **own: RandomInversion(**own),
        lambda **own: RandomContrast(0.5, 2.0, **own),
        lambda **own: RandomContrast(0.5, 2.0, center=0.25, **own),
        lambda **own: RandomTimeShift(1, **own),
        lambda **own: DropTaxels(0.5, **own),
        lambda **own: DropPatches(PATCHES, 0.5, **own),
    ]


MOVED = RandomMirror | RandomShift | RandomTimeShift | DropTaxels | DropPatches
ALL = pytest.mark.parametrize("make", makers(), ids=lambda make: repr(make()))


def seeded(transform, data, seed=0):
    torch.manual_seed(seed)
    return transform(data).x


DRAWN = [  # numbers 0, 25 and 50 of three samples: what a seed draws stays as it is
    [0.491565, 0.619412, 1.277045],
    [0.493934, 0.316324, 0.637435],
    [0.493934, 0.656241, 0.775346],
    [0.491565, 0.724245, 0.764053],
    [0.490093, 0.552907, 0.698441],
    [0.697668, 0.552907, 0.519091],
    [0.0, 0.929799, 0.593172],
    [0.503743, 0.552907, 0.18022],
    [0.527104, 0.631975, 0.718456],
    [0.556438, 0.750503, 0.610509],
    [0.496257, 0.419408, 0.997067],
    [0.0, 0.0, 0.81978],
    [0.0, 0.0, 0.0],
]


@pytest.mark.parametrize(("make", "drawn"), [*zip(makers(), DRAWN, strict=True)])
def test_draws_of_a_seed(make, drawn):
    out = seeded(make(), samples(3)).view(-1)
    assert out[[0, 25, 50]].tolist() == pytest.approx(drawn, abs=1e-6)


@ALL
def test_stacked_samples_batches_and_a_loop_draw_alike(make):
    data = samples()
    static = seeded(make(), data.index_select(slice(None)))
    batch = seeded(make(), Batch.from_data_list(data.to_data_list()))
    torch.manual_seed(0)
    loop = torch.stack([make()(data.sample(i)).x for i in range(5)])
    assert static.equal(batch.view(5, 12, 2))
    assert static.equal(loop)
    assert not static.equal(data.x)


@ALL
def test_samples_are_drawn_one_by_one(make):
    x = samples(1).x.expand(64, 12, 2)
    out = seeded(make(), StaticData(x=x))
    assert len(out.unique(dim=0)) > 1
    assert not out.equal(seeded(make(), StaticData(x=x), seed=1))


@ALL
def test_own_generator_leaves_the_global_one_alone(make):
    outs = []
    for seed in (0, 0, 1):
        state = torch.get_rng_state()
        outs.append(make(generator=torch.Generator().manual_seed(seed))(samples(64)).x)
        assert torch.get_rng_state().equal(state)
    assert outs[0].equal(outs[1])
    assert not outs[0].equal(outs[2])


@ALL
def test_caller_is_not_edited_and_missing_readings_stay(make):
    data = samples()
    data.x[:, 3:5] = torch.nan
    before = data.x.clone()
    out = seeded(make(), data)
    assert data.x.nan_to_num().equal(before.nan_to_num())
    if not isinstance(make(), MOVED):
        assert out.isnan().equal(before.isnan())


@ALL
def test_integers(make):
    out = make()(Data(x=torch.arange(24).view(12, 2)))
    assert out.x.shape == (12, 2)


def test_noise_has_its_deviation_and_is_normal():
    torch.manual_seed(0)
    out = RandomNoise(2.0)(Data(x=torch.full((200_000, 1), 7.0))).x - 7
    assert float(out.mean().abs()) < 0.02
    assert float(out.std()) == pytest.approx(2.0, abs=0.02)
    for bound in (1.0, 2.0, 3.0):
        share = float((out.abs() < 2 * bound).double().mean())
        assert share == pytest.approx(math.erf(bound / 2**0.5), abs=0.005)
    assert out.isfinite().all()


def test_noise_of_the_rarest_draws_is_finite_and_symmetric(monkeypatch):
    ends = torch.tensor([0.0, 1 - 2.0**-24])
    monkeypatch.setattr(torch, "rand", lambda *args, **kwargs: ends)
    low, high = RandomNoise(1.0)(Data(x=torch.zeros(2, 1))).x.view(-1).tolist()
    assert low == pytest.approx(-high)
    assert 5 < high < 5.6


def test_gains_and_offsets_are_those_of_segments_samples_and_channels():
    data = samples(200)
    gain = seeded(RandomGain(0.3, HALVES), data) / data.x
    offset = seeded(RandomOffset(0.3, HALVES), data) - data.x
    for drawn in (gain.log(), offset):
        halves = drawn[:, [0, 2]]
        spread = drawn - halves[:, HALVES]
        assert float(spread.abs().max()) < 1e-5
        assert float(halves.std()) == pytest.approx(0.3, abs=0.03)
        assert len(halves.unique()) == 200 * 2 * 2
    assert float(gain.min()) > 0
    whole = seeded(RandomGain(0.3), data) / data.x
    assert float((whole - whole[:, :1]).abs().max()) < 1e-5


def test_segments_of_a_layout():
    hand = allegro_uskin()
    x = torch.ones(384, 1)
    gain = seeded(RandomGain(0.5, "digit", hand), Data(x=x))
    assert len(gain.unique()) == 5
    for digit in range(5):
        assert len(gain[hand.digit == digit].unique()) == 1


def test_mirrors_by_hand():
    x = torch.arange(12.0).view(12, 1).repeat(1, 2)
    image = torch.arange(12.0).view(3, 4)
    columns = RandomMirror(PAD, p=1.0, negate=0)(Data(x=x)).x
    assert columns[:, 1].view(3, 4).equal(image.flip(1))
    assert columns[:, 0].equal(-columns[:, 1])
    rows = RandomMirror(PAD, p=1.0, along="rows")(Data(x=x)).x
    assert rows[:, 0].view(3, 4).equal(image.flip(0))
    assert RandomMirror(PAD, p=0.0, negate=0)(Data(x=x)).x.equal(x)


@pytest.mark.parametrize("make", [lambda **p: RandomMirror(PAD, **p), RandomInversion])
def test_changed_twice_is_as_before_and_half_of_the_samples_are(make):
    data = StaticData(x=torch.arange(24.0).view(1, 12, 2).expand(2000, 12, 2) / 32)
    always = make(p=1.0)
    assert always(always(data)).x.equal(data.x)
    out = seeded(make(), data)
    same = (out == data.x).flatten(1).all(dim=1)
    assert float(same.double().mean()) == pytest.approx(0.5, abs=0.05)
    assert out[~same].equal(always(data).x[~same])


def test_mirror_of_shear_is_that_of_a_mirrored_touch():
    """A radial field of shear about the middle of a grid is its own mirror image."""
    middle = PAD.pos - PAD.pos.mean(dim=0)
    x = torch.cat([middle[:, :2], middle.norm(dim=1, keepdim=True)], dim=1)
    for along, channel in (("columns", 0), ("rows", 1)):
        out = RandomMirror(PAD, p=1.0, along=along, negate=channel)(Data(x=x)).x
        torch.testing.assert_close(out, x)


def test_inversions_by_hand():
    x = torch.tensor([[0.0, 1.0], [0.25, torch.nan], [0.75, 0.5]])
    out = RandomInversion(p=1.0)(Data(x=x)).x
    torch.testing.assert_close(
        out, torch.tensor([[1.0, 0.0], [0.75, torch.nan], [0.25, 0.5]]), equal_nan=True
    )
    assert RandomInversion(p=0.0)(Data(x=x)).x.nan_to_num(9).equal(x.nan_to_num(9))
    counts = Data(x=torch.tensor([[0.0], [4095.0]]))
    assert RandomInversion(1.0, high=4095.0)(counts).x.view(-1).tolist() == [4095.0, 0.0]


def test_contrasts_by_hand():
    x = torch.tensor([[0.0, 0.5], [0.25, torch.nan], [0.5, 0.7]])
    out = RandomContrast(2.0, 2.0)(Data(x=x)).x  # about 0.25 and 0.6
    expected = torch.tensor([[0.0, 0.4], [0.25, torch.nan], [0.75, 0.8]])
    torch.testing.assert_close(out, expected, equal_nan=True)
    out = RandomContrast(3.0, 3.0, center=0.5)(Data(x=x)).x
    expected = torch.tensor([[0.0, 0.5], [0.0, torch.nan], [0.5, 1.0]])
    torch.testing.assert_close(out, expected, equal_nan=True)
    assert RandomContrast(0.0, 0.0)(Data(x=x[:, :1])).x.unique().tolist() == [0.25]
    missing = torch.full((3, 1), torch.nan)
    assert RandomContrast()(Data(x=missing)).x.isnan().all()


def test_contrast_has_one_factor_a_sample_within_its_bounds():
    data = StaticData(x=torch.tensor([[0.4, 0.4], [0.6, 0.6]]).expand(2000, 2, 2))
    out = seeded(RandomContrast(0.5, 1.5), data)
    factor = (out[:, 1, 0] - out[:, 0, 0]) / 0.2
    assert out[..., 0].equal(out[..., 1])
    assert 0.5 <= float(factor.min()) < 0.51
    assert 1.49 < float(factor.max()) <= 1.5001
    assert float(factor.mean()) == pytest.approx(1.0, abs=0.02)
    for dtype in (torch.float32, torch.float64):
        assert RandomContrast()(Data(x=torch.ones(3, 1, dtype=dtype))).x.dtype == dtype


def test_shifts_by_hand():
    image = 1 + torch.arange(12.0).view(3, 4)
    found = set()
    torch.manual_seed(0)
    data = StaticData(x=image.view(1, 12, 1).expand(2000, 12, 1))
    for out in RandomShift(PAD, 1, 2, value=-5.0)(data).x.unique(dim=0).view(-1, 3, 4):
        padded = torch.nn.functional.pad(image, (2, 2, 1, 1), value=-5.0)
        fits = [
            (row, column)
            for row in (-1, 0, 1)
            for column in (-2, -1, 0, 1, 2)
            if out.equal(padded[1 - row : 4 - row, 2 - column : 6 - column])
        ]
        assert len(fits) == 1
        found.add(fits[0])
    assert len(found) == 15


def test_shifts_are_drawn_equally_often():
    data = StaticData(x=(1 + torch.arange(12.0)).view(1, 12, 1).expand(30_000, 12, 1))
    first = seeded(RandomShift(PAD, 0, 1), data)[:, 5, 0]
    shares = torch.stack([first == value for value in (5.0, 6.0, 7.0)]).double().mean(dim=1)
    assert shares.tolist() == pytest.approx([1 / 3] * 3, abs=0.015)


def test_shift_beyond_the_grid_is_at_rest():
    pad = grid(1, 2, 0.01)
    data = StaticData(x=torch.ones(500, 2, 1))
    out = seeded(RandomShift(pad, 0, 3, value=9.0), data)
    assert {tuple(row) for row in out.view(-1, 2).tolist()} == {(1, 1), (1, 9), (9, 1), (9, 9)}


def test_shifts_in_time_by_hand():
    """Of two channels, all taxels of a sample alike."""
    frames = torch.tensor([1.0, 2.0, 3.0, 10.0, 20.0, 30.0])
    data = StaticData(x=torch.stack([frames, -frames]).expand(3000, 2, 6))
    out = seeded(RandomTimeShift(2, num_frames=3), data)
    assert out[:, 0].equal(-out[:, 1])
    kinds, counts = out[:, 0].unique(dim=0, return_counts=True)
    assert kinds.tolist() == [
        [1, 1, 1, 10, 10, 10],
        [1, 1, 2, 10, 10, 20],
        [1, 2, 3, 10, 20, 30],
        [2, 3, 3, 20, 30, 30],
        [3, 3, 3, 30, 30, 30],
    ]
    assert (counts / 3000).tolist() == pytest.approx([0.2] * 5, abs=0.03)


def test_shifts_in_time_further_than_the_frames_and_of_no_features():
    out = seeded(RandomTimeShift(50), StaticData(x=torch.tensor([[[1.0, 2.0]]]).expand(500, 1, 2)))
    assert {tuple(row) for row in out.view(-1, 2).tolist()} == {(1, 1), (1, 2), (2, 2)}
    assert RandomTimeShift()(Data(x=torch.zeros(3, 0))).x.shape == (3, 0)


class Pads(StaticDataset):
    layout = PAD

    def read(self):
        data = samples(32, edge_index=PAD.edge_index("original"))
        data.y = torch.arange(32) % 2
        return data, {}


@ALL
def test_keyed_batches_follow_from_epoch_and_number(make):
    """What is drawn does not depend on what was drawn before."""

    def epochs(noise):
        torch.manual_seed(0)
        dataset = Pads()
        dataset.transform = make()
        loader = StaticLoader(dataset, batch_size=8, keyed=True)
        out = []
        for _ in range(2):
            for batch in loader:
                torch.rand(noise)
                out.append(batch.x)
        return out

    first, second = epochs(1), epochs(1)
    assert all(a.equal(b) for a, b in zip(first, second, strict=True))
    assert not torch.cat(first[:4]).equal(torch.cat(first[4:]))


@ALL
def test_only_training_batches_are_augmented(make):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    from torch_geometric_tactile.training import TactileDataModule

    data = TactileDataModule(Pads(), split="frame", val=0.25, train_transform=make(), batch_size=24)
    data.setup()
    (train,) = data.train_dataloader()
    (val,) = data.val_dataloader()
    given = Pads().data.x
    assert all(any(row.equal(other) for other in given) for row in val.x)
    assert not all(any(row.equal(other) for other in given) for row in train.x)


@pytest.mark.parametrize("make", [RandomNoise, RandomGain, RandomOffset])
def test_bad_deviations(make):
    for std in (-0.1, torch.inf, torch.nan):
        with pytest.raises(ValueError, match=r"'std' must be at least 0 and finite \(got "):
            make(std)


@pytest.mark.parametrize("make", [RandomGain, RandomOffset])
def test_bad_segments(make):
    with pytest.raises(ValueError, match="'segments' requires a 'layout' if it is a name"):
        make(0.1, "digit")
    with pytest.raises(ValueError, match=r"must have 12 taxels, as in its segments \(got 3\)"):
        make(0.1, HALVES)(Data(x=torch.zeros(3, 1)))


LOPSIDED = TaxelLayout("hook", torch.eye(3), image_map=[[0, 0], [1, 0], [1, 1]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RandomMirror(biotac()), r"RandomMirror needs a layout with an image map .*biotac"),
        (lambda: RandomShift(biotac()), r"RandomShift needs a layout with an image map .*biotac"),
        (lambda: RandomMirror(PAD, p=1.5), r"'p' must be a probability .* 0 and 1 \(got 1.5\)"),
        (lambda: RandomMirror(PAD, along="x"), r"'along' must be one of .* \(got 'x'\)"),
        (lambda: RandomMirror(PAD, negate=-1), r"'negate' must be a channel, .* \(got -1\)"),
        (
            lambda: RandomMirror(LOPSIDED),
            r"layout 'hook' must be symmetric along its columns \(got no taxel opposite to taxel 0",
        ),
        (lambda: RandomShift(PAD, rows=-1), r"'rows' must be an integer .* 0 and 100 \(got -1\)"),
        (lambda: RandomShift(PAD, columns=1.5), r"'columns' must be an integer .* \(got 1.5\)"),
        (lambda: RandomInversion(p=2), r"'p' must be a probability between 0 and 1 \(got 2\)"),
        (lambda: RandomInversion(low=1.0), r"'low' must be below 'high', .* \(got 1.0 and 1.0\)"),
        (lambda: RandomInversion(high=math.inf), r"both finite \(got 0.0 and inf\)"),
        (lambda: RandomContrast(-0.1), r"'low' must be at least 0 .* \(got -0.1 and 1.5\)"),
        (lambda: RandomContrast(2.0, 1.0), r"at most 'high', .* \(got 2.0 and 1.0\)"),
        (lambda: RandomContrast(center=math.nan), r"'center' must be a grey .* \(got nan\)"),
        (lambda: RandomTimeShift(-1), r"'steps' must be an integer .* 0 and 100000 \(got -1\)"),
        (lambda: RandomTimeShift(None), r"'steps' must be an integer .* \(got None\)"),
        (lambda: RandomTimeShift(1, 0), r"'num_frames' must be an integer .* 1 and .* \(got 0\)"),
    ],
)
def test_bad_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bad_samples():
    for transform in (RandomMirror(PAD), RandomShift(PAD)):
        with pytest.raises(ValueError, match=r"12 taxels, as in layout 'grid_3x4' \(got 3\)"):
            transform(Data(x=torch.zeros(3, 1)))
    with pytest.raises(
        ValueError, match=r"'negate' must be below the number of channels, 1 \(got 2\)"
    ):
        RandomMirror(PAD, negate=2)(Data(x=torch.zeros(12, 1)))
    with pytest.raises(
        ValueError, match=r"a multiple of 2 features, the number of frames \(got 3\)"
    ):
        RandomTimeShift(1, num_frames=2)(Data(x=torch.zeros(4, 3)))
