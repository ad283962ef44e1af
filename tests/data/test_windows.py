import copy
import logging
import tracemalloc
from itertools import pairwise

import pytest
import torch
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.data import (
    Protocol,
    StaticDataset,
    Trials,
    Windows,
    join_frames,
    split_frames,
)
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import grid

TRIALS = [0] * 5 + [1] * 7 + [2] * 2


def frames_of(trial=TRIALS, **attributes):
    trial = torch.tensor(trial)
    size = len(trial)
    # The value of a reading tells frame, taxel and channel: 100 * frame + 10 * taxel + channel.
    parts = torch.arange(size)[:, None, None] * 100 + torch.arange(4)[:, None] * 10
    values = {"y": trial % 2, "time": torch.arange(size) * 0.01} | attributes
    values = {key: value for key, value in values.items() if value is not None}
    x = (parts + torch.arange(2)).float()
    return StaticDataset.from_arrays(x, trial=trial, layout=grid(2, 2, 0.002), **values)


def test_window_has_channel_outer_and_time_inner():
    window = Windows(frames_of(), 3)[1]
    assert window.x[2].tolist() == [120, 220, 320, 121, 221, 321]
    assert window.num_frames == 3
    frames = split_frames(window.x, window.num_frames)
    assert frames.shape == (4, 3, 2)
    assert frames[2].tolist() == [[120, 121], [220, 221], [320, 321]]
    assert join_frames(frames).equal(window.x)
    swapped = frames.flatten(-2)  # time outer, channel inner
    assert not swapped.equal(window.x)


def test_windows_never_cross_trials_and_short_trials_are_named(caplog):
    with caplog.at_level(logging.WARNING):
        windows = Windows(frames_of(), 3, hop=2)
    assert windows.trial.tolist() == [0, 0, 1, 1, 1]
    assert [int(window.x[0, 0]) for window in windows] == [0, 200, 500, 700, 900]
    assert windows.too_short == ["trial 2"]
    assert (
        "1 of 3 trials are left out because they have fewer than 3 frames: trial 2" in caplog.text
    )
    assert repr(windows) == "Windows(5)"


def test_attributes_are_those_of_the_last_frame_and_series_have_all():
    joint, missing = torch.arange(28.0).view(14, 2), torch.rand(14, 4) > 0.5
    windows = Windows(frames_of(joint=joint, missing=missing), 3, series=["joint"])
    batch = windows.batch([0, 4])
    assert batch.time.tolist() == pytest.approx([0.02, 0.08])
    assert batch.joint.equal(torch.stack([joint[0:3], joint[6:9]]))
    assert batch.missing.equal(missing[[2, 8]])
    assert batch.pos.shape == (4, 3)
    assert windows.joint.shape == (8, 3, 2)
    assert windows.x.equal(windows.data.x)


@pytest.mark.parametrize(
    ("label", "horizon", "expected", "num_beyond"),
    [
        ("last", 0, [2, 3, 4, 7, 8, 9, 10, 11], 0),
        ("ahead", 1, [3, 4, 8, 9, 10, 11], 2),
        ("ahead", 3, [10, 11], 6),
    ],
)
def test_label_of_a_moment(label, horizon, expected, num_beyond):
    frames = frames_of(y=torch.arange(14))
    windows = Windows(frames, 3, label=label, horizon=horizon)
    assert windows.y.tolist() == expected
    assert windows.num_beyond == num_beyond
    assert windows.batch(range(len(windows))).y.tolist() == expected
    assert [int(window.y) for window in windows] == expected


def test_label_of_the_trial_and_other_target():
    slip = torch.tensor([0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 1, 1, 0, 0])
    frames = frames_of(slip=slip)
    assert Windows(frames, 3, label="trial").y.tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    windows = Windows(frames, 3, label="ahead", horizon=1, target="slip")
    assert windows.y.tolist() == [1, 1, 0, 0, 1, 1]
    assert windows.slip.tolist() == [1, 1, 0, 0, 0, 1]
    assert windows.num_classes == 2
    with pytest.raises(ValueError, match=r"'slip' must be the same.*frame 2 of trial 0"):
        Windows(frames, 3, label="trial", target="slip")


def test_class_names_are_those_of_the_target():
    slip, group = torch.arange(14) % 2, ["cup"] * 7 + ["box"] * 7
    frames = frames_of(y=["no", "yes"] * 7, slip=slip, group=group)
    for target, expected in (("y", ["no", "yes"]), ("group", ["box", "cup"]), ("slip", [])):
        assert Windows(frames, 3, target=target).class_names == expected


def test_windows_without_labels():
    windows = Windows(frames_of(y=None), 3)
    assert windows.column("y") is None
    assert "y" not in windows[0]


