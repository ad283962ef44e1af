r"""Subtraction of the readings at rest."""

import math

from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.transforms._samples import FlatSamples, Samples
from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("tare")
class Tare(FittedTransform):
    r"""Subtracts the reading at rest of each taxel and channel (functional name: :obj:`tare`). The
    reading at rest is the mean over the first samples of a session (or trial), before anything is
    touched.

    .. math::
        x' = x - \frac{1}{|R|} \sum_{r \in R} x_r

    The samples at rest :math:`R` are the :obj:`first` samples of the session, or the samples with
    :math:`t - t_0` below :obj:`seconds`, where :math:`t_0` is the earliest time of the session.

    If a session has no samples at rest, leave out both :obj:`first` and :obj:`seconds`. The mean
    over the whole session is then subtracted, which removes the offset of the sensor together with
    the mean touch.

    Args:
        key (str): Integer attribute of the samples that separates sessions, such as
            :obj:`"session"` or :obj:`"trial"`. Each session has its own readings at rest.
        first (int, optional): Number of samples at rest at the start of each session. If left out,
            all samples are used.
        seconds (float, optional): Duration of the rest at the start of each session, in place of
            :obj:`first`: seconds of the sample attribute :obj:`time`, preferably in double
            precision. Samples at exactly this time are not included.
        attr (str): The attribute to shift: :obj:`"x"`, or another attribute of floating-point
            numbers.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`, with sessions :math:`(B,)`; to fit with :obj:`seconds`, times in seconds
          :math:`(B,)`
        - **output:** the same shape, in the same unit

    Raises:
        RuntimeError: If the transform was not fitted.
        ValueError: If :obj:`first` is below one, :obj:`seconds` is not positive, both are given, a
            session was not fitted, samples lack the finite times that :obj:`seconds` requires, or
            the readings have different taxels or channels than the fitted samples.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> x = torch.tensor([10.0, 15.0, 20.0, 21.0]).view(4, 1, 1)
        >>> data = StaticData(x=x, trial=torch.tensor([0, 0, 1, 1]))
        >>> Tare("trial", first=1).fit(data)(data).x.view(-1)
        tensor([0., 5., 0., 1.])
    """

    def __init__(
        self,
        key: str = "session",
        first: int | None = None,
        seconds: float | None = None,
        attr: str = "x",
    ) -> None:
        if first is not None and seconds is not None:
            raise ValueError(
                f"only one of 'first' and 'seconds' may be given (got {first} and {seconds})"
            )
        if seconds is not None and not 0 < seconds < math.inf:
            raise ValueError(f"'seconds' must be positive and finite (got {seconds})")
        need(first is None or first >= 1, "'first' must be at least 1", first)
        super().__init__(key, unit_scale=True, first=first, attr=attr)
        self.seconds = seconds

    def measured(self, samples: Samples | FlatSamples, index: Tensor) -> Tensor:
        r"""Returns the indices of the samples at rest in one session."""
        if self.seconds is None:
            return super().measured(samples, index)
        time = self.sample_values(samples, "time", samples.num_samples)[index].double()
        need(time.isfinite().all(), "'time' must be finite seconds (got NaN or infinity)")
        return index[time - time.min() < self.seconds]

    def __repr__(self) -> str:
        if self.seconds is not None:
            return f"{type(self).__name__}('{self.key}', seconds={self.seconds}{self._attr_repr()})"
        return f"{type(self).__name__}('{self.key}', first={self.first}{self._attr_repr()})"
