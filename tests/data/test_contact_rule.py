import json

import numpy as np
import pytest

from torch_geometric_tactile.data import NO_CONTACT, ContactRule
from torch_geometric_tactile.data._contact_windows import ContactWindow, windows_lacking_contact

NAN = float("nan")
REST = np.full((3, 2), 100.0)


def rule(**kwargs):
    return ContactRule(**{"threshold": 5.0, "rest": REST, **kwargs})


def frame(*changes):
    """The reading at rest, with changes of a taxel's second channel."""
    out = REST.copy()
    for taxel, change in enumerate(changes):
        out[taxel, 1] += change
    return out


def noisy(scale=1.0, num_frames=50, shape=(3, 2)):
    return 100 + scale * np.random.default_rng(0).standard_normal((num_frames, *shape))


@pytest.mark.parametrize(
    ("changes", "touched"),
    [
        ((0, 0, 0), [False, False, False]),
        ((5, 5, 5), [False, False, False]),
        ((6, 0, -6), [True, False, True]),
        ((NAN, 6, 0), [False, True, False]),
        ((np.inf, -np.inf, 6), [False, False, True]),
    ],
)
def test_a_taxel_is_touched_beyond_the_threshold_on_either_side(changes, touched):
    assert rule().touched(frame(*changes)).tolist() == touched
    for least in (1, 2, 3):
        found = rule(min_taxels=least).is_contact(frame(*changes))
        assert bool(found) == (sum(touched) >= least)


def test_repr_and_label():
    assert repr(ContactRule(20)) == (
        "ContactRule(threshold=20.0, min_taxels=2, num_deviations=6.0)"
    )
    assert NO_CONTACT == "no contact"


def test_a_taxel_without_a_reading_at_rest_is_never_touched():
    rest = REST.copy()
    rest[0] = NAN
    assert rule(rest=rest).touched(frame(50, 50, 0)).tolist() == [False, True, False]


def test_a_frame_without_any_reading_neither_has_nor_lacks_contact():
    empty = np.full((3, 2), NAN)
    assert not rule().is_contact(empty)
    assert not rule().lacks_contact(empty)
    one = empty.copy()
    one[2, 0] = 100.0
    assert rule().lacks_contact(one)


def test_a_sensor_of_one_taxel_is_touched_by_one():
    alone = ContactRule(threshold=5.0, rest=np.zeros((1, 3)))
    assert alone.min_taxels == 2
    assert alone.is_contact([[0.0, 6.0, 0.0]])
    assert not alone.is_contact([[0.0, 4.0, 0.0]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_frames_are_those_one_by_one(dtype):
    frames = noisy(8.0).astype(dtype)
    frames[frames > 110] = NAN
    for method in (rule().is_contact, rule().lacks_contact, rule().touched):
        found = method(frames)
        np.testing.assert_array_equal(found, [method(each) for each in frames])
        np.testing.assert_array_equal(
            method(frames.reshape(5, 10, 3, 2)).reshape(found.shape), found
        )
    assert 0 < rule().is_contact(frames).sum() < len(frames)
    assert rule().is_contact(np.zeros((0, 3, 2))).shape == (0,)


def test_the_threshold_follows_the_noise_of_each_channel():
    frames = noisy(num_frames=500)
    frames[:, :, 0] = 100 + 10 * (frames[:, :, 0] - 100)
    measured = ContactRule(min_taxels=1).measured(frames)
    np.testing.assert_allclose(measured.noise, [[10, 1]] * 3, rtol=0.15)
    np.testing.assert_allclose(measured.rest, REST, atol=1)
    assert not measured.is_contact(REST + np.array([40, 4]))
    assert measured.is_contact(REST + np.array([40, 8]))
    assert measured.is_contact(REST + np.array([80, 4]))
    assert not ContactRule(None, 1, 20.0).measured(frames).is_contact(REST + np.array([80, 8]))


def test_a_quiet_taxel_has_the_noise_of_its_channel():
    frames = noisy(num_frames=500)
    frames[:, 0] = 100.0
    noise = ContactRule().measured(frames).noise
    assert (noise[0] > 0.7).all()


def test_whole_numbers_have_at_least_the_noise_of_rounding():
    counts = np.full((50, 3, 2), 100.0)
    counts[7, 1, 0] += 1  # one signal tips over once
    measured = ContactRule(min_taxels=1).measured(counts)
    np.testing.assert_allclose(measured.noise, 12**-0.5)
    assert not measured.is_contact(REST + 1)
    assert measured.is_contact(REST + 2)
    with pytest.raises(ValueError, match="must be noisy"):
        ContactRule().measured(counts / 8)


def test_frames_at_rest_are_not_contact_and_touched_ones_are():
    frames = noisy(num_frames=4000)
    measured = ContactRule().measured(frames[:100])
    assert not measured.is_contact(frames[100:]).any()
    frames[100:, :2, 0] += 12
    assert measured.is_contact(frames[100:]).mean() > 0.99


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        (noisy(num_frames=9), "at least 10 frames"),
        (np.full((30, 3, 2), 7.0), "must be noisy"),
        (np.zeros((0, 3, 2)), r"\(num_frames, num_taxels, num_channels\)"),
        (np.zeros((3, 2)), r"\(num_frames, num_taxels, num_channels\)"),
    ],
)
def test_frames_that_tell_no_noise_are_refused(frames, text):
    with pytest.raises(ValueError, match=text):
        ContactRule().measured(frames)


