import logging
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from bigs_files import grasp, readings, values, write_npz

from torch_geometric_tactile.data import Protocol, Recording
from torch_geometric_tactile.data import _processed_dataset as processed_dataset
from torch_geometric_tactile.datasets import BiGS
from torch_geometric_tactile.io._recording_npz import write_npz as write_recording
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.transforms import KNNGraph

LABELS = ("success", "failure", "success", "failure")


@pytest.fixture
def folder(tmp_path):
    """Four grasps of two objects in two sessions."""
    for i, label in enumerate(LABELS):
        item = "cylinder" if i < 2 else "ball"
        meta = {"object": item, "trial": i, "session": f"day {i % 2}"}
        write_recording(grasp(seed=i, label=label, **meta), tmp_path / f"{item}_{i}.npz")
    return tmp_path


def test_grasps_by_hand(folder):
    dataset = BiGS(folder, until=None)
    assert repr(dataset) == "BiGS(240)"
    assert dataset.class_names == ["failure", "success"]
    assert dataset.group_names == ["ball", "cylinder"]
    assert dataset.session_names == ["day 0", "day 1"]
    assert dataset.trial_names == ["ball_2", "ball_3", "cylinder_0", "cylinder_1"]
    assert dataset.phase_names == ["closing", "lift", "shake"]
    assert not dataset.synthetic
    arrays = readings(seed=2)
    first = dataset.data.index_select(torch.arange(60))
    assert np.array_equal(first.x, arrays["electrodes"])
    assert first.y.tolist() == [1] * 60
    assert first.trial.tolist() == [0] * 60
    assert first.group.tolist() == [0] * 60
    assert first.session.tolist() == [0] * 60
    assert np.allclose(first.time, np.arange(60) / 100, atol=1e-9)
    assert np.allclose(first.pickup_time, 0.2)
    assert first.phase.tolist() == [0] * 20 + [1] * 20 + [2] * 20
    assert first.slip.tolist() == [0] * 31 + [1] * 29
    for name in ("pressure", "pac", "robot_joint", "wrench", "object_pose"):
        assert np.array_equal(first[name], arrays[name].astype(np.float32)), name
    assert np.array_equal(first.joint, arrays["finger_joint"].reshape(60, 12))
    assert dataset.y.view(4, 60)[:, 0].tolist() == [1, 0, 1, 0]
    assert dataset[0].x.shape == (19, 3)
    assert dataset[0].pac.shape == (1, 3, 22)
    assert dataset[0].edge_index is None
    assert dataset[0].pos.shape == (19, 3)


@pytest.mark.parametrize(("until", "frames"), [(0.0, 21), (0.1, 31), (0.38, 59), (2, 60)])
def test_until_ends_each_grasp_after_pick_up(until, frames, folder):
    dataset = BiGS(folder, until=until)
    assert len(dataset) == 4 * frames
    assert (dataset.time <= dataset.pickup_time + until + 1e-6).all()
    assert dataset.trial.bincount().tolist() == [frames] * 4


def test_one_processed_file_for_all_moments_to_end_at(folder, caplog):
    BiGS(folder)
    with caplog.at_level(logging.WARNING):
        assert len(BiGS(folder, until=0.1)) < len(BiGS(folder, until=None))
    assert not caplog.text
    assert len(list((folder / "processed").glob("*.pt"))) == 1


def test_pick_up_is_on_the_clock_of_the_frames(tmp_path):
    rec = grasp(trial=1).select(slice(10, None))
    write_recording(rec, tmp_path / "a.npz")
    dataset = BiGS(tmp_path, until=0.0)
    assert len(dataset) == 11
    assert np.allclose(dataset.pickup_time, 0.1)


@pytest.mark.parametrize(("ends", "kept"), [(2.0, True), (1, True), (2.5, False), (None, False)])
def test_a_grasp_without_pick_up_must_say_when_it_ends(ends, kept, tmp_path):
    write_recording(grasp(trial=1, pickup_time=None, ends_after_pickup=ends), tmp_path / "a.npz")
    assert len(BiGS(tmp_path, until=None)) == 60
    if kept:
        assert len(BiGS(tmp_path)) == 60
        return
    with pytest.raises(ValueError, match=r"^1 grasps in '.*' must have 'pickup_time' .*in 'a'\)"):
        BiGS(tmp_path)


def test_joint_is_what_is_named(folder):
    dataset = BiGS(folder, joint_signals=["finger_joint", "wrench"])
    plain = BiGS(folder)
    assert torch.equal(dataset.joint, torch.cat([plain.joint, plain.wrench], dim=1))
    assert dataset[0].joint.shape == (1, 18)
    assert torch.equal(BiGS(folder, joint_signals=["wrench"]).joint, plain.wrench)
    for bad in ([], ["pac"], ["wrench", "wrench"], "wrench"):
        with pytest.raises(ValueError, match=r"'joint_signals' must be some of \['finger_joint'"):
            BiGS(folder, joint_signals=bad)
    with pytest.raises(ValueError, match=r"'signals' must have 'wrench' of 'joint_signals'"):
        BiGS(folder, signals=["finger_joint"], joint_signals=["finger_joint", "wrench"])


