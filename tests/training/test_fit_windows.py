import copy
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from training import fit_on_two_processes as two

from torch_geometric_tactile.data import split_frames

SCRIPT = Path(two.__file__)
# What other tests, or a cluster, may have set.
_OF_PROCESSES = {"LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT", "NODE_RANK", "WORLD_SIZE"}


def trials_of(windows, numbers):
    trial = dict(zip(windows.number.tolist(), windows.trial.tolist(), strict=True))
    return {trial[number] for number in numbers}


def test_windows_of_the_fit_are_those_of_their_trials():
    parts = two.data(two.moving_windows(20))
    parts.setup()
    batch = next(iter(parts.train_dataloader()))
    assert split_frames(batch.x, batch.num_frames).shape == (128, 4, two.LENGTH, 1)
    assert batch.y.equal(batch.trial % 2)


def test_model_learns_windows_of_other_trials(tmp_path):
    windows, seen, model = two.moving_windows(20), two.Seen(), two.module()
    before, parts = copy.deepcopy(model.state_dict()), two.data(windows)
    trainer = two.trainer(seen, devices=1, default_root_dir=tmp_path)
    trainer.fit(model, datamodule=parts)
    assert not any(value.equal(before[name]) for name, value in model.named_parameters())
    losses = [sum(epoch) / len(epoch) for epoch in seen.loss]
    assert losses[-1] < 0.7 * losses[0]
    assert all(sorted(epoch) == sorted(seen.train[0]) for epoch in seen.train)
    assert seen.train[0] != seen.train[1]
    assert sorted(seen.train[0]) == sorted(parts.part("train").number.tolist())
    held_out = [parts.part(name).number.tolist() for name in ("val", "test")]
    assert sorted(seen.val) == sorted(held_out[0])
    trials = [trials_of(windows, numbers) for numbers in (seen.train[0], *held_out)]
    assert [len(some) for some in trials] == [12, 4, 4]
    assert len(set.union(*trials)) == 20
    (metrics,) = trainer.test(model, parts, verbose=False)
    assert metrics["test/accuracy"] > 0.9


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What two processes saw."""
    folder = tmp_path_factory.mktemp("two")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(folder)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={key: value for key, value in os.environ.items() if key not in _OF_PROCESSES},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [json.loads((folder / f"rank{rank}.json").read_text()) for rank in range(2)]


@pytest.mark.full
@pytest.mark.parametrize("name", ["random", "larger than memory", "given"])
def test_two_processes_see_every_window_once_an_epoch(told, name):
    windows = two.moving_windows()
    wanted = windows.number.tolist()
    if name != "given":
        parts = two.data(windows)
        parts.setup()
        wanted = parts.part("train").number.tolist()
        held_out = parts.part("val").number.tolist()
        assert sorted(i for rank in told for i in rank[name]["val"]) == sorted(held_out)
        assert not trials_of(windows, held_out) & trials_of(windows, wanted)
    assert len(wanted) % 2 == 0  # otherwise one is drawn twice
    first, second = (rank[name]["train"] for rank in told)
    assert len(first) == two.EPOCHS
    for mine, others in zip(first, second, strict=True):
        assert len(mine) == len(others)
        assert sorted(mine + others) == sorted(wanted)
    assert first[0] != first[1]


@pytest.mark.full
@pytest.mark.parametrize("name", ["random", "larger than memory", "given"])
def test_two_processes_train_one_model(told, name):
    first, second = (rank[name] for rank in told)
    assert first["weights"] == second["weights"]
    for rank in (first, second):
        losses = [sum(epoch) / len(epoch) for epoch in rank["loss"]]
        assert losses[-1] < 0.9 * losses[0]
    assert name != "larger than memory" or first["accuracy"] == second["accuracy"] > 0.9
