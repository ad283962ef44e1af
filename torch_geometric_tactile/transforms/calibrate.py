r"""Conversion of readings to forces."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Self

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, existing_file
from torch_geometric_tactile._texts import read_json, short_repr
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.sensors._content_checks import (
    is_number,
    is_one_of,
    need_key,
    need_only_keys,
    need_text,
)
from torch_geometric_tactile.transforms._attributes import FRAMES, check_num_taxels, require_floats
from torch_geometric_tactile.transforms._polynomial import (
    num_terms,
    polynomial,
    scaled_readings,
)
from torch_geometric_tactile.transforms._windows import get_num_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_PER = ("taxel", "sensor")
_MAX_DEGREE = 3
_UNNAMED_UNIT = "unit of the file"  # for files that do not name their unit
_UNITS = (*UNITS, _UNNAMED_UNIT)
_TENSORS = ("coefficients", "low", "high")
_KEYS = ("per", "degree", "reading_unit", "force_unit", "source", *_TENSORS)


@functional_transform("calibrate")
class Calibrate(TactileTransform):
    r"""Converts readings to forces with a polynomial (functional name: :obj:`calibrate`). Fit the
    polynomial with ``tactile calibrate`` or
    :func:`~torch_geometric_tactile.analysis.fit_calibration`.

    .. math::
        \mathbf{f}_i = \sum_m \mathbf{w}_{im} \prod_{c \in J_m} z_{ic}
        \qquad
        z_{ic} = \frac{2 x_{ic} - \mathrm{high}_{ic} - \mathrm{low}_{ic}}
        {\mathrm{high}_{ic} - \mathrm{low}_{ic}}

    where :math:`J_m` are all combinations of up to :obj:`degree` channels of taxel :math:`i`,
    including the empty one (the constant). For three channels and degree two, the products are
    :math:`1, z_1, z_2, z_3, z_1^2, z_1 z_2, z_1 z_3, z_2^2, z_2 z_3, z_3^2`. With degree one, the
    polynomial consists of an offset and a cross-axis matrix; the matrix is diagonal if each channel
    only has a gain. The force on the sensor is :math:`\sum_i \mathbf{f}_i`.

    The polynomial was fitted on readings between :obj:`low` and :obj:`high`. Beyond this range, the
    force is extrapolated linearly along the slope at the end of the range. It may be wrong, and no
    warning is issued; :meth:`beyond` returns the taxels with readings beyond the range.

    If offsets differ between sessions, fit and apply the calibration after
    :class:`~torch_geometric_tactile.transforms.Tare`.

    Args:
        coefficients (torch.Tensor or list): The coefficients :math:`\mathbf{w}`: shape
            :math:`(M, D)` if all taxels share them, or :math:`(N, M, D)` with coefficients for each
            taxel.
        low (torch.Tensor or list, optional): The lowest reading of each channel :math:`(C,)`, or of
            each taxel and channel :math:`(N, C)` if each taxel has coefficients. If left out,
            :math:`z` are the readings themselves, and the range is unknown.
        high (torch.Tensor or list, optional): The highest reading, with the shape of :obj:`low`.
        degree (int): The largest number of readings that are multiplied, 1 to 3.
        per (str): :obj:`"taxel"` for the forces on each taxel, or :obj:`"sensor"` for their sum.
        units (tuple of str): Units of readings and forces: :obj:`"count"`, :obj:`"microtesla"`,
            :obj:`"newton"`, or :obj:`"unit of the file"` if the data do not name their unit.
        source (str): A description of the recordings and the method of the fit.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`. For windows, :math:`F = C \cdot T`, and frames are converted one by one.
        - **output:** with :obj:`per="taxel"`, :obj:`x` :math:`(\ldots, N, D)`. With
          :obj:`per="sensor"`, :obj:`force` :math:`(1, D)` or :math:`(B, D)` in addition to the
          readings. For windows, :math:`D \cdot T` in place of :math:`D`. Forces that depend on a
          missing reading (NaN) are missing.

    Raises:
        ValueError: If :obj:`degree`, :obj:`per` or a unit is unknown, the shapes do not match, a
            coefficient is not finite, or the readings have the wrong number of taxels or channels.

    Examples:
        >>> mixed = torch.tensor([[0.0, 0.0], [0.02, 0.0], [0.001, 0.01]])  # offset, x, y
        >>> Calibrate(mixed)(Data(x=torch.tensor([[100.0, 200.0]]))).x
        tensor([[2.2000, 2.0000]])
        >>> square = Calibrate([[1.0], [2.0], [1.0]], low=[0.0], high=[2.0], degree=2)  # x squared
        >>> square(Data(x=torch.tensor([[1.5], [3.0]]))).x.view(-1)  # and its tangent beyond 2
        tensor([2.2500, 8.0000])
        >>> square.beyond(Data(x=torch.tensor([[1.5], [3.0]])))
        tensor([[False,  True]])
    """

    reads = ("x", *FRAMES)

    @property
    def writes(self) -> tuple[str, ...]:
        r"""The attribute that holds the forces."""
        return ("x",) if self.per == "taxel" else ("force",)

    @property
    def per_frame(self) -> bool:
        r"""Whether the forces replace the readings."""
        return self.per == "taxel"

    def __init__(
        self,
        coefficients: Tensor | Sequence[Any],
        low: Tensor | Sequence[Any] | None = None,
        high: Tensor | Sequence[Any] | None = None,
        degree: int = 1,
        per: Literal["taxel", "sensor"] = "taxel",
        units: tuple[str, str] = ("count", "newton"),
        source: str = "",
    ) -> None:
        is_integer = isinstance(degree, int) and not isinstance(degree, bool)
        need(is_integer and 1 <= degree <= _MAX_DEGREE, "'degree' must be 1, 2 or 3", degree)
        need(is_one_of(per, _PER), f"'per' must be one of {list(_PER)} (got {short_repr(per)})")
        is_pair = isinstance(units, tuple | list) and len(units) == 2
        if not is_pair or not all(is_one_of(unit, _UNITS) for unit in units):
            raise ValueError(
                f"'units' must be the units of readings and forces, two of {list(_UNITS)} (got "
                f"{short_repr(units)})"
            )
        need_text(source, "'source'")
        self.coefficients = _finite_tensor("coefficients", coefficients)
        self.low = None if low is None else _finite_tensor("low", low)
        self.high = None if high is None else _finite_tensor("high", high)
        self.degree, self.per, self.source = degree, per, source
        self.units: tuple[str, str] = (units[0], units[1])
        self.num_channels = self._checked_channels()

    def _checked_channels(self) -> int:
        # Returns the number of channels, which follows from the number of terms.
        shape = self.coefficients.shape
        if len(shape) not in (2, 3) or 0 in shape:
            raise ValueError(
                "'coefficients' must have shape (num_terms, num_forces), or (num_taxels, "
                f"num_terms, num_forces) for each taxel (got {tuple(shape)})"
            )
        # The number of terms increases with the number of channels.
        counts = (n for n in range(1, shape[-2]) if num_terms(n, self.degree) >= shape[-2])
        channels = next(counts, 0)
        if num_terms(channels, self.degree) != shape[-2] or not channels:
            raise ValueError(
                f"'coefficients' must have a row for the constant and for each product of up to "
                f"{self.degree} channels, such as {num_terms(3, self.degree)} for three channels "
                f"(got {shape[-2]})"
            )
        if (self.low is None) != (self.high is None):
            raise ValueError("'low' and 'high' must be given together (got one)")
        if self.low is not None and self.high is not None:
            size = (*shape[:-2], channels)
            for name, value in (("low", self.low), ("high", self.high)):
                if value.shape != size:
                    raise ValueError(
                        f"'{name}' must have shape {size} to match the coefficients (got "
                        f"{tuple(value.shape)})"
                    )
            need((self.low <= self.high).all(), "'low' must not be above 'high' (got a higher one)")
        return channels

    def forward(self, data: Data) -> Data:
        r"""Sets the forces."""
        force = polynomial(self._frames(data), self.coefficients, self.low, self.high, self.degree)
        windows = join_frames(force)
        if self.per == "sensor":
            data.force = windows.sum(dim=-2)
        else:
            data.x = windows.reshape(*data.x.shape[:-1], windows.size(-1))
        return data

    def beyond(self, data: Data) -> Tensor:
        r"""Returns which taxels have a reading beyond the range (in any frame of a window).

        Args:
            data (torch_geometric.data.Data): The samples, before the transform.

        Shapes:
            - **output:** booleans :math:`(B, N)`, with :math:`B = 1` for a single sample
        """
        frames = self._frames(data)
        if self.low is None or self.high is None:
            return torch.zeros(frames.shape[:-2], dtype=torch.bool)
        distance = scaled_readings(frames, self.low.unsqueeze(-2), self.high.unsqueeze(-2))[1]
        return (distance != 0).flatten(-2).any(dim=-1)

    def _frames(self, data: Data) -> Tensor:
        # The frames of the samples (B, N, T, C).
        x = require_floats(self, data)
        frames = split_frames(x, get_num_frames(data) or 1)
        if frames.size(-1) != self.num_channels:
            raise ValueError(
                f"'x' must have {self.num_channels} channels, the number on which "
                f"{type(self).__name__} was fitted (got {frames.size(-1)})"
            )
        if self.coefficients.dim() == 3:
            check_num_taxels(data, len(self.coefficients), "the calibration")
        sizes = data.ptr.diff().unique().tolist() if isinstance(data, Batch) else [x.size(-2)]
        need(len(sizes) == 1, "all samples must have the same number of taxels", sizes)
        return frames.reshape(-1, sizes[0], *frames.shape[-2:])

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the calibration as numbers, texts and lists."""
        tensors = {name: getattr(self, name) for name in _TENSORS}
        return {
            "per": self.per,
            "degree": self.degree,
            "reading_unit": self.units[0],
            "force_unit": self.units[1],
            "source": self.source,
            **{key: None if value is None else value.tolist() for key, value in tensors.items()},
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a calibration from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The keys :obj:`"coefficients"`, :obj:`"reading_unit"` and
                :obj:`"force_unit"`, and optionally the other arguments.

        Raises:
            ValueError: If a key is missing or unknown, or the calibration is inconsistent.
        """
        units = tuple(need_key(content, f"{k}_unit", "a calibration") for k in ("reading", "force"))
        need_only_keys(content, _KEYS, "a calibration")
        need_key(content, "coefficients", "a calibration")
        arguments = {key: value for key, value in content.items() if not key.endswith("_unit")}
        return cls(units=units, **arguments)

    def save(self, path: PathLike) -> None:
        r"""Writes the calibration as a JSON file.

        Args:
            path (str or PathLike): The file. If writing fails, no partial file is left.
        """
        with atomic_path(path) as temporary:
            lines = [f" {json.dumps(key)}: {json.dumps(v)}" for key, v in self.to_dict().items()]
            temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads a calibration from a JSON file.

        Args:
            path (str or PathLike): A file written by :meth:`save` or ``tactile calibrate``.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is not JSON or does not hold a consistent calibration. The
                message names the file.
        """
        existing_file(path, "write one with 'tactile calibrate' or Calibrate.save")
        try:
            return cls.from_dict(read_json(path))
        except ValueError as error:  # includes JSONDecodeError
            raise ValueError(f"'{path}' is not a calibration: {error}") from error

    def __repr__(self) -> str:
        shape = self.coefficients.shape
        taxels = f"num_taxels={shape[0]}, " if len(shape) == 3 else ""
        return (
            f"{type(self).__name__}({self.num_channels} -> {shape[-1]}, {taxels}"
            f"degree={self.degree}, per='{self.per}', units={self.units})"
        )


def _finite_tensor(name: str, value: Any) -> Tensor:
    if not isinstance(value, Tensor | np.ndarray):
        need(_are_numbers(value), f"'{name}' must be lists of finite numbers (got other values)")
        try:
            value = torch.tensor(value, dtype=torch.double)
        except (TypeError, ValueError) as error:  # lists of different lengths
            raise ValueError(f"'{name}' must be lists of equal length ({error})") from None
    tensor = torch.as_tensor(value).detach().cpu().double()
    need(tensor.isfinite().all(), f"'{name}' must be finite (got NaN or infinity)")
    return tensor


def _are_numbers(value: Any, depth: int = 3) -> bool:
    if isinstance(value, list | tuple):
        return depth > 0 and all(_are_numbers(item, depth - 1) for item in value)
    return is_number(value)
