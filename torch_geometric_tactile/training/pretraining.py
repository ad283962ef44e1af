r"""Training an encoder of touch without labels."""

import hashlib
import json
import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import GELU, Linear, Module, Sequential
from torch.nn.functional import cross_entropy, normalize, smooth_l1_loss
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn.models import TaxelEncoder
from torch_geometric_tactile.nn.models._taxel_kernels import (
    PLACE,
    KernelConv,
    Neighbourhood,
    coarse_layout,
)
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._pretrain_state import PretrainState
from torch_geometric_tactile.transforms import (
    DropTaxels,
    RandomGain,
    RandomNoise,
    RandomOffset,
)

_PROJECTION = 64
_TIMED = 10  # steps, after the first, from which the number of steps is reckoned
_SECONDS_BETWEEN_FILES = 15.0
_WARM_UP = 0.05  # part of the steps in which the rate grows
_FRAMES_MEASURED = 2000
_LEAST_FELT = 0.01
_TILT = 0.3
# Below which there is little to learn from, and a warning says so.
_FEW_TRIALS, _FEW_FRAMES = 10, 500
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PretrainSettings:
    r"""How an encoder is pretrained.

    Args:
        minutes (float): How long it may take: the first steps are timed, and so many are made as
            fit in.
        steps (int, optional): Number of steps, in place of the time: with the same seed and number,
            data and machine, the encoder is the same.
        seed (int): Of weights and draws.
        batch_size (int): Pairs of frames in a step.
        lr (float): Largest learning rate.
        temperature (float): Of the contrasts.
        drop (float): Part of the taxels that a thinned view lacks.
        embedding_channels (int): Number of features.

    Raises:
        ValueError: If a number is out of its range.
    """

    minutes: float = 3.0
    steps: int | None = None
    seed: int = 0
    batch_size: int = 48
    lr: float = 2e-3
    temperature: float = 0.1
    drop: float = 0.3
    embedding_channels: int = 128

    def __post_init__(self) -> None:
        for name in ("minutes", "lr", "temperature"):
            value = getattr(self, name)
            need(0 < value < math.inf, f"'{name}' must be positive", value)
        for name, least in (("batch_size", 2), ("embedding_channels", 1)):
            need(getattr(self, name) >= least, f"'{name}' must be at least {least}")
        need(self.steps is None or self.steps >= 1, "'steps' must be at least 1", self.steps)
        need(0 < self.drop < 1, "'drop' must be above 0 and below 1", self.drop)


class PretrainStep(NamedTuple):
    r"""How far a pretraining is: steps made and planned, and the losses of the last one."""

    step: int
    steps: int | None
    seconds: float
    trial_loss: float
    view_loss: float
    mask_loss: float


def pretrain(
    x: Tensor | np.ndarray,
    trial: Tensor | np.ndarray,
    layout: TaxelLayout,
    settings: PretrainSettings | None = None,
    *,
    checkpoint: PathLike | None = None,
    trained_on: Mapping[str, Any] | None = None,
    on_step: Callable[[PretrainStep], None] | None = None,
) -> PretrainedEncoder:
    r"""Trains a :class:`~torch_geometric_tactile.nn.models.TaxelEncoder` on recordings without
    labels.

    A step takes pairs of frames, each of one trial, and adds up three losses: the contrast of the
    two frames of a trial (InfoNCE, Oord et al. 2018), the contrast of two views of a frame (other
    taxels missing, other gain, offset and noise), and the error with which the missing taxels of
    the views are predicted. Negatives are always frames of other trials.

    Args:
        x (torch.Tensor or numpy.ndarray): Raw readings of frames :math:`(S, N, C)`; missing ones
            are NaN.
        trial (torch.Tensor or numpy.ndarray): The trial of each frame, a whole number :math:`(S,)`.
        layout (TaxelLayout): The taxels.
        settings (PretrainSettings, optional): How it is trained.
        checkpoint (str or PathLike, optional): A file that is written every 15 seconds: the same
            call goes on with it. It is removed at the end.
        trained_on (Mapping, optional): More to be kept with the encoder: numbers and texts by name.
        on_step (callable, optional): Called with a :class:`PretrainStep` after each step.

    Raises:
        ValueError: If there is one trial only, so that there is nothing to contrast, the numbers of
            frames or taxels differ, or :obj:`checkpoint` is of another pretraining.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x, trial = torch.rand(40, 16, 1), torch.arange(40) // 10
        >>> encoder = pretrain(x, trial, grid(4, 4, 0.004), PretrainSettings(steps=2))
        >>> encoder.embed(x).shape
        torch.Size([40, 128])
    """
    settings = settings or PretrainSettings()
    x, trial = _checked(torch.as_tensor(x), torch.as_tensor(trial), layout)
    training = _Pretraining(x, trial, layout, settings)
    state = PretrainState(checkpoint, _identity(x, trial, layout, settings))
    step, steps, before = state.restored(training.modules, training.optimizer, training.draw)
    steps = settings.steps or steps
    start, last, timed = time.perf_counter(), time.perf_counter(), math.nan
    while steps is None or step < steps:
        losses = training.step(step, steps)
        step += 1
        now = time.perf_counter()
        if step == 1:
            timed = now
        if steps is None and (step == 1 + _TIMED or now - start > 60 * settings.minutes):
            one = (now - timed) / (step - 1) if step > 1 else now - start
            steps = max(step, round((60 * settings.minutes - (now - start)) / one) + step)
        if on_step is not None:
            on_step(PretrainStep(step, steps, before + now - start, *losses))
        if steps is not None and step < steps and now - last > _SECONDS_BETWEEN_FILES:
            state.write(
                training.modules,
                training.optimizer,
                training.draw,
                step,
                steps,
                before + now - start,
            )
            last = now
    told = {
        "num_trials": len(trial.unique()),
        "num_frames": len(x),
        "steps": step,
        "seconds": round(before + time.perf_counter() - start),
        "seed": settings.seed,
        **(trained_on or {}),
    }
    state.remove()
    return PretrainedEncoder(training.model, layout, told)


