import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._run_store import RunStore
from torch_geometric_tactile.experiments.source import DataSource


def test_clean_removes_what_a_killed_run_left_and_not_what_a_second_run_writes(tmp_path):
    experiment = Experiment(
        data=DataSource("a.B", {}, fingerprint="d"),
        protocol=Protocol("trial"),
        protocol_name="by trial",
        name="a",
        model={"x": 1},
        epochs=2,
    )
    store = RunStore(tmp_path)
    leftover = tmp_path / f".{experiment.file_name}.5.tmp"
    leftover.write_text("half")
    with atomic_path(tmp_path / experiment.file_name) as alive:
        store.clean([experiment])
        assert list(tmp_path.iterdir()) == [alive]
        alive.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == [experiment.file_name]
