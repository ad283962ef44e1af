import logging

import pytest
import torch
from torch.utils.data import DistributedSampler, RandomSampler

from torch_geometric_tactile.data import StaticDataset, Windows
from torch_geometric_tactile.loader import BlockSampler, StaticLoader, static_loader
from torch_geometric_tactile.loader._memory_limit import exceeds_memory, memory_limit
from torch_geometric_tactile.sensors import grid


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def frames_of(size=1000):
    x, trial = torch.rand(size, 4, 1), torch.arange(size) // 100
    return StaticDataset.from_arrays(
        x, trial % 2, trial=trial, number=torch.arange(size), layout=grid(2, 2, 0.002)
    )


@pytest.mark.parametrize("size", [1, 7, 64, 100])
def test_each_sample_is_drawn_once_an_epoch(size):
    sampler = BlockSampler(range(size), block_size=8, num_blocks=3, generator=generator())
    first, second = list(sampler), list(sampler)
    assert sorted(first) == sorted(second) == list(range(size))
    assert len(sampler) == size
    assert size < 8 or first != second


def test_order_is_random_within_a_few_blocks():
    sampler = BlockSampler(range(96), block_size=8, num_blocks=3, generator=generator())
    order = list(sampler)
    for start in range(0, 96, 24):
        part = order[start : start + 24]
        assert len({i // 8 for i in part}) == 3
        assert part != sorted(part)
    assert [i // 8 for i in order[:8]].count(order[0] // 8) < 8


def test_order_follows_from_the_generator():
    orders = [list(BlockSampler(range(99), 8, 3, generator(seed))) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]
    torch.manual_seed(3)
    first = list(BlockSampler(range(99), 8, 3))
    torch.manual_seed(3)
    assert list(BlockSampler(range(99), 8, 3)) == first


@pytest.mark.parametrize("name", ["block_size", "num_blocks"])
def test_bad_numbers(name):
    with pytest.raises(ValueError, match=f"'{name}' must be at least 1"):
        BlockSampler(range(9), **{name: 0})


@pytest.mark.parametrize("make", [lambda frames: frames, lambda frames: Windows(frames, 3)])
@pytest.mark.parametrize("num_workers", [0, 2])
def test_loader_shuffles_by_blocks(make, num_workers):
    dataset = make(frames_of())

    def loader(seed=5):
        arguments = {"num_workers": num_workers, "keyed": True, "generator": generator(seed)}
        return StaticLoader(dataset, 64, shuffle="blocks", **arguments)

    ours = loader()
    assert isinstance(ours.sampler, BlockSampler)
    whole = [batch.number.tolist() for batch in ours]
    assert sorted(number for batch in whole for number in batch) == sorted(dataset.number.tolist())
    assert [batch.number.tolist() for batch in loader()] == whole
    assert [batch.number.tolist() for batch in loader(seed=6)] != whole


def test_shuffle_with_bad_arguments():
    with pytest.raises(ValueError, match="must be True, False or 'blocks'"):
        StaticLoader(frames_of(9), shuffle="block")
    with pytest.raises(ValueError, match="must be left out with a sampler"):
        StaticLoader(frames_of(9), shuffle="blocks", sampler=range(9))


def test_true_is_by_blocks_where_the_data_is_larger_than_memory(monkeypatch, caplog):
    dataset = frames_of()
    assert type(StaticLoader(dataset, shuffle=True).sampler) is RandomSampler
    monkeypatch.setattr(static_loader, "exceeds_memory", lambda dataset: True)
    static_loader._warn_of_blocks.cache_clear()
    with caplog.at_level(logging.WARNING):
        loaders = [StaticLoader(dataset, shuffle=True) for _ in range(2)]
    assert all(isinstance(loader.sampler, BlockSampler) for loader in loaders)
    assert caplog.text.count("shuffled by blocks") == 1
    given = RandomSampler(dataset)
    assert StaticLoader(dataset, sampler=given).sampler is given
    assert not isinstance(StaticLoader(dataset, shuffle=False).sampler, RandomSampler)


def test_data_larger_than_memory():
    frames = frames_of()
    windows = Windows(frames, 50)
    for dataset in (frames, windows, frames[:10]):
        assert exceeds_memory(dataset, limit=frames.nbytes - 1)
        assert not exceeds_memory(dataset, limit=frames.nbytes)
    assert not exceeds_memory(frames)
    assert frames.nbytes > frames.x.nbytes


@pytest.mark.parametrize(
    ("own", "files", "expected"),
    [
        ("0::/job/step\n", {"job/memory.max": "4096", "job/step/memory.max": "max"}, 4096),
        ("0::/job\n", {"job/memory.max": "4096", "memory.max": "2048"}, 2048),
        ("4:cpu,memory:/a\n", {"memory/a/memory.limit_in_bytes": "1024\n"}, 1024),
        ("4:cpu:/a\n", {"memory/a/memory.limit_in_bytes": "1024\n"}, None),
        ("0::/job\n", {"job/memory.max": "9" * 30}, None),
        ("nonsense", {}, None),
    ],
)
def test_memory_limit_of_a_control_group(tmp_path, own, files, expected):
    machine = memory_limit(tmp_path / "none", tmp_path / "none")
    for name, text in files.items():
        path = tmp_path / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "own").write_text(own)
    found = memory_limit(tmp_path / "groups", tmp_path / "own")
    assert found == (machine if expected is None else expected)


def test_lightning_gives_each_process_its_samples():
    connector = pytest.importorskip("lightning.pytorch.trainer.connectors.data_connector")
    utilities = pytest.importorskip("lightning.pytorch.utilities.data")
    loader = StaticLoader(frames_of(), batch_size=50, shuffle="blocks", keyed=True)
    numbers = []
    for rank in range(2):
        sampler = connector._get_distributed_sampler(
            loader, shuffle=True, overfit_batches=0, num_replicas=2, rank=rank
        )
        assert isinstance(sampler, DistributedSampler)
        again = utilities._update_dataloader(loader, sampler)
        numbers += [i for batch in again for i in batch.number.tolist()]
    assert sorted(numbers) == list(range(1000))
