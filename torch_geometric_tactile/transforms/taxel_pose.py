r"""Positions of the taxels from joint angles."""

from collections.abc import Callable, Set

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin, as_layout
from torch_geometric_tactile.sensors._pose_tables import SmallBatchTables, chain_small_batch
from torch_geometric_tactile.transforms._attributes import check_num_taxels, require
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("taxel_pose")
class TaxelPose(TactileTransform):
    r"""Computes the positions of the taxels of a hand from its joint angles :obj:`joint`
    (functional name: :obj:`taxel_pose`). The computation is differentiable.

    A taxel has the position :math:`\mathbf{p}_i` and the normal :math:`\mathbf{n}_i` on link
    :math:`l`, whose rotation and translation depend on the angles :math:`\mathbf{q}`:

    .. math::
        \mathbf{p}'_i = \mathbf{R}_l(\mathbf{q}) \, \mathbf{p}_i + \mathbf{t}_l(\mathbf{q}), \qquad
        \mathbf{n}'_i = \mathbf{R}_l(\mathbf{q}) \, \mathbf{n}_i

    Args:
        layout (TaxelLayout or str or PathLike, optional): The taxels, in the frames of their links:
            a layout, the name of a layout of this package, or a layout file. The default is
            :func:`~torch_geometric_tactile.sensors.allegro_uskin`.
        kinematics (HandKinematics, optional): The kinematics of the hand with these links. The
            default is the Allegro hand.
        normal (bool): Whether to set :obj:`normal` as well, which takes as long as :obj:`pos`.
        tangent (bool): Whether to set :obj:`tangent` as well: the :math:`x` and :math:`y` axes of
            the taxels (:meth:`~torch_geometric_tactile.sensors.TaxelLayout.axes`).
            :class:`~torch_geometric_tactile.transforms.TaxelForce` requires it.

    Shapes:
        - **input:** joint angles in radians: :math:`(J,)` or :math:`(1, J)` for one sample,
          :math:`(B, J)` for several, or a PyG batch of samples
        - **output:** :obj:`pos` in metres and unit vectors :obj:`normal` (if the layout has
          normals) in the root frame of the hand: :math:`(N, 3)`, :math:`(B, N, 3)` or
          :math:`(B \cdot N, 3)`. Unit vectors :obj:`tangent` have two axes: :math:`(N, 2, 3)` and
          so on. If all samples share the angles (declared as :obj:`shared=["joint"]`), they share
          the positions :math:`(N, 3)`.

    Raises:
        ValueError: If the hand lacks a link of the layout, there are no angles, or their number
            does not match the joints of the hand or the number of samples.

    Examples:
        >>> import torch
        >>> transform = TaxelPose(allegro_uskin(), HandKinematics.allegro())
        >>> transform(Data(joint=torch.zeros(1, 16)))
        Data(joint=[1, 16], pos=[384, 3], normal=[384, 3])
    """

    reads, writes = ("x", "joint"), ("pos", "normal", "tangent")
    per_frame = True

    def __init__(
        self,
        layout: TaxelLayout | PathLike | None = None,
        kinematics: HandKinematics | None = None,
        normal: bool = True,
        tangent: bool = False,
    ) -> None:
        layout = allegro_uskin() if layout is None else as_layout(layout)
        kinematics = HandKinematics.allegro() if kinematics is None else kinematics
        kinematics.require_links(layout)
        self.layout = layout
        self.kinematics = kinematics
        self.normal = normal
        self.tangent = tangent

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`pos`, and :obj:`normal` and :obj:`tangent` if they are selected."""
        joint = require(self, data, "joint")
        if getattr(data, "x", None) is not None:
            name = f"layout '{self.layout.name}'"
            check_num_taxels(data, self.layout.num_taxels, name)
        rows = self._joint_rows(data, joint)
        pose = self.kinematics.taxel_pose(self.layout, rows, self.normal)
        values = {"pos": pose.pos, "normal": pose.normal}
        if self.tangent:
            values["tangent"] = self.kinematics.taxel_axes(self.layout, rows)[..., :2, :]
        is_single = not isinstance(data, StaticData) or data.is_shared("joint")
        for key, value in values.items():
            if value is not None:
                if isinstance(data, Batch):
                    value = value.flatten(0, 1)
                elif is_single:
                    value = value[0]
                data[key] = value
        return data

    def _joint_rows(self, data: Data, joint: Tensor) -> Tensor:
        # The joint angles with a row for each sample (B, J).
        num_joints = self.kinematics.num_joints
        rows = joint
        if joint.dim() == 1 and (
            joint.numel() == num_joints
            # A PyG batch of samples with angles (J,) joins them in one row.
            or (isinstance(data, Batch) and joint.numel() % num_joints == 0)
        ):
            rows = joint.view(-1, num_joints)
        if rows.dim() != 2 or rows.size(1) != num_joints:
            raise ValueError(
                f"'joint' must have {num_joints} angles in each sample, the number of joints of "
                f"'{self.kinematics.name}' (got shape {tuple(joint.shape)})"
            )
        num_samples = 1
        if isinstance(data, Batch):
            num_samples = data.num_graphs
        elif isinstance(data, StaticData):
            num_samples = 1 if data.is_shared("joint") else data.num_samples
        if len(rows) != num_samples:
            raise ValueError(
                f"'joint' must have {num_samples} rows, one for each sample (got shape "
                f"{tuple(joint.shape)})"
            )
        return rows

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a step that multiplies the poses of the links by a matrix."""
        return _PoseStep(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.layout.name}', '{self.kinematics.name}')"


class _PoseStep:
    r"""The step of :class:`TaxelPose` in an exported graph. Positions and normals are linear in the
    poses of the links, so that one matrix product computes them for all taxels.
    """

    def __init__(self, part: TaxelPose) -> None:
        self.part = part
        joint = torch.zeros(1, part.kinematics.num_joints)
        self.tables: SmallBatchTables = part.kinematics._cached_tables(
            part.layout, joint, small=True
        )
        self.links = self.tables.link.unique()
        self.pos = self._matrix(self.tables.pos)
        self.normal = None
        if part.normal and part.layout.normal is not None:
            self.normal = self._matrix(self.tables.normal)

    def _matrix(self, vectors: Tensor) -> Tensor:
        # Returns the matrix (12 L, 3 N) that maps the poses of the links, each with three rows of
        # four numbers, to the vectors of all taxels.
        count = len(vectors)
        row = torch.searchsorted(self.links, self.tables.link)
        matrix = torch.zeros(len(self.links), 3, 4, count, 3)
        for axis in range(3):
            matrix[row, axis, :, torch.arange(count), axis] = vectors[:, 0]
        return matrix.view(12 * len(self.links), 3 * count)

    def __call__(self, data: StaticData) -> StaticData:
        joint = data.joint
        pose = (
            chain_small_batch(self.tables, joint).index_select(1, self.links)[:, :, :3].flatten(1)
        )
        shape = (len(joint), -1, 3)
        data.pos = (pose @ self.pos).view(shape)
        if self.normal is not None:
            data.normal = (pose @ self.normal).view(shape)
        if self.part.tangent:
            axes = self.part.kinematics.taxel_axes(self.part.layout, joint)
            data.tangent = axes[..., :2, :]
        return data
