"""Rest readings of trials, also from frames that the data set leaves out."""

import copy
import pickle

import numpy as np
import pytest
import torch
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import Protocol, Recording
from torch_geometric_tactile.datasets import AllegroUSkin, RecordingFrames
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import ZScore, fit_parts

PAD = grid(2, 2, 0.01)
NAMES = ["hover", "close", "hold"]
OFFSETS = (100.0, 5000.0, 33000.0, 70.0)


def trial(offset, object_name, phase=(0, 0, 1, 1, 2, 2), names=NAMES):
    """The trial's offset, with 1 and 3 more at rest, and 10 t more afterwards."""
    reading = offset + np.array([1.0, 3.0, 20.0, 30.0, 40.0, 50.0])
    meta = {"object": object_name} | ({} if names is None else {"phase_names": names})
    return Recording(
        time=np.arange(6) / 10,
        tactile=np.broadcast_to(reading[:, None, None], (6, 4, 2)),
        meta=meta,
        privileged={} if names is None else {"phase": np.array(phase)},
    )


def trials(**kwargs):
    return [trial(offset, "ab"[i % 2], **kwargs) for i, offset in enumerate(OFFSETS)]


def frames(**kwargs):
    kwargs = {"recordings": trials(), "layout": PAD, "adjacency": "original", **kwargs}
    return RecordingFrames(**kwargs)


def first_taxel(dataset):
    return dataset.batch(range(len(dataset))).x[:, 0, 0].tolist()


@pytest.mark.parametrize("tare", ["hover", 0.15])
def test_rest_is_seen_though_its_frames_are_left_out(tare):
    dataset = frames(phases=["hold"], tare=tare)
    assert len(dataset) == 8
    assert first_taxel(dataset) == [38.0, 48.0] * 4
    assert dataset[3].x.tolist() == [[48.0] * 2] * 4
    assert dataset.data.x[0, 0, 0] == 140  # before any transform, as ever
    assert dataset.tare == tare


def test_stride_and_split_leave_the_rest_readings_alone():
    dataset = frames(phases=["hold"], stride=5, tare="hover")
    assert first_taxel(dataset) == [48.0] * 4
    protocol = Protocol("trial", val=0.25, test=0.25)
    part = frames(split="test", protocol=protocol, tare="hover", phases=["hold"])
    assert first_taxel(part) == [38.0, 48.0]
    assert first_taxel(frames(tare="close"))[:3] == [-24.0, -22.0, -5.0]
    one = frames(tare=0.05)
    assert first_taxel(one)[:3] == [0.0, 2.0, 19.0]


def test_tare_comes_before_the_transform_and_scalers():
    def double(data):
        data.x = 2 * data.x
        return data

    dataset = frames(phases=["hold"], tare="hover", transform=double)
    assert first_taxel(dataset) == [76.0, 96.0] * 4
    scaler = ZScore(per="channel")
    fit_parts(scaler, dataset, before=dataset.transform)
    assert scaler.center.view(-1).tolist() == [86.0, 86.0]
    assert isinstance(dataset.transform, Compose)
    assert frames().transform is None


def test_selections_and_copies_keep_it():
    dataset = frames(phases=["hold"], tare="hover")
    for other in (dataset[2:4], copy.copy(dataset)[2:4], pickle.loads(pickle.dumps(dataset))[2:4]):
        assert first_taxel(other) == [38.0, 48.0]


def test_processed_file_serves_all_tares(tmp_path):
    for i, recording in enumerate(trials()):
        write_recording(recording, tmp_path / f"{'ab'[i % 2]}_{i:03d}.npz")
    plain = RecordingFrames(tmp_path, PAD, adjacency="original")
    before = (tmp_path / "processed" / "recording_frames.pt").stat().st_mtime_ns
    tared = RecordingFrames(tmp_path, PAD, adjacency="original", phases="hold", tare="hover")
    assert (tmp_path / "processed" / "recording_frames.pt").stat().st_mtime_ns == before
    assert sorted(first_taxel(tared)) == [38.0] * 4 + [48.0] * 4
    assert len(plain) == 24


def test_missing_readings_at_rest_do_not_count():
    recordings = trials()
    tactile = recordings[0].tactile.copy()
    tactile[0, 0] = np.nan
    recordings[0] = Recording(
        time=recordings[0].time,
        tactile=tactile,
        meta=recordings[0].meta,
        privileged=recordings[0].privileged,
    )
    x = frames(recordings=recordings, phases=["hold"], tare="hover")[0].x
    assert x[:, 0].tolist() == [37.0, 38.0, 38.0, 38.0]


@pytest.mark.parametrize("tare", ["hover", 0.15])
def test_predictor_measures_the_rest_of_a_new_trial(tare, tmp_path):
    dataset = frames(phases=["hold"], tare=tare)
    model = TactileGCN(PAD, 2, channels={"tactile": 2}, widths=(2,), pools=(1,)).eval()
    Predictor.from_dataset(model, dataset).save(tmp_path / "a.predictor")
    predictor = Predictor.load(tmp_path / "a.predictor")
    reading = torch.from_numpy(trial(2000.0, "a").tactile.copy()).float()
    predictor.adapt(reading[:2])
    assert predictor.prepare(reading[4:]).x[:, 0, 0].tolist() == [38.0, 48.0]


def test_allegro_uskin_takes_it(tmp_path):
    for i, offset in enumerate(OFFSETS):
        small = trial(offset, f"mug{i % 2}")
        recording = Recording(
            time=small.time,
            tactile=np.repeat(small.tactile[:, :1, :1], 384, axis=1).repeat(3, axis=2),
            joint=np.zeros((6, 16)),
            meta={"unit": "count", "phase_names": NAMES},
            privileged=small.privileged,
        )
        write_recording(recording, tmp_path / f"mug{i % 2}_{i:03d}.npz")
    dataset = AllegroUSkin(tmp_path, split=None, phases=["hold"], tare="hover")
    assert first_taxel(dataset) == [38.0, 48.0] * 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tare": "rest"}, r"'tare' must be seconds, or a phase .*'hover', .* \(got 'rest'\)"),
        ({"tare": 0.0}, r"'seconds' must be positive and finite \(got 0.0\)"),
        (
            {"tare": "hover", "recordings": trials(names=None)},
            r"'tare' must be seconds, or a phase of the recordings: None \(got 'hover'\)",
        ),
        (
            {
                "tare": "hover",
                "recordings": [*trials(), trial(0.0, "a", phase=(1, 1, 1, 1, 2, 2))],
            },
            r"'tare' must be a phase that every trial has \(got 'hover', which is not in '4'\)",
        ),
    ],
)
def test_bad_tares_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        frames(**arguments)
