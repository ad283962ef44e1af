r"""Rotation of three-axis readings into the frame of the hand."""

from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._attributes import require, require_floats
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("taxel_force")
class TaxelForce(TactileTransform):
    r"""Rotates three-axis readings into the frame of the hand (functional name:
    :obj:`taxel_force`), so that readings of different taxels can be added and compared. A reading
    :math:`(x, y, p)` is the shear along the two axes of a taxel and the pressure.

    .. math::
        \mathbf{f}_i = x_i \, \mathbf{t}^x_i + y_i \, \mathbf{t}^y_i - p_i \, \mathbf{n}_i

    The result is the force that the touched object exerts on the skin. Readings are left-handed:
    pressure is positive *into* the skin, against the outward normal :math:`\mathbf{n}`. The axes
    are :obj:`tangent` and :obj:`normal` of the samples, which :obj:`TaxelPose(tangent=True)`
    computes from the joint angles.

    The unit does not change. Readings should be tared and have the same gain in all three channels.
    A scaler that is fitted per channel changes the directions of forces.

    Args:
        out (str): The attribute for the forces: :obj:`"x"` to replace the readings, or a new
            attribute such as :obj:`"force"`.

    Shapes:
        - **input:** readings :math:`(N, 3)`, :math:`(B, N, 3)` or a PyG batch :math:`(B \cdot N,
          3)`; :obj:`tangent` :math:`(N, 2, 3)`, :math:`(B, N, 2, 3)` or :math:`(B \cdot N, 2, 3)`
          and :obj:`normal`, with the shape of the readings or :math:`(N, 3)`
        - **output:** :math:`\mathbf{f}`, with the shape of the readings. If a reading of a taxel is
          missing (NaN), all components of its force are missing.

    Raises:
        ValueError: If there are no readings or no axes, or the readings do not have three channels.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.transforms import TaxelPose
        >>> data = TaxelPose(tangent=True)(Data(joint=torch.zeros(1, 16)))
        >>> data.x = torch.zeros(384, 3)
        >>> data.x[-1] = torch.tensor([0.5, 0.0, 2.0])  # on the palm, which faces along x
        >>> TaxelForce()(data).x[-1]
        tensor([-2.0000,  0.5000,  0.0000])
    """

    reads = ("x", "tangent", "normal")
    per_frame = True

    @property
    def writes(self) -> tuple[str, ...]:
        r"""The attribute that holds the forces."""
        return (self.out,)

    def __init__(self, out: str = "x") -> None:
        self.out = out

    def forward(self, data: Data) -> Data:
        r"""Sets the forces."""
        x = require_floats(self, data)
        tangent, normal = self._axes(data, x)
        if isinstance(data, StaticData) and self.out != "x":
            data = data.declare(node=[self.out])
        along_x, along_y = tangent.to(x).unbind(dim=-2)
        data[self.out] = x[..., :1] * along_x + x[..., 1:2] * along_y - x[..., 2:] * normal.to(x)
        return data

    def _axes(self, data: Data, x: Tensor) -> tuple[Tensor, Tensor]:
        if getattr(data, "tangent", None) is None:
            raise ValueError(
                f"{type(self).__name__} needs 'tangent' (got none): put TaxelPose(tangent=True) "
                "before it"
            )
        tangent, normal = data.tangent, require(self, data, "normal")
        if x.size(-1) != 3:
            raise ValueError(
                f"'x' must have 3 channels, shear x, shear y and pressure (got {x.size(-1)})"
            )
        shapes = [(*x.shape[:-1], 2, 3), (*x.shape[-2:-1], 2, 3)]
        if isinstance(data, Batch):
            shapes = shapes[:1]
        for name, value, allowed_shapes in (
            ("tangent", tangent, shapes),
            ("normal", normal, [(*shape[:-2], 3) for shape in shapes]),
        ):
            if tuple(value.shape) not in allowed_shapes:
                raise ValueError(
                    f"'{name}' must have shape {allowed_shapes[0]}, one for each reading "
                    f"(got {tuple(value.shape)})"
                )
        return tangent, normal

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'' if self.out == 'x' else repr(self.out)})"
