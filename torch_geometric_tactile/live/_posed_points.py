r"""Positions of the taxels of a frame in space, for viewers of recordings."""

import logging
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.live_frame import LiveFrame

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors import TaxelLayout

_log = logging.getLogger(__name__)


class Points(NamedTuple):
    r"""Positions in metres :math:`(N, 3)` in the frame :obj:`frame_id`, and values of the taxels
    :math:`(N,)` by name.
    """

    pos: np.ndarray
    fields: dict[str, np.ndarray]
    frame_id: str


class PosedPoints:
    r"""Poses the taxels of a layout by the joint angles of each frame. Needs :obj:`torch`.

    A layout on the links of the Allegro hand is posed by its kinematics. A missing angle keeps its
    last value, which is zero at first. Other layouts are not posed.

    The values are changes since the rest. With three channels, :obj:`pressure` is the change of the
    third (normal) channel, and :obj:`shear` the length of the change of the first two. Otherwise
    :obj:`pressure` is the change of the first channel.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, its name or its file.
    """

    def __init__(self, layout: "TaxelLayout | PathLike") -> None:
        from torch_geometric_tactile.sensors import HandKinematics, as_layout

        self.layout = as_layout(layout)
        hand = HandKinematics.allegro()
        self._hand: HandKinematics | None = None
        self._order: list[int] | None = None
        self.frame_id = self.layout.link_names[0]
        self._pos = self.layout.pos.double().numpy()
        if self._pos.shape[1] == 2:
            self._pos = np.c_[self._pos, np.zeros(len(self._pos))]
        if set(self.layout.link_names) <= set(hand.link_names):
            self._hand = hand
            self._order = list(range(hand.num_joints))
            self._joint = np.zeros(hand.num_joints)
            self.frame_id = hand.link_names[0]
            self._pose_taxels(None)  # the first call is slow; no frame should wait for it

    def name_joints(self, names: Any) -> None:
        r"""Sets the order of the joint angles by their names. :obj:`None` is the order of the
        hand.
        """
        if self._hand is not None:
            self._order = _joint_order(self._hand.joint_names, names)

    def __call__(self, frame: LiveFrame, rest: np.ndarray) -> Points:
        r"""Returns the positions and values of the taxels of a frame.

        Shapes:
            - **rest:** Readings at rest :math:`(N, C)`.
        """
        if len(frame.tactile) != self.layout.num_taxels:
            raise ValueError(
                f"a frame on layout '{self.layout.name}' must have {self.layout.num_taxels} taxels "
                f"(got {len(frame.tactile)})"
            )
        change = frame.tactile - rest
        if change.shape[1] == 3:
            fields = {"pressure": change[:, 2], "shear": np.hypot(change[:, 0], change[:, 1])}
        else:
            fields = {"pressure": change[:, 0]}
        return Points(self._pose_taxels(frame.joint), fields, self.frame_id)

    def _pose_taxels(self, angles: np.ndarray | None) -> np.ndarray:
        if self._hand is None:
            return self._pos
        import torch

        if angles is not None and self._order is not None:
            if len(angles) == len(self._order):
                joint = np.asarray(angles, dtype=np.float64)[self._order]
                self._joint = np.where(np.isfinite(joint), joint, self._joint)
            else:
                _log.warning(
                    "the points of a recording are not posed: frames have %d joint angles, but the "
                    "hand has %d",
                    len(angles),
                    len(self._order),
                )
                self._order = None
        with torch.no_grad():
            posed = self._hand.taxel_pose(self.layout, torch.from_numpy(self._joint), normal=False)
            return np.asarray(posed.pos.numpy())


def _joint_order(hand_names: tuple[str, ...], names: Any) -> list[int] | None:
    if names is None:
        return list(range(len(hand_names)))
    if not isinstance(names, list | tuple) or set(names) != set(hand_names):
        _log.warning(
            "the points of a recording are not posed: the names of its joint angles differ from "
            "the joint names of the hand"
        )
        return None
    return [list(names).index(name) for name in hand_names]
