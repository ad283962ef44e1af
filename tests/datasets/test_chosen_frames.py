import numpy as np
import pytest
import torch
from recordings import counting_recording

from torch_geometric_tactile.data import FrameInfo, Protocol
from torch_geometric_tactile.data._dataset_info import selected_at_rate
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.sensors import TaxelLayout

GLOVE = TaxelLayout("glove", [[0.0, 0.0], [0.01, 0.0]], adjacency={"pair": [[0, 1], [1, 0]]})


def recording(frames=60, rate=50.0, label="a", phase=None, **meta):
    return counting_recording(frames, 2, rate=rate, start=2.0, label=label, phase=phase, meta=meta)


def write(root, names):
    for name in names:
        write_recording(recording(object=name[0]), root / f"{name}.npz")
    return root


def drawn(dataset):
    """The frames by the name of their trial."""
    rows = torch.as_tensor(dataset.indices())
    trial, frame = dataset._data.trial[rows], dataset._data.x[rows, 0, 0]
    return {name: frame[trial == i].int().tolist() for i, name in enumerate(dataset.trial_names)}


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (50.0, [0, 1, 2, 3, 4, 5]),
        (25.0, [0, 2, 4]),
        (30.0, [0, 2, 3, 5]),  # 0, 33, 67 and 100 ms of 0, 20, 40, 60, 80, 100
        (1000.0, [0, 1, 2, 3, 4, 5]),
        (0.1, [0]),
    ],
)
def test_frames_nearest_in_time_by_hand(rate, expected):
    time = 7.0 + torch.arange(6, dtype=torch.double) / 50
    trial = torch.zeros(6, dtype=torch.long)
    info = FrameInfo(rate=50.0, selected_rate=rate)
    assert selected_at_rate(time, trial, info).nonzero().view(-1).tolist() == expected


def test_clock_starts_with_each_trial_and_heeds_gaps():
    time = torch.tensor([0.0, 0.02, 0.04, 5.0, 5.05, 5.06, 9.0])
    trial = torch.tensor([0, 0, 0, 2, 2, 2, 1])
    kept = selected_at_rate(time, trial, FrameInfo(rate=50.0, selected_rate=25.0))
    assert kept.tolist() == [True, False, True, True, True, False, True]


def test_rate_is_that_of_the_recordings_by_time():
    dataset = RecordingFrames(
        layout=GLOVE, recordings=[recording(501, 100.0, object="a")], rate=30.0
    )
    assert len(dataset) == 151
    time = dataset.data.time
    assert time.numpy() - 2.0 == pytest.approx(np.arange(151) / 30, abs=0.00501)


def test_samples_are_drawn_of_each_trial_by_its_name(tmp_path):
    names = ("a_0", "a_1", "b_0", "b_1")
    given = {"layout": GLOVE, "samples_per_trial": 7}
    first = drawn(RecordingFrames(write(tmp_path / "all", names), **given))
    assert {name: len(set(frames)) for name, frames in first.items()} == dict.fromkeys(names, 7)
    assert len(set(map(tuple, first.values()))) == 4
    # Whatever other trials there are, and again.
    fewer = drawn(RecordingFrames(write(tmp_path / "some", ("a_1", "b_1")), **given))
    assert fewer == {name: first[name] for name in ("a_1", "b_1")}
    other = drawn(RecordingFrames(tmp_path / "all", sample_seed=1, **given))
    assert all(other[name] != first[name] for name in names)


def test_samples_are_drawn_from_what_rate_and_phases_leave():
    phase = np.arange(60) // 30
    made = [recording(60, phase=phase, phase_names=["rest", "squeeze"], object="a")]
    given = {"layout": GLOVE, "recordings": made, "rate": 25.0, "phases": ["squeeze"]}
    possible = list(range(30, 60, 2))
    assert drawn(RecordingFrames(**given))["0"] == possible
    some = drawn(RecordingFrames(samples_per_trial=5, **given))["0"]
    assert len(some) == 5
    assert set(some) < set(possible)
    assert drawn(RecordingFrames(samples_per_trial=99, **given))["0"] == possible


@pytest.mark.parametrize("by", ["trial", "frame"])
def test_split_decides_on_no_sample(tmp_path, by):
    root = write(tmp_path, ("a_0", "a_1", "a_2", "b_0", "b_1", "b_2"))
    protocol = Protocol(by, val=0.0, test=0.4)
    given = {"layout": GLOVE, "samples_per_trial": 9, "protocol": protocol}
    whole, train, test = (
        drawn(RecordingFrames(root, split=part, **given)) for part in (None, "train", "test")
    )
    assert {name: sorted(train[name] + test[name]) for name in whole} == whole
    assert sum(map(len, test.values())) > 0


def test_processed_file_serves_all_choices(tmp_path, caplog):
    root = write(tmp_path, ("a_0", "b_0"))
    RecordingFrames(root, layout=GLOVE)
    assert len(RecordingFrames(root, layout=GLOVE, rate=10.0, samples_per_trial=3)) == 6
    assert "again" not in caplog.text


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"rate": 0}, r"'rate' must be a number of frames per second above 0, or None \(got 0\)"),
        ({"rate": float("nan")}, r"'rate' must be .* \(got nan\)"),
        ({"rate": float("inf")}, r"'rate' must be .* \(got inf\)"),
        ({"rate": True}, r"'rate' must be .* \(got True\)"),
        ({"rate": "30"}, r"'rate' must be .* \(got '30'\)"),
        ({"samples_per_trial": 0}, r"'samples_per_trial' must be an integer, .* \(got 0\)"),
        ({"samples_per_trial": 2.5}, r"'samples_per_trial' must be .* \(got 2.5\)"),
        ({"samples_per_trial": True}, r"'samples_per_trial' must be .* \(got True\)"),
        ({"sample_seed": -1}, r"'sample_seed' must be an integer, at least 0 \(got -1\)"),
        ({"sample_seed": None}, r"'sample_seed' must be .* \(got None\)"),
    ],
)
def test_bad_choices_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        RecordingFrames(layout=GLOVE, recordings=[recording()], **arguments)