def _checked(x: Tensor, trial: Tensor, layout: TaxelLayout) -> tuple[Tensor, Tensor]:
    if x.dim() != 3 or x.size(1) != layout.num_taxels:
        raise ValueError(
            f"'x' must have shape (num_frames, {layout.num_taxels}, num_channels), as layout "
            f"'{layout.name}' (got {tuple(x.shape)})"
        )
    if trial.shape != x.shape[:1]:
        raise ValueError(
            f"'trial' must have one number for each of {len(x)} frames (got {tuple(trial.shape)})"
        )
    trial = trial.unique(return_inverse=True)[1]
    count = int(trial.max()) + 1 if len(trial) else 0
    if count < 2:
        raise ValueError(
            "there must be at least 2 trials: with one there is nothing to contrast (got "
            f"{count} trial{'s' if count != 1 else ''} of {len(x)} frames)"
        )
    need(not x.isinf().any(), "'x' must hold finite readings, or NaN for missing ones")
    if count < _FEW_TRIALS or len(x) < _FEW_FRAMES:
        _logger.warning(
            "%d trials and %d frames are few to learn from: %d trials and %d frames or more are "
            "asked for",
            *(count, len(x), _FEW_TRIALS, _FEW_FRAMES),
        )
    return x.float(), trial


def _identity(x: Tensor, trial: Tensor, layout: TaxelLayout, settings: PretrainSettings) -> str:
    code = hashlib.sha256()
    for part in (x, trial, layout.pos):
        code.update(part.contiguous().numpy().tobytes())
    code.update(json.dumps([asdict(settings), torch.__version__]).encode())
    return code.hexdigest()


class _Heads(Module):
    # What is needed in training only: a projection for the contrasts, and a prediction of readings.
    def __init__(self, model: TaxelEncoder, layout: TaxelLayout) -> None:
        super().__init__()
        size, width = model.embedding_channels, model.hidden_channels
        self.project = Sequential(Linear(size, size), GELU(), Linear(size, _PROJECTION))
        coarse = coarse_layout(layout, model.max_taxels)
        zoom = math.sqrt(layout.num_taxels / coarse.num_taxels)
        self.near = Neighbourhood(layout, coarse, zoom)
        self.up = KernelConv(width)
        self.predict = Sequential(
            Linear(width + PLACE, width), GELU(), Linear(width, model.in_channels)
        )

    def readings(self, last: Tensor, place: Tensor) -> Tensor:
        h = self.up(last, self.near)
        out: Tensor = self.predict(torch.cat([h, place.expand(len(h), -1, -1)], dim=-1))
        return out


