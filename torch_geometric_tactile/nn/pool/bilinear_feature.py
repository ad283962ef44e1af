r"""The bilinear feature of feature maps."""

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need

# Added under the square root, since its gradient is unbounded near zero.
_FLOOR = 1e-8


class BilinearFeature(torch.nn.Module):
    r"""The single-mode bilinear feature from the "A Novel Bilinear Feature and Multi-Layer Fused
    Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors 2020, 20, 5822). For
    each feature map :math:`\mathbf{f}` with :math:`n` rows, it computes the products of all pairs
    of columns, takes the signed root of each product and divides by the :math:`\ell_2` norm over
    all of them.

    .. math::
        \mathbf{\Phi} = \frac{1}{n} \mathbf{f}^{\top} \mathbf{f} + \epsilon \mathbf{I}, \qquad
        \mathbf{Z} = \mathrm{sign}(\mathbf{\Phi}) \sqrt{|\mathbf{\Phi}| + 10^{-8}}, \qquad
        \mathbf{\Phi}' = \frac{\mathbf{Z}}{\lVert \mathbf{Z} \rVert_2}

    :math:`\mathbf{\Phi}` is symmetric and positive semi-definite. The output is symmetric with norm
    one.

    The paper does not state the value of :math:`\epsilon`, and has no constant under the root.
    Without the :math:`10^{-8}`, the gradient of the root is unbounded at zero, and training yields
    NaN within ten batches. As in the paper's formula, each feature map is divided by its own norm
    instead of the norm over all maps of a sample, so that the relative strength of the maps is
    lost.

    Args:
        eps (float): Constant :math:`\epsilon` that is added to the diagonal.

    Shapes:
        - **input:** feature maps :math:`(*, H, W)`
        - **output:** :math:`(*, W, W)`

    Raises:
        ValueError: If :obj:`eps` is not positive and finite, or :obj:`x` has no rows or no columns.

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
        r"""Returns the bilinear feature of each feature map :math:`(*, W, W)`.

        Args:
            x (torch.Tensor): Feature maps.
        """
        root = self._signed_root(self.products(x))
        return root / torch.linalg.vector_norm(root, dim=(-2, -1), keepdim=True)

    def products(self, x: Tensor) -> Tensor:
        r"""Returns the products :math:`\mathbf{\Phi}` of the columns before the root is taken.

        Args:
            x (torch.Tensor): Feature maps.

        Shapes:
            - **output:** :math:`(*, W, W)`
        """
        if x.dim() < 2 or x.size(-2) == 0 or x.size(-1) == 0:
            raise ValueError(f"'x' must have rows and columns (got shape {tuple(x.shape)})")
        num_rows, num_columns = x.shape[-2:]
        identity = torch.eye(num_columns, dtype=x.dtype, device=x.device)
        return x.transpose(-2, -1) @ x / num_rows + self.eps * identity

    @staticmethod
    def _signed_root(phi: Tensor) -> Tensor:
        return phi.sign() * (phi.abs() + _FLOOR).sqrt()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(eps={self.eps})"
