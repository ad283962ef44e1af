from importlib import import_module
from itertools import islice

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.live import SimulatedSource
from torch_geometric_tactile.sim import paper8, simulate
from torch_geometric_tactile.sim.simulate import grasp_recordings


@pytest.fixture
def short_grasps(monkeypatch):
    """Grasps of three frames each, in place of the physics."""
    asked = []

    def grasps(objects, seed, **settings):
        asked.append((objects, seed, settings))
        for trial in range(100):
            tactile = np.full((3, 384, 3), trial, dtype=np.float32)
            meta = dict.fromkeys(("sensor", "synthetic", "object_set", "seed", "motion"), 1)
            meta |= {"unit": "count", "rate": 200.0}
            yield Recording([0.005, 0.01, 0.015], tactile, label=f"object {trial}", meta=meta)

    module = import_module("torch_geometric_tactile.sim.simulate")  # the package has a function so
    monkeypatch.setattr(module, "grasp_recordings", grasps)
    return asked


def test_simulated_source_gives_one_grasp_after_another(short_grasps):
    source = SimulatedSource("sponge", rate=25, seed=3)
    assert repr(source) == "SimulatedSource('sim:?object=sponge')"
    frames, labels = [], []
    with source:
        assert source.meta["rate"] == 200
        while len(frames) < 10:
            frames += source.read(0.1)
            labels.append(source.label)
    assert [frame.sequence for frame in frames[:10]] == list(range(10))
    assert [int(frame.tactile[0, 0]) for frame in frames[:9]] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert (np.diff([frame.received for frame in frames]) >= 0).all()
    assert frames[0].device_time is None
    assert labels[0] == "object 0"
    assert labels[-1] == "object 3"
    assert short_grasps == [("paper8", 3, {"rate": 25, "only": "sponge", "motion": "lift"})]


def test_simulated_source_closed_does_not_read(short_grasps):
    source = SimulatedSource()
    with pytest.raises(OSError, match="is not open"):
        source.read(0)
    source.close()


@pytest.mark.slow
def test_grasp_recordings_are_those_that_simulate_writes(tmp_path):
    sponge = paper8()[1]
    (report,) = simulate(tmp_path, [sponge], trials=1, preset="ci", seed=2)
    (grasp,) = islice(grasp_recordings([sponge], 2), 1)
    written = read_recording(report.path)
    np.testing.assert_array_equal(grasp.tactile, written.tactile)
    np.testing.assert_array_equal(grasp.joint, written.joint)
    assert grasp.meta == written.meta
