r"""Calibration of readings to forces, with errors on held-out recordings."""

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
_MAX_TERMS = 10_000  # terms of the polynomial, to limit time and memory
# With fewer recordings, blocks of recordings are held out for the selection, since the error of a
# fit on a single recording would be unreliable.
_MIN_RECORDINGS_TO_HOLD_OUT = 3
_NUM_BLOCKS = 5


class CalibrationFit(NamedTuple):
    r"""The result of :func:`fit_calibration`: a calibration and its errors on held-out recordings.

    Args:
        calibrate (Calibrate): The calibration, fitted on all recordings.
        strength (float): Regularisation strength of the ridge regression.
        rmse (torch.Tensor): Root mean square error on each recording :math:`(R, D)`. For each
            recording, the calibration was fitted on the other recordings, which were also used to
            select degree and strength.
        deviation (torch.Tensor): Standard deviation of the measured forces in each recording
            :math:`(R, D)`.
        beyond (torch.Tensor): Fraction of the forces in each recording whose readings are outside
            the range of the other recordings :math:`(R,)`.
        degrees (tuple of int): For each recording, the degree that was selected on the other
            recordings.
        num_forces (int): Number of forces on which the calibration was fitted.

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


class _Frames(NamedTuple):
    r"""Frames with their readings, forces and recordings.

    Either all taxels form one group (:math:`G = 1`), or each taxel is a group (:math:`N = 1`).

    Shapes:
        - **x:** readings :math:`(G, N, S, C)`
        - **force:** measured forces, NaN if unknown :math:`(G, S, D)`
        - **recording:** recording of each frame :math:`(S,)`
    """

    x: Tensor
    force: Tensor
    recording: Tensor

    @property
    def is_measured(self) -> Tensor:
        r"""Whether the force of a frame is known :math:`(G, S)`."""
        return ~self.force.isnan().any(dim=-1)

    def hold_out(self, part: Tensor) -> Iterator[tuple["_Frames", "_Frames"]]:
        r"""Yields two sets of frames for each part: one with the forces of all other parts, and one
        with the forces of this part.
        """
        for index in part[self.is_measured].unique():
            is_held_out = (part == index).unsqueeze(-1)
            train, test = (
                self.force.masked_fill(mask, torch.nan) for mask in (is_held_out, ~is_held_out)
            )
            yield self._replace(force=train), self._replace(force=test)

    def selection_parts(self) -> Tensor:
        r"""Returns the parts that are held out in turn to select degree and strength
        :math:`(G, S)`. These are the recordings or, if there are only one or two recordings, five
        blocks of each.
        """
        is_measured, part = self.is_measured, self.recording.expand(len(self.force), -1)
        recordings = part[is_measured].unique()
        if len(recordings) >= _MIN_RECORDINGS_TO_HOLD_OUT:
            return part
        part = part * _NUM_BLOCKS
        for recording in recordings:
            mask = is_measured & (self.recording == recording)
            count = mask.sum(dim=1, keepdim=True).clamp(min=1)
            part = part + (mask.cumsum(dim=1) - 1) * _NUM_BLOCKS // count * mask
        return part


class _Fit(NamedTuple):
    r"""The coefficients for each strength :math:`(A, G, N, M, D)`, and the range of the readings
    :math:`(G, N, C)`.
    """

    coefficients: Tensor
    low: Tensor
    high: Tensor
    degree: int

    def squared_errors(self, frames: _Frames) -> Tensor:
        r"""Returns the sums of the squared errors over the measured forces :math:`(A, D)`."""
        total = torch.zeros(())
        for group, mask in enumerate(frames.is_measured):
            terms = _terms(frames.x[group][:, mask], self.low[group], self.high[group], self.degree)
            force = torch.einsum("nsm,anmd->asd", terms, self.coefficients[:, group])
            total = total + (force - frames.force[group, mask]).square().sum(dim=1)
        return total

    def fraction_outside(self, frames: _Frames) -> Tensor:
        r"""Returns the fraction of the measured forces with a reading outside the range."""
        low, high = self.low.unsqueeze(-2), self.high.unsqueeze(-2)
        is_outside = ((frames.x < low) | (frames.x > high)).any(-1).any(1)
        return is_outside[frames.is_measured].double().mean()


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
    r"""Fits a polynomial that maps readings to forces by ridge regression
    (:class:`~sklearn.linear_model.Ridge`). Also measures the error on each recording after a fit on
    the other recordings.

    The readings are first scaled to their range. Degree and strength are selected by the smallest
    error on recordings that are held out *from the recordings used for fitting*. The recording
    whose error is measured never influences the selection. If only one or two recordings are left
    for fitting, contiguous fifths of each recording are held out instead.

    Consecutive frames of a recording are nearly equal. A random split of frames would therefore
    measure how well the fit memorises forces.

    Args:
        x (torch.Tensor): The readings.
        force (torch.Tensor): The measured forces, NaN if unknown.
        recording (torch.Tensor): Recording of each frame.
        per (str): :obj:`"sensor"` to compute a force from the readings of all taxels, or
            :obj:`"taxel"` to compute a force for each taxel from its channels.
        degrees (sequence of int): Candidate degrees. Degrees with more than ten thousand terms are
            skipped.
        strengths (sequence of float): Candidate regularisation strengths of the ridge regression.
        units (tuple of str): Units of readings and forces, for :class:`Calibrate`.
        source (str): Description of the recordings, for :class:`Calibrate`. The strength and the
            errors are appended.

    Shapes:
        - **x:** :math:`(S, N, C)`
        - **force:** forces on the sensor :math:`(S,)` or :math:`(S, D)`, or on each taxel
          :math:`(S, N, D)`
        - **recording:** :math:`(S,)`

    Raises:
        ValueError: If there are fewer than two recordings, the shapes do not match, a recording has
            no measured force, or a taxel has no measured force in the recordings used for fitting.
    """
    frames = _checked_frames(x, force, recording, per)
    _, num_taxels, _, num_channels = frames.x.shape
    sizes = {degree: num_taxels * num_terms(num_channels, degree) for degree in degrees}
    candidates = [degree for degree, size in sizes.items() if size <= _MAX_TERMS]
    need(candidates, f"'degrees' must yield at most {_MAX_TERMS} terms", sizes)
    rmse, deviation, beyond, selected_degrees = [], [], [], []
    for train, test in frames.hold_out(frames.recording.expand(len(frames.force), -1)):
        fit, _ = _select_fit(train, candidates, strengths)
        rmse.append((fit.squared_errors(test)[0] / test.is_measured.sum()).sqrt())
        deviation.append(test.force[test.is_measured].std(dim=0, correction=0))
        beyond.append(fit.fraction_outside(test))
        selected_degrees.append(fit.degree)
    fit, strength = _select_fit(frames, candidates, strengths)
    errors = ", ".join(" and ".join(f"{error:.4g}" for error in row.tolist()) for row in rmse)
    source += "; " if source else ""
    source += f"ridge of strength {strength:g}; RMSE of each recording left out: {errors}"
    tensors = fit.coefficients[0], fit.low, fit.high
    coefficients, low, high = (tensor.flatten(0, 1) for tensor in tensors)
    return CalibrationFit(
        Calibrate(coefficients, low, high, fit.degree, per, units, source),
        strength,
        torch.stack(rmse),
        torch.stack(deviation),
        torch.stack(beyond),
        tuple(selected_degrees),
        int(frames.is_measured.sum()),
    )


def _checked_frames(x: Tensor, force: Tensor, recording: Tensor, per: str) -> _Frames:
    # Returns the frames with a known force, sorted by recording.
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
    need(recording.shape == (len(x),), "'recording' must have a number per frame", recording.shape)
    if per == "sensor":
        x, force = x.transpose(0, 1).unsqueeze(0), force.unsqueeze(0)
    else:
        x, force = x.transpose(0, 1).unsqueeze(1), force.transpose(0, 1)
    unknown = x.isnan().any(-1).any(1) | force.isnan().any(-1)
    force = force.masked_fill(unknown.unsqueeze(-1), torch.nan)
    recordings = recording.unique()
    if len(recordings) < 2:
        raise ValueError(
            "'recording' must name at least two recordings, since the error is measured on a "
            f"held-out recording (got {len(recordings)})"
        )
    for index in recordings.tolist():
        if force[:, recording == index].isnan().all():
            raise ArgumentError(
                Argument("force"), f" must be measured in each recording (got none in {index})"
            )
    order = recording.argsort(stable=True)
    order = order[~unknown.all(0)[order]]
    return _Frames(x[:, :, order], force[:, order], recording[order])


def _select_fit(
    frames: _Frames, degrees: Sequence[int], strengths: Sequence[float]
) -> tuple[_Fit, float]:
    # Returns the fit on all frames with the degree and strength that have the smallest error on
    # held-out parts.
    if len(degrees) == len(strengths) == 1:
        return _fit(frames, degrees[0], strengths), strengths[0]
    errors, parts = [], frames.selection_parts()
    for degree in degrees:
        splits = frames.hold_out(parts)
        squares = [
            _fit(train, degree, strengths).squared_errors(test).sum(1) for train, test in splits
        ]
        errors.append(torch.stack(squares).sum(0))
    best = int(torch.stack(errors).argmin())
    degree, strength = degrees[best // len(strengths)], strengths[best % len(strengths)]
    return _fit(frames, degree, [strength]), strength


def _fit(frames: _Frames, degree: int, strengths: Sequence[float]) -> _Fit:
    coefficients, low, high = [], [], []
    for taxel, (x, force) in enumerate(zip(frames.x, frames.force, strict=True)):
        is_measured = ~force.isnan().any(-1)
        need_argument(
            is_measured.any(),
            "force",
            f"must be measured in at least two recordings, and more than once, on each "
            f"taxel (got fewer on taxel {taxel})",
        )
        x, force = x[:, is_measured], force[is_measured]
        low.append(x.amin(1))
        high.append(x.amax(1))
        terms = _terms(x, low[-1], high[-1], degree)
        coefficients.append(_ridge(terms.numpy(), force.numpy(), strengths))
    return _Fit(torch.stack(coefficients, dim=1), torch.stack(low), torch.stack(high), degree)


def _terms(x: Tensor, low: Tensor, high: Tensor, degree: int) -> Tensor:
    return polynomial_terms(x, low.unsqueeze(1), high.unsqueeze(1), degree)


def _ridge(terms: np.ndarray, force: np.ndarray, strengths: Sequence[float]) -> Tensor:
    # Returns the coefficients (A, N, M, D). The targets are repeated for each strength, so that all
    # strengths share one singular value decomposition. The first term of each taxel is constant and
    # gets an equal share of the intercept.
    num_taxels, num_frames, terms_per_taxel = terms.shape
    inputs = terms[..., 1:].transpose(1, 0, 2).reshape(num_frames, -1)
    ridge = Ridge(np.repeat(strengths, force.shape[1]), solver="svd")
    ridge.fit(inputs, np.tile(force, (1, len(strengths))))
    slope = np.reshape(ridge.coef_, (-1, num_taxels, terms_per_taxel - 1))
    intercept = np.broadcast_to(np.reshape(ridge.intercept_, (-1, 1, 1)), (*slope.shape[:2], 1))
    coefficients = np.concatenate([intercept / num_taxels, slope], axis=2)
    return torch.from_numpy(coefficients).unflatten(0, (len(strengths), -1)).permute(0, 2, 3, 1)
