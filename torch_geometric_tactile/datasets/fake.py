r"""A data set of generated grasps."""

from typing import Literal

import torch
from torch import Tensor

from torch_geometric_tactile._typing import Filter, Transform
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.datasets._splits import checked_split
from torch_geometric_tactile.datasets.biotac_sp import BioTacSP
from torch_geometric_tactile.sensors import TaxelLayout, biotac_sp

_SESSIONS = ("palm_down", "palm_side", "palm_45")


class FakeTactileDataset(StaticDataset):
    r"""A data set of simulated grasps with the attributes of
    :class:`~torch_geometric_tactile.datasets.BioTacSP`, for tests, examples and machines without
    network access.

    The readings are simulated by :obj:`simulate_grasps`. The test split has other objects and other
    sessions than the training split.

    The edges are taken from the layout. The layout of a BioTac SP has no edges; add some with
    ``pre_transform=KNNGraph(k=4)`` (see :class:`~torch_geometric_tactile.transforms.KNNGraph`).

    Args:
        num_samples (int): Number of grasps in each split, rounded up so that all objects have the
            same number.
        split (str, optional): :obj:`"train"`, :obj:`"test"`, or :obj:`None` for all samples.
        layout (TaxelLayout, optional): The fingertip; a BioTac SP by default.
        num_objects (int): Number of objects.
        num_fingers (int): Number of fingers.
        seed (int): Seed of the random numbers.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once.
        pre_filter (callable, optional): Returns whether to keep a sample.
        num_test (int, optional): Number of test grasps; :obj:`num_samples` by default.

    Raises:
        ValueError: If :obj:`split` is unknown or a number is below one.

    Examples:
        >>> dataset = FakeTactileDataset(num_samples=100)
        >>> dataset
        FakeTactileDataset(100)
        >>> dataset[0].x.shape
        torch.Size([24, 3])
    """

    group_kind = "object"

    def __init__(
        self,
        num_samples: int = 1000,
        split: Literal["train", "test"] | None = "train",
        *,
        layout: TaxelLayout | None = None,
        num_objects: int = 10,
        num_fingers: int = 3,
        seed: int = 0,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        num_test: int | None = None,
    ) -> None:
        num_test = num_samples if num_test is None else num_test
        for name, number in (
            ("num_samples", num_samples),
            ("num_objects", num_objects),
            ("num_test", num_test),
        ):
            if number < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {number})")
        self.layout = biotac_sp() if layout is None else layout
        self.num_samples = num_samples
        self.num_test = num_test
        self.split = checked_split(split, ("train", "test"))
        self.num_objects = num_objects
        self.num_fingers = num_fingers
        self.seed = seed
        super().__init__(None, transform, pre_transform, pre_filter)

    part = BioTacSP.part

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Generates the samples."""
        offsets = {"train": (0,), "test": (1,), None: (0, 1)}[self.split]
        parts = [self._generate(offset) for offset in offsets]
        x, y, group, session = (torch.cat(values) for values in zip(*parts, strict=True))
        adjacency = self.layout.default_adjacency
        data = StaticData(
            x=x,
            edge_index=None if adjacency is None else self.layout.edge_index(adjacency),
            y=y,
            pos=self.layout.pos,
            normal=self.layout.normal,
            trial=torch.arange(len(y)),
            group=group,
            session=session,
        )
        names = {
            "class": ["stable", "slip"],
            "group": [f"object_{i}" for i in range(2 * self.num_objects)],
            "session": [*_SESSIONS, *(f"{name}_test" for name in _SESSIONS)],
        }
        return data, names

    def _generate(self, offset: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        from torch_geometric_tactile.sim._biotac_grasp import simulate_grasps

        num_samples = self.num_test if offset else self.num_samples
        num_objects = min(self.num_objects, num_samples)
        grasps = simulate_grasps(
            self.layout,
            objects=num_objects,
            grasps_per_object=-(-num_samples // num_objects),  # rounded up
            sessions=len(_SESSIONS),
            num_fingers=self.num_fingers,
            seed=2 * self.seed + offset,
            pose_seed=self.seed,  # both splits have the same palm poses
        )
        return (
            torch.from_numpy(grasps.reading),
            torch.from_numpy(grasps.slipped),
            torch.from_numpy(grasps.group) + offset * self.num_objects,
            torch.from_numpy(grasps.session) + offset * len(_SESSIONS),
        )
