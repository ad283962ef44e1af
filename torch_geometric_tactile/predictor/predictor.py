r"""From a reading to probabilities."""

import copy
from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.transforms import Compose

from torch_geometric_tactile._typing import PathLike, Transform
from torch_geometric_tactile.data import Recording, StaticDataset
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.predictor import content
from torch_geometric_tactile.predictor._preparation import ArrayLike, Preparation, shared_by_frames
from torch_geometric_tactile.predictor._trained_model import Task, TrainedModel
from torch_geometric_tactile.predictor._windowed_model import WindowedModel, check_size
from torch_geometric_tactile.predictor.content import Content
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import Tare


class Predictor(WindowedModel):
    r"""A trained model together with everything that prepares its readings: the layout of the
    sensor, the fitted transforms and the names of its classes. It takes readings as the sensor
    gives them.

    Model and transforms are copied, and the model is always in evaluation mode. Whatever depends
    on the layout only, such as a nearest-neighbour graph, is computed once.

    A missing reading (NaN) goes through the transforms like any other. Without
    :class:`~torch_geometric_tactile.transforms.FillMissing` among them, the probabilities of its
    frame are NaN, and :meth:`labels` gives it no label; other frames are not affected.

    Args:
        model (torch.nn.Module): Called as :obj:`model(x, edge_index)`, and with the attributes
            that its :obj:`modalities` names, if it has them, by keyword; returns logits
            :math:`(B, C)`.
        layout (TaxelLayout): The taxels.
        transform (callable, optional): What a reading goes through: one transform, fitted where it
            must be, or PyG's :class:`~torch_geometric.transforms.Compose` of several.
        class_names (sequence of str): Names of the classes or labels; their numbers if left out.
        task (str): :obj:`"multiclass"` (one class a frame), :obj:`"multilabel"` (0 or 1 for each
            label) or :obj:`"regression"` (numbers).
        adjacency (str or torch.Tensor, optional): The edges before any transform: an adjacency of
            the layout by its name, or :math:`(2, |\mathcal{E}|)`.
        pre_transform (callable, optional): What a reading goes through first, once; data given to
            :meth:`prepare_samples` has been through it.
        num_channels (int, optional): Number of channels of a taxel; not checked if left out.
        num_joints (int, optional): Number of joint angles of a frame; likewise.
        threshold (float, optional): Of two classes, the probability of class 1 above which
            :meth:`labels` tells it; one half if left out.

    A model that was trained on :class:`~torch_geometric_tactile.data.Windows` or
    :class:`~torch_geometric_tactile.data.Trials` takes windows of raw frames, as these cut them; of
    a :class:`~torch_geometric_tactile.data.Recording`, it cuts them itself.

    Shapes:
        - **reading:** :math:`(N, F)` or :math:`(B, N, F)`; windows :math:`(N, C \cdot T)` or
          :math:`(B, N, C \cdot T)`
        - **joint:** angles in radians :math:`(J,)` or :math:`(B, J)`
        - **output:** probabilities :math:`(C,)` for one frame, or :math:`(B, C)`; for a regression
          the numbers themselves

    Raises:
        ValueError: If :obj:`task` is unknown; on a call, if a reading has another shape, or what
            the transforms or the model need is missing.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.nn.models import GraspGCN
        >>> from torch_geometric_tactile.transforms import KNNGraph
        >>> dataset = FakeTactileDataset(num_samples=100, pre_transform=KNNGraph(k=2))
        >>> predictor = Predictor.from_dataset(GraspGCN(), dataset)
        >>> predictor
        Predictor(GraspGCN, 'biotac_sp', classes=['stable', 'slip'], task='multiclass')
        >>> predictor(dataset[0].x).shape
        torch.Size([2])
    """

    def __init__(
        self,
        model: Module,
        layout: TaxelLayout,
        transform: Transform | None = None,
        class_names: Sequence[str] = (),
        task: Task = "multiclass",
        *,
        adjacency: str | Tensor | None = None,
        pre_transform: Transform | None = None,
        num_channels: int | None = None,
        num_joints: int | None = None,
        threshold: float | None = None,
    ) -> None:
        shared = shared_by_frames(layout, adjacency)
        preparation = Preparation(
            layout, shared, pre_transform, transform, num_channels, num_joints
        )
        names = tuple(class_names)
        super().__init__(Content(preparation, copy.deepcopy(model), names, task, threshold))

    @classmethod
    def _of(cls, parts: Content) -> Self:
        predictor = cls.__new__(cls)
        TrainedModel.__init__(predictor, parts)
        return predictor

    @classmethod
    def from_dataset(
        cls,
        model: Module,
        dataset: StaticDataset,
        transform: Transform | None = None,
        task: Task = "multiclass",
        threshold: float | None = None,
    ) -> Self:
        r"""Returns the predictor of a model that was trained on a data set, with the data set's
        layout, edges, transforms and class names.

        Args:
            model (torch.nn.Module): The model.
            dataset (StaticDataset): The data set.
            transform (callable, optional): What came after the data set's own transform in
                training, such as a fitted scaler.
            task (str): As of the class.
            threshold (float, optional): As of the class.
        """
        preparation = Preparation.of_dataset(dataset, transform)
        names = tuple(dataset.class_names)
        return cls._of(Content(preparation, copy.deepcopy(model), names, task, threshold))

    @classmethod
    def from_checkpoint(
        cls,
        path: PathLike,
        model: Module | None = None,
        transforms: Sequence[Transform] | None = None,
    ) -> Self:
        r"""Returns the predictor of a checkpoint of ``tactile fit``, without Lightning.

        Args:
            path (str or PathLike): The checkpoint.
            model (torch.nn.Module, optional): As of :meth:`load`.
            transforms (sequence of callable, optional): As of :meth:`load`.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file cannot be read, or as :meth:`load`.
        """
        return cls._of(content.load_checkpoint(path, model, transforms))

    @classmethod
    def load(
        cls,
        path: PathLike,
        model: Module | None = None,
        transforms: Sequence[Transform] | None = None,
    ) -> Self:
        r"""Reads a predictor from a file of :meth:`save`. Only models and transforms of this
        package (and some of PyG's) are built by their names; nothing in the file runs.

        Args:
            path (str or PathLike): The file.
            model (torch.nn.Module, optional): A model of your own, of the class and sizes of the
                one that was saved; its weights are those of the file.
            transforms (sequence of callable, optional): Transforms of your own among those that
                were saved, with the same class and :obj:`repr`; what they were fitted to is taken
                from the file. Others are ignored.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is damaged or of another version, or :obj:`model` or
                :obj:`transforms` are missing or differ from those that were saved.
        """
        return cls._of(content.load(path, model, transforms))

    def save(self, path: PathLike) -> None:
        r"""Writes the predictor to one file of JSON and tensors, in the format of safetensors. The
        file is written whole or not at all.

        Args:
            path (str or PathLike): The file.
        """
        names = self.class_names
        parts = Content(self.preparation, self.model, names, self.task, self.threshold)
        content.save(parts, path)

    def __call__(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        session: int | None = None,
    ) -> Tensor:
        r"""Returns the probabilities of the classes or labels."""
        with torch.inference_mode():
            out = self.probability(self.logits(self.prepare(reading, joint, session)))
        num_dims = reading.ndim if hasattr(reading, "ndim") else np.ndim(reading)
        return out[0] if num_dims == 2 else out

    def with_tare(self) -> Self:
        r"""Returns a predictor of raw readings, where this one takes readings relative to rest,
        such as those of :obj:`AllegroUSkin(tare="hover")`: :class:`~torch_geometric_tactile.
        transforms.Tare` comes first, and :meth:`adapt` measures the rest.

        Raises:
            ValueError: If a transform measures sessions already, or frames go through a transform
                before they are cut to windows.
        """
        preparation = self.preparation
        measures = [part for part in preparation.fitted if part.key is not None]
        if measures:
            raise ValueError(f"the predictor measures the rest already, by {measures[0]!r}")
        if flat(preparation.frame_transform):
            raise ValueError(
                "the rest must be subtracted before all other transforms, and frames go through "
                f"{preparation.frame_transform!r} before they are cut to windows"
            )
        tared = Preparation(
            preparation.layout,
            preparation.shared,
            Compose([Tare(), *flat(preparation.pre_transform)]),
            preparation.transform,
            preparation.num_channels,
            preparation.num_joints,
            window=preparation.window,
            read_options=preparation.read_options,
        )
        names = self.class_names
        return self._of(Content(tared, copy.deepcopy(self.model), names, self.task, self.threshold))

    def recording(self, recording: Recording, batch_size: int = 256) -> Tensor:
        r"""Returns the probabilities of all frames of a recording :math:`(T, C)`, or of a model of
        windows those of its windows :math:`(W, C)`, cut as in training.

        Args:
            recording (Recording): The recording, in the unit and at the rest (tare) of those that
                the model was trained on.
            batch_size (int): Number of frames or windows that are computed at a time.

        Raises:
            ValueError: If it has other taxels, channels, joints or names of columns, or too few
                frames for a window.
        """
        if self.window is not None:
            return self.of_windows(self.windows(recording)[0], batch_size)
        recording = self.preparation.ordered(recording)
        parts = [self(one.tactile, one.joint) for one in _chunks(recording, batch_size)]
        return torch.cat(parts)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({type(self.model).__name__}, '{self.layout.name}', "
            f"classes={list(self.class_names)}, task='{self.task}')"
        )


def _chunks(recording: Recording, size: int) -> Iterator[Any]:
    check_size(size)
    for start in range(0, max(recording.num_frames, 1), size):
        yield recording.select(slice(start, start + size))