def test_a_given_threshold_needs_one_frame_and_no_noise():
    measured = ContactRule(5.0).measured(np.full((1, 3, 2), 7.0))
    assert measured.is_measured
    assert measured.noise is None
    assert measured.rest.tolist() == [[7, 7]] * 3
    assert not ContactRule(5.0).is_measured
    assert not ContactRule(rest=REST).is_measured


def test_what_is_missing_is_named():
    with pytest.raises(ValueError, match=r"must have the readings at rest \(got none\): call"):
        ContactRule(5.0).is_contact(REST)
    with pytest.raises(ValueError, match="'threshold' of the contact rule must be set"):
        ContactRule(rest=REST).is_contact(REST)
    with pytest.raises(ValueError, match=r"must have the shape .*\(3, 2\) \(got \(2, 3\)"):
        rule().is_contact(REST.T)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"threshold": 0}, "'threshold' must be a positive"),
        ({"threshold": NAN}, "'threshold' must be a positive"),
        ({"threshold": 10**400}, "'threshold' must be a positive"),
        ({"num_deviations": -1.0}, "'num_deviations' must be a positive"),
        ({"min_taxels": 0}, "'min_taxels' must be at least 1"),
        ({"rest": [1.0]}, "'rest' must be numbers"),
        ({"rest": REST, "noise": -REST}, "'noise' must be numbers that are not negative"),
        ({"rest": REST, "noise": REST[:2]}, "'noise' must have the shape of 'rest'"),
        ({"noise": REST}, "'noise' must have the shape of 'rest', None"),
    ],
)
def test_bad_arguments(arguments, text):
    with pytest.raises(ValueError, match=text):
        ContactRule(**arguments)


def test_arrays_are_copies_that_cannot_be_changed():
    rest = REST.copy()
    made = rule(rest=rest)
    rest[:] = 0
    assert (made.rest == 100).all()
    with pytest.raises(ValueError, match="read-only"):
        made.rest[:] = 0


@pytest.mark.parametrize(
    "made",
    [
        ContactRule(),
        ContactRule(3, 1, 8),
        ContactRule().measured(np.where(noisy() > 102, NAN, noisy())),
    ],
)
def test_round_trip_through_json(made):
    read = ContactRule.from_dict(json.loads(json.dumps(made.to_dict(), allow_nan=False)))
    assert read == made
    for name in ("rest", "noise"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))


def test_a_taxel_that_is_missing_at_rest_is_written_as_null():
    rest = REST.copy()
    rest[1] = NAN
    content = rule(rest=rest).to_dict()
    assert content["rest"][1] == [None, None]
    np.testing.assert_array_equal(ContactRule.from_dict(content).rest, rest)


@pytest.mark.parametrize(
    "change",
    [
        {"rest": [[1.0, 2.0], [1.0]]},
        {"rest": [[True, False]]},
        {"rest": []},
        {"rest": {"a": 1}},
        {"noise": [[1.0, 1.0]]},
        {"threshold": [5]},
        {"more": 1},
    ],
)
def test_hostile_contents_are_refused(change):
    with pytest.raises(ValueError, match=r"'(rest|noise|threshold|contact)' must"):
        ContactRule.from_dict({**rule().to_dict(), **change})


@pytest.mark.parametrize("content", [None, {"threshold": 5.0}])
def test_contents_that_are_no_rule_are_refused(content):
    with pytest.raises(ValueError, match="'contact' must have"):
        ContactRule.from_dict(content)


@pytest.mark.parametrize("length", [1, 2, 5])
def test_windows_that_come_frame_by_frame_are_those_of_the_recording(length):
    draw = np.random.default_rng(length)
    kinds = [REST, frame(9, 9), np.full((3, 2), NAN)]
    frames = np.stack([kinds[i] for i in draw.choice(3, 200, p=[0.6, 0.15, 0.25])])
    window = ContactWindow(length)
    found = np.array([window.push(rule(), each) for each in frames])[length - 1 :]
    start = np.arange(len(frames) - length + 1)
    whole = windows_lacking_contact(rule(), frames, start, start + length)
    np.testing.assert_array_equal(found, whole)
    by_hand = [
        not rule().is_contact(frames[i : i + length]).any()
        and not np.isnan(frames[i : i + length]).all()
        for i in start
    ]
    np.testing.assert_array_equal(whole, by_hand)
    assert 0 < whole.sum() < len(whole)
