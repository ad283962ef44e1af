r"""Scaling by the training part."""

from typing import Literal

from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("z_score")
class ZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one over the samples that
    it was fitted on, which should be the training part (functional name: :obj:`z_score`).

    .. math::
        x' = \frac{x - \mu}{\sigma}

    With :obj:`attr` it scales another attribute in place of the readings, each of its numbers by
    itself: the features of each edge, the angle of each joint. What changes by less than rounding
    does, such as the length of an edge within a rigid patch, keeps its scale.

    On a hand most taxels are hardly ever pressed. By itself each of them is scaled up until its
    noise is as large as the touch on others; with :obj:`per="channel"` all keep one scale. Subtract
    their rest readings before (:class:`~torch_geometric_tactile.transforms.Tare`). What was fitted
    so can be applied to any number of taxels.

    Args:
        attr (str): What is scaled, such as :obj:`"x"`, :obj:`"edge_attr"`, :obj:`"joint"`,
            :obj:`"absolute"` or :obj:`"pos"`.
        per (str): :obj:`"taxel"` for a centre and a scale of each taxel and channel, or
            :obj:`"channel"` for one of all taxels of a channel: the last dimension of :obj:`attr`.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; with :obj:`attr` for example edge features :math:`(|\mathcal{E}|, D)`,
          :math:`(B, |\mathcal{E}|, D)` or :math:`(B \cdot |\mathcal{E}|, D)`, or joint angles
          :math:`(1, J)` or :math:`(B, J)`
        - **output:** the same shape

    Raises:
        RuntimeError: If it was not fitted.
        ValueError: If :obj:`per` is unknown, or the readings have other taxels (unless
            :obj:`per="channel"`) or channels than those it was fitted on.

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

    def __init__(self, attr: str = "x", per: Literal["taxel", "channel"] = "taxel") -> None:
        super().__init__(attr=attr, per=per)