class _Pretraining:
    def __init__(
        self, x: Tensor, trial: Tensor, layout: TaxelLayout, settings: PretrainSettings
    ) -> None:
        self.settings = settings
        self.draw = torch.Generator().manual_seed(settings.seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            self.model = TaxelEncoder(
                layout, 1, in_channels=x.size(2), embedding_channels=settings.embedding_channels
            )
            self.heads = _Heads(self.model, layout)
        self.modules = {"model": self.model, "heads": self.heads}
        some = x[:: max(1, len(x) // _FRAMES_MEASURED)]
        self.model.fit_scale(some).train()
        self.x, self.trial = x, trial
        self.order = trial.argsort(stable=True)
        self.count = trial.bincount()
        self.begin = self.count.cumsum(0) - self.count
        # Frames in which much is felt are drawn more often: those at rest look alike in all trials.
        self.sum = self._felt()[self.order].double().cumsum(0)
        self.weights = [w for module in self.modules.values() for w in module.parameters()]
        self.weights = [w for w in self.weights if not self._is_of_labels(w)]
        self.optimizer = torch.optim.AdamW(self.weights, lr=settings.lr, weight_decay=0.01)
        self.change = Compose(
            [
                RandomGain(0.2, generator=self.draw),
                RandomOffset(0.1, generator=self.draw),
                RandomNoise(0.1, generator=self.draw),
            ]
        )
        self.thin = DropTaxels(p=settings.drop, value=math.nan, generator=self.draw)

    def _is_of_labels(self, weight: Tensor) -> bool:
        return any(weight is own for own in self.model.lin_out.parameters())

    def step(self, step: int, steps: int | None) -> tuple[float, float, float]:
        r"""Makes a step and returns its three losses."""
        first, second, trial = self._pairs()
        frames = self.model.scaled(self.x[torch.cat([first, second, first])])
        whole = self._tilted(self.change(StaticData(x=frames)).x)
        views = self.thin(StaticData(x=whole)).x
        low, last = self.model.nodes(views)
        z = normalize(self.heads.project(self.model.pooled(low, last)), dim=1)
        a, b, c = z.chunk(3)
        losses = [
            _contrast(a, b, trial, self.settings.temperature),
            _contrast(a, c, trial, self.settings.temperature),
            self._masked(last, views, whole),
        ]
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.lr * _rate(step, steps)
        self.optimizer.zero_grad()
        torch.stack(losses).sum().backward()
        torch.nn.utils.clip_grad_norm_(self.weights, 1.0)
        self.optimizer.step()
        of_trial, of_view, of_mask = (float(loss.detach()) for loss in losses)
        return of_trial, of_view, of_mask

    def _tilted(self, x: Tensor) -> Tensor:
        # As if the sensor was pressed aslant: the gain changes from side to side.
        slope = _TILT * torch.randn(len(x), 3, 1, generator=self.draw)
        return x * (self.model.place[:, :3] @ slope).exp()

    def _felt(self) -> Tensor:
        # How much is felt in each frame, from one hundredth to one.
        parts = [self.model.scaled(p).square().nanmean(dim=(1, 2)) for p in self.x.split(4096)]
        felt = torch.cat(parts).sqrt().nan_to_num()
        much = felt[:: max(1, len(felt) // 100_000)].quantile(0.9).clamp(min=1e-9)
        return (felt / much).clamp(_LEAST_FELT, 1.0)

    def _pairs(self) -> tuple[Tensor, Tensor, Tensor]:
        # As many pairs from each trial as there is place for, of two frames where it has two.
        size, count = self.settings.batch_size, len(self.count)
        rounds = [torch.randperm(count, generator=self.draw) for _ in range(-(-size // count))]
        trial = torch.cat(rounds)[:size]
        start, end = self.begin[trial], self.begin[trial] + self.count[trial]
        before = torch.where(start > 0, self.sum[start - 1], 0.0)
        one, two = (self._drawn(start, end, before) for _ in range(2))
        two = torch.where(one == two, torch.where(two + 1 < end, two + 1, start), two)
        return self.order[one], self.order[two], trial

    def _drawn(self, start: Tensor, end: Tensor, before: Tensor) -> Tensor:
        part = torch.rand(len(start), generator=self.draw, dtype=torch.double)
        found = torch.searchsorted(self.sum, before + part * (self.sum[end - 1] - before))
        return found.clamp(min=start, max=end - 1)

    def _masked(self, last: Tensor, views: Tensor, whole: Tensor) -> Tensor:
        hidden = views.isnan() & ~whole.isnan()
        said = self.heads.readings(last, self.model.place)
        if not hidden.any():
            return said.sum() * 0.0
        return smooth_l1_loss(said[hidden], whole[hidden].asinh())


def _contrast(one: Tensor, other: Tensor, trial: Tensor, temperature: float) -> Tensor:
    # InfoNCE, both ways; rows of the same trial are neither positives nor negatives.
    same = (trial.unsqueeze(1) == trial).fill_diagonal_(False)
    logits = (one @ other.t() / temperature).masked_fill(same, -math.inf)
    own = torch.arange(len(one))
    return (cross_entropy(logits, own) + cross_entropy(logits.t(), own)) / 2


def _rate(step: int, steps: int | None) -> float:
    # Grows at first, while the number of steps is reckoned, and falls to zero as a cosine.
    if steps is None:
        return min(1.0, (step + 1) / (2 * _TIMED))
    grown = min(1.0, (step + 1) / max(2 * _TIMED, _WARM_UP * steps))
    return grown * 0.5 * (1 + math.cos(math.pi * step / steps))
