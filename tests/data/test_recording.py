import pickle
import re

import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sensors import grid

NAN = float("nan")


def recording(num_frames=4, num_taxels=2, num_channels=3, **kwargs):
    size = num_frames * num_taxels * num_channels
    tactile = np.arange(size, dtype=np.float32).reshape(num_frames, num_taxels, num_channels)
    return Recording(np.arange(num_frames) * 0.01, tactile, **kwargs)


def test_recording_counts_and_rate_by_hand():
    rec = recording(joint=np.zeros((4, 5)), label=3)
    assert (rec.num_frames, rec.num_taxels, rec.num_channels, rec.num_joints) == (4, 2, 3, 5)
    assert rec.duration == pytest.approx(0.03)
    assert rec.rate == pytest.approx(100)
    assert rec.tactile[1, 1].tolist() == [9, 10, 11]


def test_actions_are_numbers_of_any_size_and_may_be_missing():
    rec = recording(action=[[1000, 2], [np.nan, 3], [4, 5], [6, 7]])
    assert (rec.num_actions, rec.action.dtype) == (2, np.float32)
    assert np.isnan(rec.action).nonzero()[0].tolist() == [1]
    assert recording().num_actions == 0


def test_recording_rate_ignores_a_gap():
    rec = Recording([0.0, 0.1, 0.2, 5.0, 5.1], np.zeros((5, 1, 1)))
    assert rec.rate == pytest.approx(10)
    assert rec.duration == pytest.approx(5.1)
    assert recording(2).rate == pytest.approx(100)


def test_recording_types_are_converted_from_lists_tensors_and_integers():
    rec = Recording(
        [0.0, 1.0], torch.ones(2, 1, 1, dtype=torch.int), joint=[[1], [2]], label=np.int64(3)
    )
    assert (rec.time.dtype, rec.tactile.dtype) == (np.float64, np.float32)
    assert rec.joint.dtype == np.float32
    assert type(rec.label) is int


def test_recording_takes_arrays_that_fit_without_a_copy():
    tactile = np.zeros((1, 2, 3), dtype=np.float32)
    assert recording(1).tactile is not tactile
    assert Recording([0.0], tactile).tactile is tactile


def test_recording_repr():
    assert repr(recording()) == "Recording(num_frames=4, num_taxels=2, num_channels=3, rate=100)"
    assert repr(recording(action=np.zeros((4, 2)))) == (
        "Recording(num_frames=4, num_taxels=2, num_channels=3, num_actions=2, rate=100)"
    )
    assert repr(recording(joint=np.zeros((4, 1)), label="cup")) == (
        "Recording(num_frames=4, num_taxels=2, num_channels=3, num_joints=1, rate=100, label='cup')"
    )


def test_recording_repr_names_extra_signals():
    pac = np.zeros((4, 3, 22), np.int16)
    rec = recording(extra={"pressure": np.zeros((4, 3)), "pac": pac})
    assert "num_channels=3, extra=['pac', 'pressure'], rate=100)" in repr(rec)
    assert rec.extra["pac"] is pac


def test_recording_is_frozen_and_can_be_pickled():
    rec = recording(meta={"sensor": "a"}, privileged={"phase": np.arange(4)})
    with pytest.raises(AttributeError):
        rec.label = "cup"
    copy = pickle.loads(pickle.dumps(rec))
    assert copy.meta == {"sensor": "a"}
    assert copy.privileged["phase"].tolist() == [0, 1, 2, 3]


def test_recording_missing_and_dead_taxels():
    tactile = np.zeros((3, 3, 2))
    tactile[:, 2] = NAN
    tactile[1, 0, 1] = NAN
    rec = Recording([0.0, 1.0, 2.0], tactile)
    assert rec.missing.tolist() == [
        [False, False, True],
        [True, False, True],
        [False, False, True],
    ]
    assert rec.dead_taxels.tolist() == [2]


def test_recording_without_frames():
    rec = recording(0, joint=np.zeros((0, 2)))
    assert repr(rec) == "Recording(num_frames=0, num_taxels=2, num_channels=3, num_joints=2)"
    assert rec.duration == 0
    assert np.isnan(rec.rate)
    assert rec.missing.shape == (0, 2)
    assert rec.dead_taxels.tolist() == []
    assert rec.select(slice(0, 5)).num_frames == 0