def test_joint_signals_must_be_in_the_files(tmp_path):
    write_recording(grasp(trial=1, without=("wrench",)), tmp_path / "a.npz")
    assert BiGS(tmp_path).joint.shape == (60, 12)
    with pytest.raises(ValueError, match=r"must hold all of 'joint_signals' .*'finger_joint'"):
        BiGS(tmp_path, joint_signals=["finger_joint", "wrench"])


@pytest.mark.parametrize("until", [-1, float("nan"), float("inf"), True, "2"])
def test_until_refuses(until, folder):
    with pytest.raises(ValueError, match=r"'until' must be a number of seconds from 0 on, or None"):
        BiGS(folder, until=until)


def test_signals_are_those_that_are_named(folder):
    dataset = BiGS(folder, signals=["pressure", "finger_joint"])
    assert "pac" not in dataset.data
    assert dataset.pressure.shape[1:] == (3,)
    assert dataset.joint.shape[1:] == (12,)
    with pytest.raises(ValueError, match=r"'signals' must be some of .* \(got \['force'\]\)"):
        BiGS(folder, signals=["force"])
    with pytest.raises(ValueError, match=r"'signals' must be some of .* \(got 'pac'\)"):
        BiGS(folder, signals="pac")


def test_a_signal_that_one_file_lacks_is_an_error_that_names_it(folder):
    write_recording(grasp(seed=9, trial=9, without=("pac",)), folder / "z_9.npz")
    with pytest.raises(
        ValueError, match=r"z_9.npz' must hold 'pac', like the other files .*signals=\["
    ):
        BiGS(folder)
    assert "pac" not in BiGS(folder, signals=["pressure"]).data


def test_unknown_phase_and_slip(tmp_path):
    write_recording(grasp(trial=1), tmp_path / "a.npz")
    bare = grasp(trial=2, phase_names=None, without=("slip", "phase"))
    write_recording(bare, tmp_path / "b.npz")
    dataset = BiGS(tmp_path)
    assert dataset.phase.view(2, 60)[1].tolist() == [-1] * 60
    assert dataset.slip.view(2, 60)[1].tolist() == [-1] * 60
    assert dataset.phase.view(2, 60)[0].max() == 2


def test_slip_stays_from_its_onset_on(tmp_path):
    rec = grasp(trial=1)
    slip = np.zeros(60, dtype=np.int8)
    slip[:5], slip[20:25] = -1, 1
    privileged = {**rec.privileged, "slip": slip}
    write_recording(changed(rec, privileged=privileged), tmp_path / "a.npz")
    assert BiGS(tmp_path).slip.tolist() == [-1] * 5 + [0] * 15 + [1] * 40


def changed(rec, **fields):
    kept = ("time", "tactile", "joint", "label", "meta", "privileged", "extra")
    return Recording(**{**{key: getattr(rec, key) for key in kept}, **fields})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"tactile": np.zeros((60, 24, 3))}, r"layout 'biotac' must have 19 taxels \(got 24\)"),
        (
            {"tactile": np.zeros((60, 19, 1))},
            r"must have 3 channels per taxel, the fingers left, mid",
        ),
        ({"label": "slip"}, r"must have the label 'success' or 'failure' \(got 'slip'\)"),
        ({"label": None}, r"must have the label 'success' or 'failure' \(got None\)"),
        (
            {"meta": {"unit": "newton", "object": "a"}},
            r"must have the unit 'count' \(got 'newton'\)",
        ),
        ({"meta": {"trial": 1}}, r"must name its object and trial"),
        (
            {"meta": {"object": "a", "pickup_time": 1.0}},
            r"'pickup_time' on the clock of 'time' in its metadata, 5.0",
        ),
        ({"meta": {"object": "a", "pickup_time": "x"}}, r"must have seconds in 'pickup_time'"),
        ({"meta": {"object": "a", "ends_after_pickup": -1}}, r"seconds in 'ends_after_pickup'"),
        (
            {"extra": {"pac": np.zeros((60, 22))}},
            r"shape \(3, any\) per frame in 'pac' \(got f",
        ),
        ({"extra": {"pac": np.zeros((60, 4, 2))}}, r"shape \(3, any\) per frame in 'pac'"),
        ({"extra": {"pac": np.full((60, 3, 22), np.inf)}}, r"finite numbers, or NaN, in 'pac'"),
        (
            {"extra": {"pressure": np.full((60, 3), "a")}},
            r"must hold numbers of shape \(3\) per frame",
        ),
        (
            {"privileged": {"object_pose": np.zeros((60, 6))}},
            r"shape \(7\) per frame in 'object_pose'",
        ),
        ({"privileged": {"slip": np.full(60, 2)}}, r"0, 1 or, where unknown, -1 .* in 'slip'"),
        (
            {"privileged": {"slip": np.zeros((60, 3))}},
            r"in 'slip' \(got float64 of shape \(60, 3\)",
        ),
    ],
)
def test_a_file_that_is_no_grasp_is_named(fields, message, folder):
    write_recording(changed(grasp(trial=8), **fields), folder / "bad.npz")
    with pytest.raises(ValueError, match=message) as caught:
        BiGS(folder)
    assert "bad.npz'" in str(caught.value)
    assert not list((folder / "processed").glob("*"))


