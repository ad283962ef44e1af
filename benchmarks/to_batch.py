r"""How long a block-diagonal batch takes to build: StaticData.to_batch() against
Batch.from_data_list of the samples, whose numbers are the same, and how long a batch takes to cut.

    python benchmarks/to_batch.py
"""

import timeit
from collections.abc import Callable

import torch
from shared import table
from torch_geometric.data import Batch

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import allegro_uskin, biotac_sp
from torch_geometric_tactile.transforms import KNNGraph


def samples(num_samples: int, num_taxels: int) -> StaticData:
    r"""Returns random readings of a BioTac SP (24 taxels) or of a hand (384)."""
    layout = allegro_uskin() if num_taxels == 384 else biotac_sp()
    data = StaticData(
        x=torch.randn(num_samples, num_taxels, 3),
        pos=layout.pos,
        y=torch.arange(num_samples) % 2,
        joint=torch.randn(num_samples, 16),
    )
    if num_taxels == 384:
        data.edge_index = layout.edge_index("original")
        return data
    return KNNGraph(k=4)(data)


def milliseconds(call: Callable[[], object], seconds: float = 2.0) -> float:
    r"""Returns the time of the fastest of many calls, which other processes disturbed least."""
    repeat = max(10, round(seconds / min(timeit.repeat(call, number=1, repeat=3))))
    return 1e3 * min(timeit.repeat(call, number=1, repeat=repeat))


def main() -> None:
    r"""Prints the table."""
    torch.set_num_threads(1)
    head = ["taxels", "batch", "cut (ms)", "to_batch (ms)", "of a list (ms)", "of the samples (ms)"]
    rows = []
    for num_taxels in (24, 384):
        whole = samples(1000, num_taxels)
        for batch_size in (64, 128):
            index = torch.randperm(len(whole))[:batch_size]
            data = whole.index_select(index)
            found, expected = data.to_batch(), Batch.from_data_list(data.to_data_list())
            for key in expected.keys():  # noqa: SIM118
                assert torch.equal(found[key], expected[key]), key
            listed = data.to_data_list()
            cut = milliseconds(lambda index=index, whole=whole: whole.index_select(index))
            fast = milliseconds(data.to_batch)
            of_list = milliseconds(lambda listed=listed: Batch.from_data_list(listed))
            slow = milliseconds(lambda data=data: Batch.from_data_list(data.to_data_list()))
            cells = (f"{ms:.2f} ({ms / fast:.0f}x)" for ms in (of_list, slow))
            rows.append([str(num_taxels), str(batch_size), f"{cut:.3f}", f"{fast:.3f}", *cells])
    print("\n".join(table(head, rows)))


if __name__ == "__main__":
    main()