def test_recording_of_one_frame_and_one_taxel():
    rec = recording(1, 1, 1)
    assert rec.duration == 0
    assert np.isnan(rec.rate)
    assert repr(rec) == "Recording(num_frames=1, num_taxels=1, num_channels=1)"


def test_select_takes_rows_of_everything_and_keeps_the_rest():
    rec = recording(
        joint=np.arange(4.0)[:, None],
        action=np.arange(4.0)[:, None] + 5,
        label="cup",
        meta={"a": 1},
        privileged={"p": np.arange(4)},
        extra={"pac": np.arange(24).reshape(4, 3, 2)},
    )
    part = rec.select(slice(1, None, 2))
    assert part.time.tolist() == [0.01, 0.03]
    assert part.tactile[:, 0, 0].tolist() == [6, 18]
    assert part.joint.ravel().tolist() == [1, 3]
    assert part.action.ravel().tolist() == [6, 8]
    assert part.privileged["p"].tolist() == [1, 3]
    assert part.extra["pac"][:, 0, 0].tolist() == [6, 18]
    assert np.shares_memory(part.extra["pac"], rec.extra["pac"])
    assert (part.label, part.meta) == ("cup", {"a": 1})
    assert np.shares_memory(part.tactile, rec.tactile)


def test_select_refuses_indices_and_backwards():
    with pytest.raises(ValueError, match=r"'frames' must be a slice \(got int\)"):
        recording().select(2)
    with pytest.raises(ValueError, match=r"'frames' must have a positive step \(got -1\)"):
        recording().select(slice(None, None, -1))


def test_check_names_layout_expected_and_got():
    recording(num_taxels=4).check(grid(2, 2, pitch=0.01))
    layout = grid(2, 3, pitch=0.01)
    with pytest.raises(
        ValueError, match=re.escape(f"layout '{layout.name}' must have 6 taxels (got 4)")
    ):
        recording(num_taxels=4).check(layout)


