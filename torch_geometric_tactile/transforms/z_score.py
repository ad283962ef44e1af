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
    r"""Scales each taxel and channel to mean zero and standard deviation one over the samples on
    which it is fitted, which should be the training part (functional name: :obj:`z_score`).

    .. math::
        x' = \frac{x - \mu}{\sigma}

    With :obj:`attr` it scales each number of another attribute instead of the readings, such as the
    features of each edge or the angle of each joint. Numbers that change only by rounding, such as
    the length of an edge within a rigid patch, are divided by one.

    On a hand most taxels are rarely pressed. Scaled taxel by taxel, their noise becomes as large as
    a touch on other taxels; with :obj:`per="channel"` all taxels have the same scale. Subtract the
    readings at rest first (:class:`~torch_geometric_tactile.transforms.Tare`). A scaler that is
    fitted per channel can be applied to any number of taxels. Without readings at rest, if each
    taxel has a different offset, :obj:`scale_per="channel"` subtracts the mean of each taxel and
    divides all taxels by one scale, the root mean square of their standard deviations.

    Args:
        attr (str): The attribute to scale, such as :obj:`"x"`, :obj:`"edge_attr"`, :obj:`"joint"`,
            :obj:`"absolute"` or :obj:`"pos"`.
        per (str): :obj:`"taxel"` for a centre and a scale of each taxel and channel,
            :obj:`"channel"` for those of all taxels of a channel (the last dimension of
            :obj:`attr`), or :obj:`"signal"` for those of all frames of a taxel and channel, in
            windows. With :obj:`"taxel"` and :obj:`"channel"`, each frame of a window has its own.
        scale_per (str, optional): The same for the scale only; :obj:`per` if left out. With
            :obj:`"all"` all numbers share one scale, which keeps the directions of forces and other
            vectors.
        with_mean (bool): Whether to subtract the mean. Without it, zero stays zero, which is
            suitable for readings that are zero at rest, if later steps locate a touch.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; with :obj:`attr` for example edge features :math:`(|\mathcal{E}|, D)`,
          :math:`(B, |\mathcal{E}|, D)` or :math:`(B \cdot |\mathcal{E}|, D)`, or joint angles
          :math:`(1, J)` or :math:`(B, J)`; with :obj:`per="signal"` windows
          :math:`(\ldots, C \cdot T)` with :obj:`num_frames` :math:`T`, of any number of frames
        - **output:** the same shape

    Raises:
        RuntimeError: If it was not fitted.
        ValueError: If :obj:`per` or :obj:`scale_per` is unknown, or they cannot be combined; or the
            readings have other taxels (unless :obj:`per="channel"`) or channels than in the fit, or
            no :obj:`num_frames` with :obj:`per="signal"`.

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
        r"""Returns mean and standard deviation, without missing readings.

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
        # A centre for each taxel, and a scale for all taxels, of each channel or of all channels.
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
