r"""Fitting forces to readings, with the error on recordings that were left out."""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from sklearn.linear_model import Ridge
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile.transforms import Calibrate
from torch_geometric_tactile.transforms._polynomial import (
    num_terms,
    polynomial_terms,
)

_STRENGTHS = tuple(10.0**power for power in range(-5, 4))
_MOST_TERMS = 10_000
_FEW = 3  # recordings: of fewer, one left out leaves too little
_BLOCKS = 5


class CalibrationFit(NamedTuple):
    r"""The result of :func:`fit_calibration`: a calibration, and how far it is off on recordings
    that it was not fitted on.

    Args:
        calibrate (Calibrate): The calibration, fitted on all recordings.
        strength (float): Strength of its ridge.
        rmse (torch.Tensor): Root of the mean square error on each recording, fitted on the others,
            with degree and strength chosen on the others :math:`(R, D)`.
        deviation (torch.Tensor): Standard deviation of the measured forces :math:`(R, D)`.
        beyond (torch.Tensor): Share of the forces of each recording that follow from readings
            beyond the range of the others :math:`(R,)`.
        degrees (tuple of int): The degree that was chosen on the others, of each recording.
        num_forces (int): How many forces it was fitted on.

    Examples:
        >>> x = torch.rand(60, 5, 3)
        >>> fit = fit_calibration(x, x.sum(dim=(1, 2)), torch.arange(60) // 20, degrees=(1,))
        >>> fit.calibrate
        Calibrate(3 -> 1, num_taxels=5, degree=1, per='sensor', units=('count', 'newton'))
        >>> bool(fit.rmse.max() < 0.001), fit.deviation.shape
        (True, torch.Size([3, 1]))
    """

    calibrate: Calibrate
    strength: float
    rmse: Tensor
    deviation: Tensor
    beyond: Tensor
    degrees: tuple[int, ...]
    num_forces: int


class _Rows(NamedTuple):
    r"""Readings :math:`(G, N, S, C)` of the sensor (G = 1) or of taxels (N = 1), forces
    :math:`(G, S, D)`, NaN where none is known, and the recording of each frame :math:`(S,)`."""

    x: Tensor
    force: Tensor
    recording: Tensor

    @property
    def known(self) -> Tensor:
        r"""Of which frames a force is known :math:`(G, S)`."""
        return ~self.force.isnan().any(dim=-1)

    def left_out(self, part: Tensor) -> Iterator[tuple["_Rows", "_Rows"]]:
        r"""Yields the forces of all parts but one, and of that one."""
        for number in part[self.known].unique():
            is_left = (part == number).unsqueeze(-1)
            rest, left = (self.force.masked_fill(m, torch.nan) for m in (is_left, ~is_left))
            yield self._replace(force=rest), self._replace(force=left)

    def inner_parts(self) -> Tensor:
        r"""Returns what is left out in turn to choose a setting :math:`(G, S)`: recordings, or of
        one or two blocks of their known forces."""
        known, part = self.known, self.recording.expand(len(self.force), -1)
        numbers = part[known].unique()
        if len(numbers) >= _FEW:
            return part
        part = part * _BLOCKS
        for number in numbers:
            mine = known & (self.recording == number)
            count = mine.sum(dim=1, keepdim=True).clamp(min=1)
            part = part + (mine.cumsum(dim=1) - 1) * _BLOCKS // count * mine
        return part


class _Fit(NamedTuple):
    r"""Coefficients for each strength :math:`(A, G, N, M, D)`, and the range :math:`(G, N, C)`."""

    coefficients: Tensor
    low: Tensor
    high: Tensor
    degree: int

    def squares(self, rows: _Rows) -> Tensor:
        r"""Returns the sums of the squared errors :math:`(A, D)`."""
        total = torch.zeros(())
        for taxel, known in enumerate(rows.known):
            terms = _terms(rows.x[taxel][:, known], self.low[taxel], self.high[taxel], self.degree)
            found = torch.einsum("nsm,anmd->asd", terms, self.coefficients[:, taxel])
            total = total + (found - rows.force[taxel, known]).square().sum(dim=1)
        return total

    def beyond(self, rows: _Rows) -> Tensor:
        r"""Returns the share of the known forces with a reading beyond the range."""
        low, high = self.low.unsqueeze(-2), self.high.unsqueeze(-2)
        away = ((rows.x < low) | (rows.x > high)).any(-1).any(1)
        return away[rows.known].double().mean()


