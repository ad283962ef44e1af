r"""Scaling by the training part."""

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

    Args:
        attr (str): What is scaled, such as :obj:`"x"`, :obj:`"edge_attr"`, :obj:`"joint"`,
            :obj:`"absolute"` or :obj:`"pos"`.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; with :obj:`attr` for example edge features :math:`(|\mathcal{E}|, D)`,
          :math:`(B, |\mathcal{E}|, D)` or :math:`(B \cdot |\mathcal{E}|, D)`, or joint angles
          :math:`(1, J)` or :math:`(B, J)`
        - **output:** the same shape

    Raises:
        RuntimeError: If it was not fitted.
        ValueError: If the readings have other taxels or channels than those it was fitted on.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.tensor([[[1.0]], [[3.0]]]))
        >>> ZScore().fit(data)(data).x.view(-1)
        tensor([-1.,  1.])
    """

    def __init__(self, attr: str = "x") -> None:
        super().__init__(attr=attr)
