r"""Models of a comparison that begin with a pretrained encoder."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal, Self

import numpy as np
import torch
from sklearn.pipeline import Pipeline, make_pipeline
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._files import file_sha256
from torch_geometric_tactile.baselines import (
    DescriptorFeatures,
    descriptor_forest,
    descriptor_svm,
)
from torch_geometric_tactile.baselines._readings import readings
from torch_geometric_tactile.data import StaticData, split_frames
from torch_geometric_tactile.nn.models import TaxelEncoder
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import ZScore
from torch_geometric_tactile.transforms._windows import given_num_frames, repeated


def encoder_arguments(
    path: str, layout: TaxelLayout, num_channels: int, tare: Mapping[str, Any] | None
) -> dict[str, str]:
    r"""Returns the arguments that name an encoder and the content of its file, which must be of the
    sensor of the data, and trained on readings that were prepared as these are.
    """
    encoder = PretrainedEncoder.load(path)
    encoder.check(layout, num_channels)
    rest, own = (tare or {}).get("first"), encoder.trained_on.get("rest")
    if rest != own:
        raise ValueError(
            f"'tare' must be of the first {own or 0} frames of a trial, as in the pretraining of "
            f"'{path}' (got {rest or 0})"
        )
    return {"encoder": path, "checksum": file_sha256(path)}


@lru_cache(maxsize=2)
def _loaded(path: str, checksum: str) -> PretrainedEncoder:
    encoder = PretrainedEncoder.load(path)
    if file_sha256(path) != checksum:
        raise ValueError(f"'{path}' has changed since the comparison began: begin it anew")
    return encoder


class EncoderScale(BaseTransform):
    r"""Scales readings, of windows those of each frame, as an encoder does."""

    supports_static = True

    def __init__(self, encoder: str, checksum: str) -> None:
        self.encoder = encoder
        model = _loaded(encoder, checksum).model
        self.center, self.scale = model.center, model.scale

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`."""
        num_frames = given_num_frames(data) or 1
        center, scale = (
            repeated(value.expand_as(self.center), num_frames)
            for value in (self.center, self.scale)
        )
        data.x = (data.x.float() - center) / scale
        return data


class EncoderFeatures(DescriptorFeatures):
    r"""The features of an encoder, of windows those of the last frame and of the mean frame, and
    descriptors of readings that are scaled here, and the readings themselves.
    """

    def __init__(
        self,
        layout: Any,
        encoder: str = "",
        checksum: str = "",
        with_readings: bool = False,
        balanced: bool = False,
    ) -> None:
        super().__init__(layout, with_readings, balanced)
        self.encoder = encoder
        self.checksum = checksum

    def fit(self, x: Any, y: Any = None) -> Self:
        r"""Measures the scale of the readings."""
        samples = _samples(x)
        of_frames = samples.get("num_frames") is None
        per: Literal["taxel", "signal"] = "taxel" if of_frames else "signal"
        self.scale_ = ZScore(per=per, scale_per="channel", with_mean=False).fit(samples)
        return self

    def _rows(self, x: Any) -> np.ndarray:
        samples = _samples(x)
        frames, num_frames = [samples.x], given_num_frames(samples)
        if num_frames is not None:
            each = split_frames(samples.x, num_frames)
            frames = [each[:, :, -1], each.nanmean(dim=2)]
        encoder = _loaded(self.encoder, self.checksum)
        found = [encoder.embed(frame).numpy() for frame in frames]
        return np.concatenate([*found, super()._rows(self.scale_(samples))], axis=1)


def _samples(x: Any) -> StaticData:
    # A copy without what the scale would have to keep.
    values = torch.from_numpy(readings(x).astype(np.float32))
    kept = StaticData(x=values)
    if isinstance(x, StaticData) and x.get("num_frames") is not None:
        kept.num_frames = x.num_frames
    return kept


def encoder_forest(
    layout: TaxelLayout, task: Any = "multiclass", *, encoder: str, checksum: str, **arguments: Any
) -> Pipeline:
    r"""Returns extra trees on the features of an encoder, descriptors and readings."""
    forest = descriptor_forest(layout, task, **arguments)
    features = EncoderFeatures(layout, encoder, checksum, with_readings=True, balanced=True)
    return make_pipeline(features, *(part for _, part in forest.steps[1:]))


def encoder_svm(
    layout: TaxelLayout,
    task: Any = "multiclass",
    *,
    encoder: str,
    checksum: str,
    with_readings: bool = False,
    **arguments: Any,
) -> Pipeline:
    r"""Returns a support vector machine on the features of an encoder and descriptors."""
    machine = descriptor_svm(layout, task, **arguments)
    features = EncoderFeatures(layout, encoder, checksum, with_readings)
    return make_pipeline(features, *(part for _, part in machine.steps[1:]))


class TunedEncoder(TaxelEncoder):
    r"""A pretrained encoder with a layer for labels, of readings behind :class:`EncoderScale`."""

    def __init__(self, encoder: str, checksum: str, out_channels: int = 2) -> None:
        found = _loaded(encoder, checksum)
        super().__init__(**{**found.model._hub_arguments, "out_channels": out_channels})
        own = {k: v for k, v in found.model.state_dict().items() if not k.startswith("lin_out.")}
        self.load_state_dict(own, strict=False)
        self.center.zero_()
        self.scale.fill_(1.0)