def fit_calibration(
    x: Tensor,
    force: Tensor,
    recording: Tensor,
    *,
    per: Literal["taxel", "sensor"] = "sensor",
    degrees: Sequence[int] = (1, 2, 3),
    strengths: Sequence[float] = _STRENGTHS,
    units: tuple[str, str] = ("count", "newton"),
    source: str = "",
) -> CalibrationFit:
    r"""Fits a polynomial from readings to forces by ridge regression
    (:class:`~sklearn.linear_model.Ridge`), and measures its error on each recording with the
    others.

    The readings are scaled to their range before. Degree and strength are those with the least
    error on recordings left out *of the recordings that are fitted on*: a recording whose error is
    measured has no part in them. If there are one or two to fit on, contiguous fifths of each are
    left out instead.

    Neighbouring frames of a recording are nearly the same, so that splitting frames at random would
    measure how well a force is remembered.

    Args:
        x (torch.Tensor): The readings.
        force (torch.Tensor): The forces that were measured, NaN where none was.
        recording (torch.Tensor): The recording of each frame.
        per (str): :obj:`"sensor"` for a force of all readings, or :obj:`"taxel"` for forces of each
            taxel from its own channels.
        degrees (sequence of int): The degrees to choose from; those with more than ten
            thousand terms are passed over.
        strengths (sequence of float): The strengths of the ridge to choose from.
        units (tuple of str): Units of readings and forces, for :class:`Calibrate`.
        source (str): What the readings are, for :class:`Calibrate`; strength and errors follow.

    Shapes:
        - **x:** :math:`(S, N, C)`
        - **force:** of the sensor :math:`(S,)` or :math:`(S, D)`, of taxels :math:`(S, N, D)`
        - **recording:** :math:`(S,)`

    Raises:
        ValueError: If there are fewer than two recordings, the shapes do not fit, or a recording
            (of taxels, a taxel in the recordings that are fitted on) has no measured force.
    """
    rows = _checked(x, force, recording, per)
    _, num_taxels, _, num_channels = rows.x.shape
    sizes = {degree: num_taxels * num_terms(num_channels, degree) for degree in degrees}
    tried = [degree for degree, size in sizes.items() if size <= _MOST_TERMS]
    need(tried, f"'degrees' must make {_MOST_TERMS} terms at most", sizes)
    rmse, deviation, beyond, chosen = [], [], [], []
    for rest, left in rows.left_out(rows.recording.expand(len(rows.force), -1)):
        fit, _ = _chosen(rest, tried, strengths)
        rmse.append((fit.squares(left)[0] / left.known.sum()).sqrt())
        deviation.append(left.force[left.known].std(dim=0, correction=0))
        beyond.append(fit.beyond(left))
        chosen.append(fit.degree)
    fit, strength = _chosen(rows, tried, strengths)
    errors = ", ".join(" and ".join(f"{one:.4g}" for one in row.tolist()) for row in rmse)
    source += "; " if source else ""
    source += f"ridge of strength {strength:g}; RMSE of each recording left out: {errors}"
    tensors = fit.coefficients[0], fit.low, fit.high
    coefficients, low, high = (value.flatten(0, 1) for value in tensors)
    return CalibrationFit(
        Calibrate(coefficients, low, high, fit.degree, per, units, source),
        strength,
        torch.stack(rmse),
        torch.stack(deviation),
        torch.stack(beyond),
        tuple(chosen),
        int(rows.known.sum()),
    )


