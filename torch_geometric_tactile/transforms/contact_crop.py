r"""Windows that begin with contact."""

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
from torch_geometric_tactile.transforms._random import check_whole
from torch_geometric_tactile.transforms._windows import (
    joined_signals,
    require_signals,
    valid_frames,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MOST_FRAMES = 100_000
_MISSING = ("error", "keep")
_DEVIATION = 1.4826  # of normal noise, by its median absolute deviation

_logger = logging.getLogger(__name__)


@functional_transform("contact_crop")
class ContactCrop(TactileTransform):
    r"""Drops the frames of each window before the fingers touch the object (functional name:
    :obj:`contact_crop`). All channels (fingers) are cut at the same frame, so that they stay
    synchronous.

    The first :obj:`rest` frames are taken to be at rest. Contact is the first frame from which on
    one taxel and channel is, for :obj:`sustain` frames, further from its median at rest than

    .. math::
        \max(k \, \sigma, \text{floor})

    with the deviation :math:`\sigma` at rest: 1.4826 times the median absolute deviation of the
    taxel, or that of half of all taxels in the window if that is larger, since ten frames tell
    little about one taxel.

    The threshold needs no labels; it follows from how seldom noise should pass it. Normal noise is
    beyond :math:`5 \sigma` once in 1.7 million frames of a taxel, and :obj:`sustain` takes out
    spikes; the floor stands for the steps of the converter, which make :math:`\sigma` zero on quiet
    taxels, and for drift between rest and contact. Of readings in another unit than counts, give
    the floor in theirs.

    What is touched in the first frames already, or so slowly that drift is as fast, is not found.
    Windows are then kept whole, or refused, as :obj:`missing` says; the log has their number.

    It looks :obj:`sustain` frames ahead and never further, so that it also works on frames as they
    come: contact opens the window (:obj:`causal = True`). Other time series of a sample are left
    alone; :obj:`contact_frame` says by how much they are ahead.

    Args:
        rest (int): Number of frames at rest that each window begins with.
        k (float): Threshold in robust deviations.
        floor (float): The smallest threshold, in the unit of the readings.
        sustain (int): Number of frames for which a taxel must stay beyond it.
        before (int): Number of frames that are kept before contact.
        missing (str): What becomes of windows without contact: :obj:`"error"`, or :obj:`"keep"`.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`, with :obj:`num_frames` :math:`T`; of padded ones
          :obj:`valid_frames` :math:`(B,)`
        - **output:** the same shape, missing (NaN) behind the last frame of each window; how many
          frames are left, :obj:`valid_frames` :math:`(B,)`, and the frame of contact in the window
          that came in, :obj:`contact_frame` :math:`(B,)`, which is -1 where there is none

    Raises:
        ValueError: If an argument is out of range, a window has no contact and :obj:`missing` is
            :obj:`"error"`, there are no readings or no :obj:`num_frames`, or it is not above
            :obj:`rest`.

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
        self.rest = check_whole("rest", rest, 1, _MOST_FRAMES)
        for name, value in (("k", k), ("floor", floor)):
            if not 0 <= value < math.inf:
                raise ValueError(f"'{name}' must be at least 0 and finite (got {value})")
        need(missing in _MISSING, f"'missing' must be one of {list(_MISSING)} (got {missing!r})")
        self.k = float(k)
        self.floor = float(floor)
        self.sustain = check_whole("sustain", sustain, 1, _MOST_FRAMES)
        self.before = check_whole("before", before, 0, _MOST_FRAMES)
        self.missing = missing

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`, :obj:`valid_frames` and :obj:`contact_frame`."""
        signals = require_signals(self, data)
        num_samples, num_frames = len(signals), signals.size(-1)
        if num_frames <= self.rest:
            raise ValueError(
                f"'num_frames' must be above {self.rest}, the frames at rest (got {num_frames})"
            )
        valid = valid_frames(data, num_samples, num_frames, signals.device)
        contact = self.contact(signals, valid)
        self._check_found(contact)
        start = (contact - self.before).clamp(min=0)
        frames = torch.arange(num_frames, device=signals.device)
        source = (start.unsqueeze(1) + frames).clamp(max=num_frames - 1)
        source = source[:, None, None].expand_as(signals)
        beyond = frames >= (valid - start).unsqueeze(1)
        out = signals.gather(-1, source).masked_fill(beyond[:, None, None], torch.nan)
        data.x = joined_signals(out, data)
        data.valid_frames = valid - start
        data.contact_frame = contact
        return data

    def contact(self, signals: Tensor, valid: Tensor) -> Tensor:
        r"""Returns the frame of contact of each window, -1 where there is none.

        Args:
            signals (torch.Tensor): The readings with time as the last dimension
                :math:`(S, N, C, T)`.
            valid (torch.Tensor): The number of frames of each window :math:`(S,)`.

        Shapes:
            - **output:** :math:`(S,)`
        """
        if signals.numel() == 0:
            return valid.new_full((len(signals),), -1)
        stays = self.stays_beyond(signals)
        num_frames = signals.size(-1)
        last = (valid - self.sustain).unsqueeze(1)
        touched = stays.flatten(1, 2).any(dim=1)
        touched &= torch.arange(num_frames, device=signals.device) <= last
        found = touched.any(dim=1)
        return torch.where(found, touched.byte().argmax(dim=1), -1)

    def stays_beyond(self, signals: Tensor) -> Tensor:
        r"""Returns from which frames on a taxel and channel is beyond its threshold for
        :obj:`sustain` frames.

        Args:
            signals (torch.Tensor): As of :meth:`contact`.

        Shapes:
            - **output:** :math:`(S, N, C, T)`
        """
        at_rest = signals[..., : self.rest]
        center = _median(at_rest).unsqueeze(-1)
        spread = _median((at_rest - center).abs())
        usual = _median(spread.flatten(1))[:, None, None]
        threshold = (self.k * _DEVIATION * torch.fmax(spread, usual)).clamp(min=self.floor)
        beyond = (signals - center).abs_() > threshold.unsqueeze(-1)
        stays = beyond
        for i in range(1, self.sustain):
            stays = stays & torch.nn.functional.pad(beyond[..., i:], (0, min(i, beyond.size(-1))))
        return stays

    def _check_found(self, contact: Tensor) -> None:
        without = (contact < 0).nonzero().view(-1)
        if len(without) == 0:
            return
        text = f"{len(without)} of {len(contact)} windows, the first is {int(without[0])}"
        if self.missing == "error":
            raise ValueError(
                f"each window must have contact (got none in {text}): give {type(self).__name__} "
                "missing='keep' to keep them whole, or a lower threshold"
            )
        _logger.warning("no contact in %s: kept whole by %r", text, self)

    def graph_step(
        self, known: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns no graph."""
        raise NotImplementedError(
            f"{self!r} cannot be exported: the length of its windows depends on the readings"
        )


def _median(values: Tensor) -> Tensor:
    # Over the last dimension, without what is missing; of two in the middle their mean.
    ordered = values.sort(dim=-1).values  # NaN comes last
    count = (~values.isnan()).sum(dim=-1, keepdim=True)
    middle = torch.cat([(count - 1).clamp(min=0) // 2, count // 2], dim=-1)
    return ordered.gather(-1, middle).mean(dim=-1)