def test_meta_is_a_copy_with_lists_for_tuples():
    meta = {"taxels": (24, 24), "nested": {"a": [1]}}
    rec = recording(meta=meta)
    meta["nested"]["a"].append(2)
    assert rec.meta == {"taxels": [24, 24], "nested": {"a": [1]}}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"time": [[0.0], [1.0]]}, r"'time' must have shape \(num_frames,\) \(got \(2, 1\)\)"),
        ({"time": [0.0, NAN]}, r"'time' must be finite \(got nan in frame 1\)"),
        (
            {"time": [0.5, 0.5]},
            r"'time' must increase \(got 0.5 s in frame 1 after 0.5 s in frame 0\)",
        ),
        ({"time": [0.0, 1.0, 2.0]}, r"'tactile' must have 3 frames, like 'time' \(got 2\)"),
        ({"tactile": np.zeros((2, 3))}, r"num_taxels, num_channels\) \(got \(2, 3\)\)"),
        ({"tactile": np.zeros((2, 0, 3))}, r"\(got \(2, 0, 3\)\)"),
        (
            {"tactile": [[[0.0, 1.0]], [[0.0, -np.inf]]]},
            r"finite readings, or NaN .* \(got -inf in frame 1, taxel 0, channel 1\)",
        ),
        ({"tactile": [[[1e39]], [[0.0]]]}, r"\(got inf in frame 0, taxel 0, channel 0\)"),
        ({"joint": [0.0, 1.0]}, r"'joint' must have shape .* \(got \(2,\)\)"),
        ({"joint": np.zeros((2, 0))}, r"or be None without joints \(got \(2, 0\)\)"),
        ({"joint": [[0.0]]}, r"'joint' must have 2 frames, like 'time' \(got 1\)"),
        ({"joint": [[0.0], [np.inf]]}, r"\(got inf in frame 1, joint 0\)"),
        ({"action": [0.0, 1.0]}, r"'action' must have shape .* \(got \(2,\)\)"),
        ({"action": np.zeros((2, 0))}, r"or be None without commands \(got \(2, 0\)\)"),
        ({"action": [[0.0]]}, r"'action' must have 2 frames, like 'time' \(got 1\)"),
        ({"action": [[0.0], [np.inf]]}, r"\(got inf in frame 1, number 0\)"),
        ({"action": [["up"], ["down"]]}, r"'action' must be an array of numbers"),
        ({"label": 1.5}, r"'label' must be a text, an integer or None \(got float\)"),
        ({"meta": ["a"]}, r"'meta' must be a mapping \(got list\)"),
        ({"meta": {1: "a"}}, r"'meta' must have texts as keys \(got 1\)"),
        ({"meta": {"a": np.zeros(2)}}, r"'meta' must hold JSON values \(.*ndarray.*, for 'a'\)"),
        ({"meta": {"a": NAN}}, r"'meta' must hold JSON values \(.*, for 'a'\)"),
        (
            {"meta": {"unit": "N"}},
            r"must be one of \['count', 'newton', 'microtesla'\] \(got 'N'\)",
        ),
        (
            {"privileged": {"p": 1.0}},
            r"privileged 'p' must have one row per frame \(got a sc",
        ),
        ({"privileged": {"a/b": [1, 2]}}, r"names of .* without '/' or NUL.*got 'a/b'\)"),
        ({"privileged": {"": [1, 2]}}, r"of 1 to 255 characters, .* and not '.' \(got ''\)"),
        (
            {"privileged": {"\ud800": [1, 2]}},
            r"names in 'privileged' must hold texts that can be encoded in UTF-8",
        ),
        ({"extra": {"p": [1, 2, 3]}}, r"'p' must have 2 frames, like 'time' \(got 3\)"),
        ({"extra": {"p": [None, 1]}}, r"extra 'p' must hold numbers, .* \(got object\)"),
        ({"extra": {"a\0b": [1, 2]}}, r"'extra' must have names .* or NUL.* \(got 'a\\x00b'\)"),
        ({"extra": {".": [1, 2]}}, r"'extra' must have names .* and not '.' \(got '.'\)"),
        ({"extra": {256 * "a": [1, 2]}}, r"'extra' must have names .* 1 to 255 .*got 'aaaaa"),
        (
            {"extra": {"p": np.zeros((2, 0))}},
            r"extra 'p' must have values .* \(got shape \(2, 0\)\)",
        ),
        ({"extra": {"p": np.zeros((2,) + 9 * (1,))}}, r"extra 'p' must .* at most 9 dimensions"),
        (
            {"extra": {"p": ["a", "\ud800"]}},
            r"extra 'p' must hold texts that can be encoded in UTF-8",
        ),
        pytest.param(
            {"extra": {"p": np.zeros(2, "longdouble")}},
            r"extra 'p' must hold numbers of at most 8 bytes \(got float",
            marks=pytest.mark.skipif(np.dtype("longdouble").itemsize == 8, reason="is float64"),
        ),
        (
            {"label": "\ud800"},
            r"'label' must hold texts that can be encoded in UTF-8 \(got '\\ud800'\)",
        ),
        ({"meta": {"\ud800": 1}}, r"'meta' must hold JSON values \(.*'utf-8'"),
        (
            {"extra": {"p": np.ma.array([1, 2], mask=[0, 1])}},
            r"'p' must not be masked \(got a masked value in frame 1\)",
        ),
    ],
)
def test_recording_refuses(changed, message):
    good = {"time": [0.0, 1.0], "tactile": np.zeros((2, 1, 2))}
    Recording(**good)
    with pytest.raises(ValueError, match=message):
        Recording(**{**good, **changed})


def test_recording_names_the_first_frame_that_goes_back():
    with pytest.raises(ValueError, match=r"got 0.2 s in frame 2 after 0.3 s in frame 1"):
        Recording([0.1, 0.3, 0.2, 0.1], np.zeros((4, 1, 1)))


def test_recording_warns_of_degrees_at_the_line_of_the_caller():
    with pytest.warns(UserWarning, match=r"in radians \(got an angle of 90, .*deg2rad") as caught:
        recording(joint=np.array([[0.0], [-90.0], [NAN], [1.0]]))
    assert caught[0].filename == __file__


def test_recording_takes_a_full_turn_and_missing_angles_without_a_warning(recwarn):
    recording(joint=np.full((4, 1), 2 * np.pi))
    recording(joint=np.full((4, 1), NAN))
    assert not recwarn