@pytest.mark.parametrize("index", [slice(0, None, 2), [0, 1, 3, 4, 6, 7, 8], slice(5, 12)])
def test_windows_of_a_selection(index):
    frames = frames_of()
    part = frames[index]
    windows = Windows(part, 2)
    rows = torch.arange(14)[index]
    pairs = [(int(a), int(b)) for a, b in pairwise(rows) if frames.trial[a] == frames.trial[b]]
    assert len(windows) == len(pairs)
    for window, pair in zip(windows, pairs, strict=True):
        assert window.x.equal(join_frames(frames.x[list(pair)].transpose(0, 1)))
        assert window.time.item() == frames.time[pair[1]].item()


def test_selections_copies_and_moves_of_windows():
    windows = Windows(frames_of(), 3, series=["time"])
    part = windows[[6, 2]]
    expected = windows.data.x[[6, 2]]
    assert part.x.equal(expected)
    other = part.copy()
    assert other.x.equal(expected)
    assert other.time.equal(part.time)
    assert other._data.frames.num_samples == 6  # the frames of two windows
    assert other._data.frames.x.data_ptr() != windows.dataset.x.data_ptr()
    moved = copy.copy(part).to("cpu")
    assert moved.x.equal(expected)
    assert part[:1].num_classes == 2
    assert len(windows[:0].data.x) == 0
    assert windows.layout is windows.dataset.layout


