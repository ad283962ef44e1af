r"""The bilinear feature of a feature map with itself."""

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need

# The root of a number near zero has a gradient without bound.
_FLOOR = 1e-8


class BilinearFeature(torch.nn.Module):
    r"""The single-mode bilinear feature of the "A Novel Bilinear Feature and Multi-Layer Fused
    Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors 2020, 20, 5822): of
    each feature map :math:`\mathbf{f}` with :math:`n` rows, the products of its columns with one
    another, then the signed root of each of them, divided by the :math:`\ell_2` norm of all.

    .. math::
        \mathbf{\Phi} = \frac{1}{n} \mathbf{f}^{\top} \mathbf{f} + \epsilon \mathbf{I}, \qquad
        \mathbf{Z} = \mathrm{sign}(\mathbf{\Phi}) \sqrt{|\mathbf{\Phi}| + 10^{-8}}, \qquad
        \mathbf{\Phi}' = \frac{\mathbf{Z}}{\lVert \mathbf{Z} \rVert_2}

    :math:`\mathbf{\Phi}` is symmetric and positive semi-definite, the output symmetric with norm
    one.

    The paper does not give :math:`\epsilon`, nor the :math:`10^{-8}` below the root: without it,
    the gradient of the root has no bound at zero, and training gives NaN within ten batches. Its
    norm is that of one feature map, as its formula has it, and not that of all maps of a sample:
    how strong a map is beside the others is lost.

    Args:
        eps (float): What is added to the diagonal :math:`\epsilon`.

    Shapes:
        - **input:** feature maps :math:`(*, H, W)`
        - **output:** :math:`(*, W, W)`

    Raises:
        ValueError: If :obj:`eps` is not positive and finite, or :obj:`x` has no rows and columns.

    Examples:
        >>> BilinearFeature()(torch.tensor([[2.0, 1.0], [0.0, 1.0]]))
        tensor([[0.6325, 0.4472],
                [0.4472, 0.4472]])
    """

    def __init__(self, eps: float = 1e-5) -> None:
        super().__init__()
        need(0 < eps < float("inf"), "'eps' must be positive and finite", eps)
        self.eps = eps

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the bilinear feature of each feature map.

        Args:
            x (torch.Tensor): Feature maps.
        """
        root = self._signed_root(self.products(x))
        return root / torch.linalg.vector_norm(root, dim=(-2, -1), keepdim=True)

    def products(self, x: Tensor) -> Tensor:
        r"""Returns :math:`\mathbf{\Phi}`, before the root.

        Args:
            x (torch.Tensor): Feature maps.

        Shapes:
            - **output:** :math:`(*, W, W)`
        """
        if x.dim() < 2 or x.size(-2) == 0 or x.size(-1) == 0:
            raise ValueError(f"'x' must have rows and columns (got shape {tuple(x.shape)})")
        num_rows, num_columns = x.shape[-2:]
        unit = torch.eye(num_columns, dtype=x.dtype, device=x.device)
        return x.transpose(-2, -1) @ x / num_rows + self.eps * unit

    @staticmethod
    def _signed_root(phi: Tensor) -> Tensor:
        return phi.sign() * (phi.abs() + _FLOOR).sqrt()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(eps={self.eps})"
