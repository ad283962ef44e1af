r"""Scaling of readings to mean zero and standard deviation one."""

from collections.abc import Iterable
from typing import Literal

import torch
from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._scaling import mean_and_deviation
from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("z_score")
class ZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one (functional name:
    :obj:`z_score`). Mean and standard deviation are fitted on samples, which should be the training
    part.

    .. math::
        x' = \frac{x - \mu}{\sigma}

    With :obj:`attr`, another attribute is scaled instead of the readings, such as the features of
    each edge or the angle of each joint. Numbers that change only by rounding, such as the length
    of an edge within a rigid patch, are divided by one.

    On a hand, most taxels are rarely pressed. With :obj:`per="taxel"`, their noise becomes as large
    as a touch on other taxels. There are two alternatives:

    * :obj:`per="channel"` scales all taxels equally. Subtract the readings at rest first
      (:class:`~torch_geometric_tactile.transforms.Tare`). The fitted scaler can be applied to any
      number of taxels.
    * :obj:`scale_per="channel"` is for taxels with different offsets and without readings at rest.
      It subtracts the mean of each taxel, and divides all taxels by one scale: the root mean square
      of their standard deviations.

    Args:
        attr (str): The attribute to scale, such as :obj:`"x"`, :obj:`"edge_attr"`, :obj:`"joint"`,
            :obj:`"absolute"` or :obj:`"pos"`.
        per (str): The numbers that share a mean and a scale:

            * :obj:`"taxel"`: each taxel and channel has a separate mean and scale.
            * :obj:`"channel"`: all taxels of a channel (the last dimension of :obj:`attr`) share
              them.
            * :obj:`"signal"`: all frames of a taxel and channel in a window share them. With the
              other values, each frame of a window has a separate mean and scale.
        scale_per (str, optional): The numbers that share a scale, if they differ from :obj:`per`.
            With :obj:`"all"`, all numbers share one scale, which preserves the directions of forces
            and other vectors.
        with_mean (bool): Whether to subtract the mean. If :obj:`False`, zero stays zero. This suits
            readings that are zero at rest, if later steps locate a touch.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; with :obj:`attr` for example edge features :math:`(|\mathcal{E}|, D)`,
          :math:`(B, |\mathcal{E}|, D)` or :math:`(B \cdot |\mathcal{E}|, D)`, or joint angles
          :math:`(1, J)` or :math:`(B, J)`; with :obj:`per="signal"` windows
          :math:`(\ldots, C \cdot T)` with :obj:`num_frames`, where :math:`T` need not be the same
          as in the fitted samples
        - **output:** the same shape

    Raises:
        RuntimeError: If the transform was not fitted.
        ValueError: If :obj:`per` or :obj:`scale_per` is unknown, they cannot be combined, the
            readings have different taxels (except with :obj:`per="channel"`) or channels than the
            fitted samples, or :obj:`num_frames` is missing with :obj:`per="signal"`.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.tensor([[[1.0]], [[3.0]]]))
        >>> ZScore().fit(data)(data).x.view(-1)
        tensor([-1.,  1.])
        >>> data = StaticData(x=torch.tensor([[[1.0], [1.0]], [[1.0], [5.0]]]))
        >>> ZScore(per="channel").fit(data)(data).x.view(2, 2)
        tensor([[-0.5774, -0.5774],
                [-0.5774,  1.7321]])
    """

    def __init__(
        self,
        attr: str = "x",
        per: Literal["taxel", "channel", "signal"] = "taxel",
        scale_per: Literal["taxel", "channel", "signal", "all"] | None = None,
        with_mean: bool = True,
    ) -> None:
        super().__init__(attr=attr, per=per)
        scale_per = per if scale_per is None else scale_per
        if scale_per not in ("channel", "all", per):
            raise ValueError(
                "'scale_per' must be 'channel', 'all' or the same as 'per' "
                f"(got {scale_per!r} and per={per!r})"
            )
        self.scale_per = scale_per
        self.with_mean = with_mean

    def moments(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        r"""Returns the mean and the scale without missing readings.

        Args:
            parts (iterable of torch.Tensor): The readings in parts, as in
                :meth:`FittedTransform.moments`.
        """
        center, scale = (
            super().moments(parts)
            if self.scale_per == self.per
            else self._moments_with_common_scale(parts)
        )
        return (center if self.with_mean else torch.zeros_like(center)), scale

    def _moments_with_common_scale(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        # A centre for each taxel, and a scale that all taxels share, of each channel or overall.
        center, deviation = mean_and_deviation(parts)
        width = 1 if self.scale_per == "all" else center.size(-1)
        rows = (value.reshape(-1, width) for value in (center.abs(), deviation.square()))
        mean_center, variance = (value.mean(dim=0) for value in rows)
        scale = self.usable(mean_center, variance.sqrt())
        return center, scale.expand_as(center).clone()

    def _attr_repr(self) -> str:
        text = super()._attr_repr()
        text += "" if self.scale_per == self.per else f", scale_per='{self.scale_per}'"
        return text + ("" if self.with_mean else ", with_mean=False")
