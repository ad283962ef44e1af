r"""Facts of data sets."""

import torch

from torch_geometric_tactile.data import StaticDataset


def num_frames_of(dataset: StaticDataset) -> int | None:
    r"""Returns the number of frames that each sample says it has, or :obj:`None` of single
    frames.
    """
    number = dataset.column("num_frames")
    return None if number is None else int(torch.as_tensor(number).view(-1)[0])
