import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


class Grasp(NamedTuple):
    """One attempt, and the contacts of the taxels at its end: taxel, pressure and friction force in
    newtons, and depth in metres."""

    item: object
    result: object
    taxel: np.ndarray
    pressure: np.ndarray
    friction: np.ndarray
    depth: np.ndarray

    @property
    def hold(self):
        """The frames of the last second."""
        return self.result.time > self.result.time[-1] - 1.0


def _grasps(items, trials):
    pytest.importorskip("mujoco", reason="needs the extra 'sim'")
    from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
    from torch_geometric_tactile.sim import ContactParameters
    from torch_geometric_tactile.sim._grasp import GraspSimulator, plan_grasp

    layout, hand = allegro_uskin(), HandKinematics.allegro()
    grasps = []
    for item in items:
        simulator = GraspSimulator(layout, hand, item, ContactParameters(timestep=0.004))
        for trial in range(trials):
            plan = plan_grasp(item.size, np.random.default_rng([7, trial]), 5.0, step=0.02)
            result = simulator.run(plan, rate=50.0)
            grasps.append(Grasp(item, result, *_contacts(simulator)))
    return grasps


def _contacts(simulator):
    model, data = simulator.model, simulator.data
    rows = []
    for contact in data.contact:
        names = [model.geom(int(geom)).name for geom in contact.geom]
        taxels = [int(name.removeprefix("taxel_")) for name in names if "taxel_" in name]
        if taxels and contact.efc_address >= 0:
            force = data.efc_force[contact.efc_address :][:3]
            rows.append((taxels[0], force[0], np.hypot(*force[1:]), -contact.dist))
    taxel, pressure, friction, depth = np.array(rows).reshape(-1, 4).T
    return taxel.astype(int), pressure, friction, depth


def heed_ctrl_c():
    """In a job that a shell put into the background, Ctrl-C would be ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="session")
def paper8_grasps():
    """Two short attempts at each of the eight objects, held or not."""
    from torch_geometric_tactile.sim import paper8

    return _grasps(paper8(), 2)


@pytest.fixture(scope="session")
def control8_grasps():
    """Two attempts at each control object, the same two plans for all."""
    from torch_geometric_tactile.sim import control8

    return _grasps(control8(), 2)


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory):
    """The folder of one short trial of each of the eight objects, and the reports."""
    for package in ("mujoco", "h5py"):
        pytest.importorskip(package, reason="needs the extra 'sim'")
    from torch_geometric_tactile.sim import simulate

    out = tmp_path_factory.mktemp("undisturbed")
    return out, list(simulate(out, trials=1, preset="ci"))


@pytest.fixture(scope="session")
def same_arrays():
    """Whether two files hold the same arrays, bit for bit: ``same_arrays(path, path)``."""
    from torch_geometric_tactile.io import read_recording

    def same(*paths):
        first, second = map(read_recording, paths)
        assert set(first.privileged) == set(second.privileged)
        pairs = [
            (getattr(first, name), getattr(second, name)) for name in ("time", "tactile", "joint")
        ]
        pairs += [(values, second.privileged[name]) for name, values in first.privileged.items()]
        return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in pairs)

    return same


@pytest.fixture
def start_run(tmp_path):
    """Starts a run on two processes, in a group of its own as a terminal does, and waits for two
    finished trials."""
    if os.name != "posix":
        pytest.skip("sends signals to a group of processes")
    started = []

    def run():
        command = [sys.executable, "-m", "torch_geometric_tactile", "simulate"]
        command += ["--out", str(tmp_path), "--preset", "ci", "--trials", "1", "--jobs", "2"]
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=heed_ctrl_c,
        )
        started.append(process)
        deadline = time.monotonic() + 120
        while len(list(tmp_path.glob("*.h5"))) < 2:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.005)
        return process

    yield run
    for process in started:
        if _running(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


def _running(group):
    """The processes of a group that have not ended."""
    listed = subprocess.run(
        ["ps", "-eo", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    return [row for row in rows if int(row[0]) == group and not row[1].startswith("Z")]


@pytest.fixture
def wait_until_gone():
    """Waits until a group of processes has ended: ``wait_until_gone(group, seconds)``."""

    def wait(group, seconds):
        deadline = time.monotonic() + seconds
        while _running(group):
            assert time.monotonic() < deadline, _running(group)
            time.sleep(0.1)

    return wait