def _checked(x: Tensor, force: Tensor, recording: Tensor, per: str) -> _Rows:
    x, force = torch.as_tensor(x).double(), torch.as_tensor(force).double()
    recording = torch.as_tensor(recording)
    need_argument(
        not force.isinf().any(), "force", "must be finite, or NaN where none was measured (got inf)"
    )
    need_argument(per in ("taxel", "sensor"), "per", f"must be 'taxel' or 'sensor' (got {per!r})")
    need(x.dim() == 3, "'x' must have shape (num_frames, num_taxels, num_channels)", x.shape)
    if per == "sensor" and force.dim() == 1:
        force = force.unsqueeze(-1)
    size = (len(x),) if per == "sensor" else (len(x), x.size(1))
    if force.shape[:-1] != size or not force.size(-1):
        raise ArgumentError(
            Argument("force"),
            f" must have shape {(*size, 'num_forces')}, per {per} (got {tuple(force.shape)})",
        )
    need(recording.shape == (len(x),), "'recording' must have a number a frame", recording.shape)
    if per == "sensor":
        x, force = x.transpose(0, 1).unsqueeze(0), force.unsqueeze(0)
    else:
        x, force = x.transpose(0, 1).unsqueeze(1), force.transpose(0, 1)
    unknown = x.isnan().any(-1).any(1) | force.isnan().any(-1)
    force = force.masked_fill(unknown.unsqueeze(-1), torch.nan)
    numbers = recording.unique()
    if len(numbers) < 2:
        raise ValueError(
            "'recording' must be of two recordings or more, since the error is measured on one "
            f"that is left out (got {len(numbers)})"
        )
    for number in numbers.tolist():
        if force[:, recording == number].isnan().all():
            raise ArgumentError(
                Argument("force"), f" must be measured in each recording (got none in {number})"
            )
    order = recording.argsort(stable=True)
    order = order[~unknown.all(0)[order]]
    return _Rows(x[:, :, order], force[:, order], recording[order])


def _chosen(rows: _Rows, degrees: Sequence[int], strengths: Sequence[float]) -> tuple[_Fit, float]:
    # The fit of the degree and strength with the least error on what is left out of these rows.
    if len(degrees) == len(strengths) == 1:
        return _fitted(rows, degrees[0], strengths), strengths[0]
    errors, parts = [], rows.inner_parts()
    for degree in degrees:
        cut = rows.left_out(parts)
        squares = [_fitted(rest, degree, strengths).squares(left).sum(1) for rest, left in cut]
        errors.append(torch.stack(squares).sum(0))
    best = int(torch.stack(errors).argmin())
    degree, strength = degrees[best // len(strengths)], strengths[best % len(strengths)]
    return _fitted(rows, degree, [strength]), strength


def _fitted(rows: _Rows, degree: int, strengths: Sequence[float]) -> _Fit:
    coefficients, low, high = [], [], []
    for taxel, (x, force) in enumerate(zip(rows.x, rows.force, strict=True)):
        known = ~force.isnan().any(-1)
        need_argument(
            known.any(),
            "force",
            f"must be measured in two recordings or more, and more than once, on each "
            f"taxel (got fewer on taxel {taxel})",
        )
        x, force = x[:, known], force[known]
        low.append(x.amin(1))
        high.append(x.amax(1))
        terms = _terms(x, low[-1], high[-1], degree)
        coefficients.append(_ridge(terms.numpy(), force.numpy(), strengths))
    return _Fit(torch.stack(coefficients, dim=1), torch.stack(low), torch.stack(high), degree)


def _terms(x: Tensor, low: Tensor, high: Tensor, degree: int) -> Tensor:
    return polynomial_terms(x, low.unsqueeze(1), high.unsqueeze(1), degree)


def _ridge(terms: np.ndarray, force: np.ndarray, strengths: Sequence[float]) -> Tensor:
    # All strengths of one decomposition (A, N, M, D). The first term of a taxel is one: of all
    # together the intercept.
    num_taxels, num_frames, count = terms.shape
    inputs = terms[..., 1:].transpose(1, 0, 2).reshape(num_frames, -1)
    ridge = Ridge(np.repeat(strengths, force.shape[1]), solver="svd")
    ridge.fit(inputs, np.tile(force, (1, len(strengths))))
    slope = np.reshape(ridge.coef_, (-1, num_taxels, count - 1))
    start = np.broadcast_to(np.reshape(ridge.intercept_, (-1, 1, 1)), (*slope.shape[:2], 1))
    found = np.concatenate([start / num_taxels, slope], axis=2)
    return torch.from_numpy(found).unflatten(0, (len(strengths), -1)).permute(0, 2, 3, 1)
