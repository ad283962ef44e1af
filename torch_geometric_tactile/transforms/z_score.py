r"""Scaling by the training part."""

from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("z_score")
class ZScore(FittedTransform):
    r"""Scales each taxel and channel to mean zero and standard deviation one over the samples that
    it was fitted on, which should be the training part (functional name: :obj:`z_score`).

    .. math::
        x' = \frac{x - \mu}{\sigma}

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
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

    def __init__(self) -> None:
        super().__init__()
