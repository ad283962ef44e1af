r"""Removal of the frames before contact."""

import logging
import math
from collections.abc import Callable, Set
from typing import Literal

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._attributes import FRAMES
from torch_geometric_tactile.transforms._random import check_integer
from torch_geometric_tactile.transforms._windows import (
    require_signals,
    signals_to_windows,
    valid_frames,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MAX_FRAMES = 100_000
_MISSING = ("error", "keep")
_DEVIATION_PER_MAD = 1.4826  # standard deviation over median absolute deviation, normal noise

_logger = logging.getLogger(__name__)


@functional_transform("contact_crop")
class ContactCrop(TactileTransform):
    r"""Removes the frames of each window before the fingers touch the object (functional name:
    :obj:`contact_crop`). All channels (fingers) are cut at the same frame, so that they stay
    synchronous.

    The first :obj:`rest` frames must be at rest. Contact begins at the first frame at which a
    channel of a taxel differs from its median at rest, for :obj:`sustain` frames in a row, by more
    than

    .. math::
        \max(k \, \sigma, \text{floor})

    Here :math:`\sigma` is the standard deviation at rest: 1.4826 times the median absolute
    deviation of the taxel, but at least the median of this number over all taxels in the window,
    since ten frames are too few to measure a single taxel.

    The threshold does not depend on labels. Noise rarely exceeds it: normal noise exceeds
    :math:`5 \sigma` once in 1.7 million frames of a taxel, and :obj:`sustain` excludes spikes. The
    floor accounts for the steps of the converter, which make :math:`\sigma` zero on quiet taxels,
    and for drift between rest and contact. Its default is meant for counts; set it for readings in
    another unit.

    Contact in the first frames is not detected, nor is contact that grows as slowly as the drift.
    Such windows are left unchanged or raise an error, depending on :obj:`missing`. The number of
    unchanged windows is logged.

    The transform looks ahead by at most :obj:`sustain` frames, so that it also works live
    (:obj:`causal = True`): the window begins at contact. Other time series of a sample are not cut;
    :obj:`contact_frame` is the frame of contact in them.

    Args:
        rest (int): Number of frames at rest at the start of each window.
        k (float): Threshold in robust standard deviations.
        floor (float): The smallest threshold, in the unit of the readings.
        sustain (int): Number of frames for which a taxel must exceed the threshold.
        before (int): Number of frames to keep before contact.
        missing (str): The handling of windows without contact: :obj:`"error"` raises an error,
            :obj:`"keep"` leaves them unchanged.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`, with :obj:`num_frames` :math:`T`; padded windows with
          :obj:`valid_frames` :math:`(B,)`
        - **output:** the same shape, padded with NaN. :obj:`valid_frames` :math:`(B,)` is the
          number of frames in each window without the padding. :obj:`contact_frame` :math:`(B,)` is
          the frame of contact in the input window, or -1 without contact.

    Raises:
        ValueError: If an argument is out of range, a window has no contact and :obj:`missing` is
            :obj:`"error"`, there are no readings or no :obj:`num_frames`, or :obj:`num_frames` is
            not above :obj:`rest`.

    Examples:
        >>> window = Data(x=torch.tensor([[0.0, 1.0, 0.0, 1.0, 50.0, 60.0, 70.0]]), num_frames=7)
        >>> data = ContactCrop(rest=4, sustain=2)(window)
        >>> data.x
        tensor([[50., 60., 70., nan, nan, nan, nan]])
        >>> data.valid_frames, data.contact_frame
        (tensor([3]), tensor([4]))
    """

    reads = ("x", *FRAMES)
    writes = ("x", "valid_frames", "contact_frame")
    per_frame = False

    def __init__(
        self,
        rest: int = 10,
        k: float = 5.0,
        floor: float = 5.0,
        *,
        sustain: int = 3,
        before: int = 0,
        missing: Literal["error", "keep"] = "error",
    ) -> None:
        self.rest = check_integer("rest", rest, 1, _MAX_FRAMES)
        for name, value in (("k", k), ("floor", floor)):
            if not 0 <= value < math.inf:
                raise ValueError(f"'{name}' must be at least 0 and finite (got {value})")
        need(missing in _MISSING, f"'missing' must be one of {list(_MISSING)} (got {missing!r})")
        self.k = float(k)
        self.floor = float(floor)
        self.sustain = check_integer("sustain", sustain, 1, _MAX_FRAMES)
        self.before = check_integer("before", before, 0, _MAX_FRAMES)
        self.missing = missing

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`, :obj:`valid_frames` and :obj:`contact_frame`."""
        signals = require_signals(self, data)
        num_samples, num_frames = len(signals), signals.size(-1)
        if num_frames <= self.rest:
            raise ValueError(
                f"'num_frames' must be above {self.rest}, the number of frames at rest (got "
                f"{num_frames})"
            )
        valid = valid_frames(data, num_samples, num_frames, signals.device)
        contact = self.contact(signals, valid)
        self._check_contact(contact)
        start = (contact - self.before).clamp(min=0)
        frames = torch.arange(num_frames, device=signals.device)
        source = (start.unsqueeze(1) + frames).clamp(max=num_frames - 1)
        source = source[:, None, None].expand_as(signals)
        is_padding = frames >= (valid - start).unsqueeze(1)
        out = signals.gather(-1, source).masked_fill(is_padding[:, None, None], torch.nan)
        data.x = signals_to_windows(out, data)
        data.valid_frames = valid - start
        data.contact_frame = contact
        return data

    def contact(self, signals: Tensor, valid: Tensor) -> Tensor:
        r"""Returns the frame of contact of each window; -1 without contact.

        Args:
            signals (torch.Tensor): The readings with time as the last dimension
                :math:`(S, N, C, T)`.
            valid (torch.Tensor): The number of frames of each window without padding
                :math:`(S,)`.

        Shapes:
            - **output:** :math:`(S,)`
        """
        if signals.numel() == 0:
            return valid.new_full((len(signals),), -1)
        stays = self.stays_beyond(signals)
        num_frames = signals.size(-1)
        last = (valid - self.sustain).unsqueeze(1)
        is_touched = stays.flatten(1, 2).any(dim=1)
        is_touched &= torch.arange(num_frames, device=signals.device) <= last
        has_contact = is_touched.any(dim=1)
        return torch.where(has_contact, is_touched.byte().argmax(dim=1), -1)

    def stays_beyond(self, signals: Tensor) -> Tensor:
        r"""Returns whether a channel of a taxel exceeds its threshold in a frame and the frames
        after it, :obj:`sustain` frames in total.

        Args:
            signals (torch.Tensor): The readings with time as the last dimension
                :math:`(S, N, C, T)`.

        Shapes:
            - **output:** booleans :math:`(S, N, C, T)`
        """
        rest_signals = signals[..., : self.rest]
        center = _median(rest_signals).unsqueeze(-1)
        spread = _median((rest_signals - center).abs())
        median_spread = _median(spread.flatten(1))[:, None, None]
        threshold = (self.k * _DEVIATION_PER_MAD * torch.fmax(spread, median_spread)).clamp(
            min=self.floor
        )
        exceeds = (signals - center).abs_() > threshold.unsqueeze(-1)
        # Frames after the end of the window do not exceed the threshold.
        stays = exceeds
        for i in range(1, self.sustain):
            stays = stays & torch.nn.functional.pad(exceeds[..., i:], (0, min(i, exceeds.size(-1))))
        return stays

    def _check_contact(self, contact: Tensor) -> None:
        without_contact = (contact < 0).nonzero().view(-1)
        if len(without_contact) == 0:
            return
        text = (
            f"{len(without_contact)} of {len(contact)} windows, the first is "
            f"{int(without_contact[0])}"
        )
        if self.missing == "error":
            raise ValueError(
                f"each window must have contact (got none in {text}): set missing='keep' in "
                f"{type(self).__name__} to leave them unchanged, or lower the threshold"
            )
        _logger.warning("no contact in %s: kept unchanged by %r", text, self)

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Raises a :class:`NotImplementedError`, since the length of the windows is not fixed."""
        raise NotImplementedError(
            f"{self!r} cannot be exported: the length of its windows depends on the readings"
        )


def _median(values: Tensor) -> Tensor:
    # The median over the last dimension without missing values. `torch.nanmedian` returns the lower
    # of two middle values instead of their mean.
    sorted_values = values.sort(dim=-1).values  # NaN comes last
    count = (~values.isnan()).sum(dim=-1, keepdim=True)
    middle = torch.cat([(count - 1).clamp(min=0) // 2, count // 2], dim=-1)
    return sorted_values.gather(-1, middle).mean(dim=-1)