def test_splits_by_trial_share_no_trial():
    windows = Windows(frames_of([i // 6 for i in range(60)]), 4)
    parts = Protocol("trial", val=0.2, test=0.3).split(windows)
    trials = [set(windows[part].trial.tolist()) for part in parts]
    assert all(trials)
    assert len(set.union(*trials)) == sum(map(len, trials))


@pytest.mark.parametrize("num_workers", [0, 2])
def test_loaders_give_equal_batches(num_workers):
    joint = torch.rand(14, 3)
    for dataset in (
        Windows(frames_of(joint=joint), 3, series=["joint"]),
        Trials(frames_of(joint=joint), ragged="pad", series=["joint"]),
    ):
        ours = StaticLoader(dataset, 3, num_workers=num_workers)
        theirs = DataLoader(dataset, 3, num_workers=num_workers)
        for a, b in zip(ours, theirs, strict=True):
            batch = a.to_batch()
            assert set(batch.keys()) == set(b.keys())
            for key in b.keys():  # noqa: SIM118
                assert torch.allclose(batch[key], b[key], equal_nan=True)


def double(data):
    data = copy.copy(data)
    data.x = 2 * data.x
    return data


def test_transform_of_the_frames_is_applied():
    frames = frames_of()
    plain = Windows(frames, 3, label="ahead", horizon=1).data
    frames.transform = double
    windows = Windows(frames, 3, label="ahead", horizon=1)
    assert windows.batch(range(6)).x.equal(2 * plain.x)
    assert windows.batch([5]).y.equal(plain.y[5:])
    assert windows[2].x.equal(2 * plain.x[2])
    assert windows.transforms == [double, None]


def test_transforms_of_windows():
    frames = frames_of()
    windows = Windows(frames, 3, transform=double)
    assert windows[1].x.equal(2 * Windows(frames, 3)[1].x)
    windows = Windows(frames, 3, pre_transform=double)
    assert windows.data.x.equal(2 * Windows(frames, 3).data.x)
    assert windows.data.num_frames == 3
    assert windows[4:].copy().x.equal(windows.data.x[4:])


def test_pre_transform_gets_a_few_windows_at_a_time(monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.data._frame_view._CHUNK_BYTES", 200)
    sizes = []

    def seen(data):
        sizes.append(data.num_samples)
        return double(data)

    seen.supports_static = True
    windows = Windows(frames_of(), 3, pre_transform=seen)
    assert sizes == [2, 2, 2, 2]
    assert windows.x.equal(2 * Windows(frames_of(), 3).x)


class Stored(StaticDataset):
    processed_file_names = "data.pt"

    def __init__(self, root):
        self.layout = grid(2, 2, 0.002)
        super().__init__(root)

    def read(self):
        data = copy.copy(frames_of([i // 100 for i in range(20_000)]).data)
        return data, {"class": ["a", "b"]}


def test_windows_take_no_memory_but_the_index(tmp_path):
    frames = Stored(tmp_path)
    storages = {key: frames._data[key].data_ptr() for key in ("x", "y", "time", "trial")}
    tracemalloc.start()
    windows = Windows(frames, 60)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30 * len(frames)  # bytes: a list of the frames takes 36 each, one of tensors more
    held = {key: value for key, value in vars(windows._data).items() if torch.is_tensor(value)}
    assert set(held) == {"starts"}
    assert held["starts"].shape == (200 * 41,)
    assert windows._data.frames is frames._data
    for key, place in storages.items():
        assert windows._data.frames[key].data_ptr() == place
    batch = windows.batch([0, 50])
    assert batch.x.untyped_storage().nbytes() == batch.x.numel() * 4
    assert windows.nbytes == frames.nbytes


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"length": 0}, "'length' must be at least 1"),
        ({"hop": 0}, "'hop' must be at least 1"),
        ({"length": 8}, r"at most 7 frames, the length of the longest trial, trial 1 \(got 8\)"),
        ({"label": "first"}, "'label' must be one of"),
        ({"horizon": 2}, "'horizon' must be 0 with label='last'"),
        ({"label": "ahead"}, "'horizon' must be at least 1 with label='ahead'"),
        (
            {"label": "ahead", "horizon": 5},
            "'horizon' must be within the trial of at least one window",
        ),
        ({"target": "slip"}, r"'target' must name an attribute.*'slip'"),
        ({"target": "pos"}, r"'target' must name an attribute.*'pos'"),
        ({"series": "joint"}, "'series' must be a list of names"),
        ({"series": ["slip"]}, r"attributes that each frame has, .* \(got 'slip'\)"),
        ({"series": ["x"]}, r"attributes that each frame has, .* \(got 'x'\)"),
        ({"series": ["y"]}, r"attributes that each frame has, .* \(got 'y'\)"),
        ({"series": ["pos"]}, r"attributes that each frame has, .* \(got 'pos'\)"),
        ({"series": ["missing"]}, r"'series' must name attributes with one row.*each node"),
    ],
)
def test_windows_with_bad_arguments(arguments, match):
    frames = frames_of(missing=torch.zeros(14, 4, dtype=torch.bool))
    with pytest.raises(ValueError, match=match):
        Windows(frames, **({"length": 3} | arguments))


def test_windows_of_frames_in_another_order():
    time = torch.arange(14) * 0.01
    with pytest.raises(ValueError, match=r"0.03.* s, not increasing, in frame 3 of trial 1"):
        Windows(frames_of(time=torch.where(torch.arange(14) == 8, 0.035, time)), 3)
    with pytest.raises(ValueError, match=r"repeated, in frame 1 of trial 2"):
        Windows(frames_of(time=torch.where(torch.arange(14) == 13, time[12], time)), 3)
    with pytest.raises(ValueError, match=r"in frame 4 of trial 0"):
        Windows(frames_of(time=torch.where(torch.arange(14) == 4, torch.nan, time)), 3)
    with pytest.raises(ValueError, match=r"trial 0 up to sample 2, and again from sample 5"):
        Windows(frames_of([0, 0, 0, 1, 1, 0, 0]), 2)
    assert len(Windows(frames_of(time=None), 3)) == 8


@pytest.mark.parametrize("make", [lambda frames: Windows(frames, 3), Trials])
def test_frames_without_time_that_go_back_within_a_trial(make):
    frames = frames_of([0] * 6 + [1] * 6, time=None)
    backwards = [5, 4, 3, 2, 1, 0, 6, 7, 8, 9, 10, 11]
    match = r"sample 4 after sample 5, in frame 1 of trial 0\): sort the selection"
    with pytest.raises(ValueError, match=match):
        make(frames[backwards])
    with pytest.raises(ValueError, match=r"sample 7 after sample 7, in frame 2 of trial 1"):
        make(frames[[*range(6), 6, 7, 7, 8, 9, 10]])
    torch.manual_seed(0)
    with pytest.raises(ValueError, match=r"must be in the order .* of trial 1"):
        make(frames[6:].shuffle())
    assert make(frames[::2])[0].time is None
    others_first = frames[[*range(6, 12), *range(6)]]
    assert make(others_first).column("trial").unique_consecutive().tolist() == [1, 0]


def test_windows_of_what_is_no_frames():
    frames = frames_of()
    with pytest.raises(TypeError, match="must be a StaticDataset of frames"):
        Windows([frames[0]], 3)
    with pytest.raises(ValueError, match="must hold frames"):
        Windows(Windows(frames, 3), 2)
    with pytest.raises(ValueError, match="at least one frame"):
        Windows(frames[:0], 3)
    x = torch.rand(4, 4, 1)
    with pytest.raises(ValueError, match="must have a 'trial'"):
        Windows(StaticDataset.from_arrays(x, layout=grid(2, 2, 0.002)), 2)


def test_one_taxel_and_one_frame():
    x = torch.rand(3, 1, 2)
    trial = torch.zeros(3, dtype=torch.long)
    frames = StaticDataset.from_arrays(x, trial=trial, layout=grid(1, 1, 0.002))
    assert Windows(frames, 1).x.equal(x)
    assert Trials(frames).x.equal(join_frames(x.transpose(0, 1)[None])[0][None])