def test_signals_of_another_size_name_the_file(folder):
    rec = grasp(trial=8)
    extra = {**rec.extra, "finger_joint": np.zeros((60, 3, 5))}
    write_recording(changed(rec, extra=extra), folder / "z.npz")
    with pytest.raises(
        ValueError, match=r"z.npz' must .* shape \(3, 4\) per frame in 'finger_joint'"
    ):
        BiGS(folder)


def test_a_trial_twice_names_both_files(folder):
    meta = {"object": "ball", "trial": 2, "session": "day 0"}
    write_recording(grasp(**meta), folder / "again.npz")
    with pytest.raises(
        ValueError, match=r"trial 2 of 'ball' must be in only one file .*again.*ball_2"
    ):
        BiGS(folder)
    write_recording(grasp(**{**meta, "session": "day 7"}), folder / "again.npz")
    assert len(BiGS(folder, until=None)) == 300


def test_a_cut_file_is_named(folder):
    path = folder / "ball_3.npz"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"ball_3.npz' is not a complete npz file"):
        BiGS(folder)


def test_files_with_other_names(tmp_path):
    for i in range(2):
        arrays = readings(seed=i)
        content = {
            "e": arrays["electrodes"].transpose(0, 2, 1).reshape(60, 57),
            "pac": arrays["pac"],
            **values(trial=i, success=i, pickup_time=0.2),
        }
        write_npz(tmp_path / f"{i}.npz", content)
    fields = {"electrodes": "e [frame (finger electrode)]"}
    dataset = BiGS(tmp_path, fields=fields, until=None)
    assert np.array_equal(dataset.x[:60], readings(seed=0)["electrodes"])
    assert dataset.y.view(2, 60)[:, 0].tolist() == [0, 1]
    with pytest.raises(ValueError, match=r"'fields' must have keys among"):
        BiGS(tmp_path, fields={"taxels": "e"})
    with pytest.raises(ValueError, match=r"0.npz': 'electrodes' \(in 'e'\) must have 3 dimensions"):
        BiGS(tmp_path, fields={"electrodes": "e"})


def test_one_outcome_has_two_classes(tmp_path):
    write_recording(grasp(trial=1), tmp_path / "a.npz")
    dataset = BiGS(tmp_path)
    assert dataset.num_classes == 2
    assert dataset.y.unique().tolist() == [1]


def test_splits_edges_batches_and_pickles(folder):
    dataset = BiGS(folder, pre_transform=KNNGraph(k=2), until=0.1)
    split = Protocol("trial", val=0.0, test=0.5, stratify="y").split(dataset, seed=0)
    trials = [set(dataset.trial[part].tolist()) for part in (split.train, split.test)]
    assert trials[0].isdisjoint(trials[1])
    batch = next(iter(StaticLoader(dataset, batch_size=5)))
    assert batch.x.shape == (5, 19, 3)
    assert batch.edge_index.size(0) == 2
    assert batch.pac.shape == (5, 3, 22)
    copy = pickle.loads(pickle.dumps(dataset))
    assert torch.equal(copy.y, dataset.y)


def is_on_disk(tensor):
    """Whether a tensor is in a file that has no name any more."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        start, end = (int(text, 16) for text in line.split()[0].split("-"))
        if start <= tensor.data_ptr() < end:
            return "(deleted)" in line
    return False


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux")
def test_frames_are_on_disk_while_they_are_read(folder, monkeypatch):
    seen = {}
    save = processed_dataset.save_static

    def watched(data, *args, **kwargs):
        seen.update({k: is_on_disk(v) for k, v in data.to_dict().items() if torch.is_tensor(v)})
        return save(data, *args, **kwargs)

    monkeypatch.setattr(processed_dataset, "save_static", watched)
    BiGS(folder)
    assert not seen.pop("pos")
    assert not seen.pop("normal")
    assert len(seen) > 12
    assert all(seen.values()), seen


def test_grasps_are_split_by_a_person_in_their_metadata(tmp_path):
    for i in range(4):
        recording = grasp(seed=i, object="ball", trial=i, person="ab"[i % 2])
        write_recording(recording, tmp_path / f"ball_{i}.npz")
    dataset = BiGS(tmp_path)
    test = Protocol("person", val=0, test=0.5).split(dataset).test
    assert set(dataset.trial[test].tolist()) in ({0, 2}, {1, 3})
