r"""Scenes: positions of the taxels and links that the viewer draws."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._typing import PathLike

if TYPE_CHECKING:  # without a layout, a live robot is shown without torch
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_OVERLAP_QUANTILE = (
    0.1  # fraction of the taxels of a patch that may overlap their nearest neighbour
)
# Rows: directions to the right, up and towards the observer, in the frame of the root link.
_HAND_VIEW = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
_FLAT_VIEW = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Scene:
    r"""The taxels on their links, and the poses of the links.

    Shapes:
        - **pos:** positions in the frame of the link :math:`(N, 3)`
        - **axes:** unit axes :math:`x`, :math:`y` and normal in the frame of the link
          :math:`(N, 3, 3)`
        - **size:** distance to the nearest taxel of the patch :math:`(N,)`
        - **link:** index of the link :math:`(N,)`
        - **pose:** poses of the links while frames have no joint angles, as rows of the rotation
          and the translation :math:`(L, 12)`
    """

    name: str
    form: str
    pos: np.ndarray
    axes: np.ndarray
    size: np.ndarray
    link: np.ndarray
    pose: np.ndarray
    view: Sequence[Sequence[float]] = _FLAT_VIEW
    bodies: Sequence[Mapping[str, Any]] = ()
    labels: Sequence[Mapping[str, Any]] = ()
    kinematics: "HandKinematics | None" = field(default=None, repr=False)

    @property
    def num_taxels(self) -> int:
        r"""Number of taxels :math:`N`."""
        return len(self.pos)

    @property
    def num_joints(self) -> int:
        r"""Number of joint angles :math:`J`; 0 if the links do not move."""
        return 0 if self.kinematics is None else self.kinematics.num_joints

    def link_poses(self, joint: np.ndarray) -> np.ndarray:
        r"""Returns the poses of the links for joint angles.

        Shapes:
            - **joint:** joint angles in radians :math:`(J,)`
            - **output:** as :obj:`pose` :math:`(L, 12)`
        """
        import torch

        assert self.kinematics is not None
        angle = torch.from_numpy(np.ascontiguousarray(joint, dtype=np.float32))
        rotation, translation = self.kinematics.link_pose(angle)
        return torch.cat([rotation.flatten(1), translation], dim=1).numpy()

    def description(self) -> dict[str, Any]:
        r"""Returns the scene for the page as JSON values, except for the arrays."""
        return {
            "layout": self.name,
            "form": self.form,
            "view": self.view,
            "bodies": self.bodies,
            "labels": self.labels,
        }

    def arrays(self) -> dict[str, np.ndarray]:
        r"""Returns the arrays of the scene for the page."""
        names = ("pos", "axes", "size", "link", "pose")
        return {name: getattr(self, name) for name in names}


class Scenes:
    r"""The scene of a stream for any number of pages. It shows :obj:`layout`, else the layout that
    the source names, else a grid of taxel numbers.

    Args:
        stream (Stream): The stream.
        layout (TaxelLayout, str or PathLike, optional): The layout, its name or its file.
        joint (numpy.ndarray, optional): Joint angles in radians while frames have none.
        kinematics (HandKinematics, optional): The hand that carries the layout.
        note (callable): Called with a message if a layout cannot be shown.
    """

    def __init__(
        self,
        stream: Any,
        layout: "TaxelLayout | PathLike | None",
        joint: np.ndarray | None,
        kinematics: "HandKinematics | None",
        note: Callable[[str], None],
    ) -> None:
        self._stream, self._note = stream, note
        self._layout: TaxelLayout | None = None
        self._is_layout_resolved = layout is not None
        self._joint, self._kinematics = joint, kinematics
        self._scene: Scene | None = None
        self._lock = threading.Lock()
        self._last_pose: tuple[np.ndarray, np.ndarray] | None = None
        if (
            layout is not None
        ):  # here, so that errors of arguments are raised before the viewer runs
            from torch_geometric_tactile.sensors import as_layout

            self._layout = as_layout(layout)
            self._layout_scene = layout_scene(self._layout, kinematics, joint)

    def scene(self, num_taxels: int) -> Scene:
        r"""Returns the scene of frames with :obj:`num_taxels` taxels. The same object is returned
        until the number changes.
        """
        with self._lock:
            if self._scene is None or self._scene.num_taxels != num_taxels:
                self._last_pose = None
                self._scene = self._new_scene(num_taxels)
            return self._scene

    def prepare(self) -> None:
        r"""Reads the layout that the source names, if it is known before the source is open."""
        with self._lock:
            if (
                self._layout is None
                and not self._is_layout_resolved
                and self._stream.meta.get("sensor")
            ):
                self._load_stock_layout(self._stream.meta["sensor"])

    def _new_scene(self, num_taxels: int) -> Scene:
        if self._layout is None and not self._is_layout_resolved:
            self._load_stock_layout(self._stream.meta.get("sensor"))
        if self._layout is None:
            return number_scene(num_taxels)
        if self._layout.num_taxels == num_taxels:
            return self._layout_scene
        self._note(
            f"Layout {self._layout.name} has {self._layout.num_taxels} taxels, but frames have "
            f"{num_taxels}: shown by number"
        )
        return number_scene(num_taxels)

    def _load_stock_layout(self, name: Any) -> None:
        self._is_layout_resolved = True
        if name is None:
            return
        try:
            from torch_geometric_tactile.sensors import stock_layout, stock_names

            if name in stock_names("layouts"):
                self._layout = stock_layout(name)
                self._layout_scene = layout_scene(self._layout, self._kinematics, self._joint)
        except ImportError:
            self._note(f"Layout {name} needs PyTorch: shown by number")

    def pose(self, scene: Scene, joint: np.ndarray | None) -> np.ndarray:
        r"""Returns the poses of the links. Returns the same array while the joints do not move, so
        that it need not be sent again.
        """
        last_pose = self._last_pose
        if (
            joint is None
            or scene.kinematics is None
            or joint.shape != (scene.num_joints,)
            or not np.isfinite(joint).all()
        ):
            return scene.pose if last_pose is None else last_pose[1]
        if last_pose is None or not np.array_equal(last_pose[0], joint):
            self._last_pose = last_pose = (joint.copy(), scene.link_poses(joint))
        return last_pose[1]


def number_scene(num_taxels: int) -> Scene:
    r"""Returns a grid of :obj:`num_taxels` taxels, numbered row by row from the top left."""
    columns = math.ceil(math.sqrt(num_taxels))
    row, column = np.divmod(np.arange(num_taxels), columns)
    pos = np.stack([column, -row, np.zeros(num_taxels)], axis=1).astype(np.float32)
    return Scene(
        name="",
        form="numbers",
        pos=pos,
        axes=np.tile(np.eye(3, dtype=np.float32), (num_taxels, 1, 1)),
        size=np.ones(num_taxels, dtype=np.float32),
        link=np.zeros(num_taxels, dtype=np.float32),
        pose=_identity_pose(),
    )


def layout_scene(
    layout: "TaxelLayout",
    kinematics: "HandKinematics | None" = None,
    joint: np.ndarray | None = None,
) -> Scene:
    r"""Returns the scene of a layout: on the hand that carries its links, or else with all pads
    side by side.
    """
    from torch_geometric_tactile._texts import read_json
    from torch_geometric_tactile.sensors import HandKinematics, stock_path

    bodies: Sequence[Mapping[str, Any]] = ()
    if kinematics is None:
        allegro = HandKinematics.allegro()
        if set(layout.link_names) <= set(allegro.link_names):
            kinematics = allegro
            bodies = read_json(stock_path("chains", "allegro_right"))["bodies"]
    if kinematics is None:
        return _pad_scene(layout)
    return _hand_scene(layout, kinematics, joint, bodies)


def _hand_scene(
    layout: "TaxelLayout",
    kinematics: "HandKinematics",
    joint: np.ndarray | None,
    bodies: Sequence[Mapping[str, Any]],
) -> Scene:
    from torch_geometric_tactile.sensors._views import open_angles

    kinematics.require_links(layout)
    link_numbers = {name: i for i, name in enumerate(kinematics.link_names)}
    assert layout.link is not None
    link = np.array([link_numbers.get(name, 0) for name in layout.link_names])[layout.link.numpy()]
    angle = open_angles(kinematics).numpy() if joint is None else np.asarray(joint, np.float32)
    scene = Scene(
        name=layout.name,
        form="hand",
        pos=layout.pos.numpy(),
        axes=layout.axes().numpy(),
        size=_taxel_sizes(layout),
        link=link,
        pose=np.zeros((0, 12), np.float32),
        view=_HAND_VIEW,
        bodies=[_body_message(body, kinematics) for body in bodies],
        labels=_digit_labels(layout, link),
        kinematics=kinematics,
    )
    object.__setattr__(scene, "pose", scene.link_poses(angle))
    return scene


def _body_message(body: Mapping[str, Any], kinematics: "HandKinematics") -> dict[str, Any]:
    # A sphere on a link that is fixed to its parent is drawn on the parent, so that the taxels of
    # the parent are in front of it.
    link, center = body["link"], np.array(body["center"])
    fixed = {joint.child: joint for joint in kinematics.joints if joint.axis is None}
    if "sphere" in body and link in fixed:
        joint = fixed[link]
        link, center = joint.parent, center + np.array(joint.xyz)  # a sphere has no rotation
    return {
        "link": kinematics.link_names.index(link),
        "center": center.tolist(),
        "box": body.get("box"),
        "sphere": body.get("sphere"),
    }


def _digit_labels(layout: "TaxelLayout", link: np.ndarray) -> list[dict[str, Any]]:
    # Labels are at the last patch of each moving digit; patches are numbered from base to tip.
    assert layout.digit is not None
    assert layout.patch is not None
    digit, patch, pos = layout.digit.numpy(), layout.patch.numpy(), layout.pos.numpy()
    labels = []
    for index, name in enumerate(layout.digit_names):
        taxels = np.flatnonzero(digit == index)
        if not len(taxels) or (link[taxels] == 0).all():
            continue
        first, last = (taxels[patch[taxels] == end(patch[taxels])] for end in (np.min, np.max))
        labels.append(
            {
                "text": name,
                "link": int(link[last[0]]),
                "at": pos[last].mean(axis=0).tolist(),
                "base_link": int(link[first[0]]),
                "base": pos[first].mean(axis=0).tolist(),
            }
        )
    return labels


def _pad_scene(layout: "TaxelLayout") -> Scene:
    from torch_geometric_tactile.sensors._views import PAD_GAP, pads_side_by_side

    assert layout.link is not None
    used, link = np.unique(layout.link.numpy(), return_inverse=True)
    pads = [[part.numpy() for part in pad] for pad in pads_side_by_side(layout)]
    pos = [layout.pos.numpy()[taxels] @ axes.T for taxels, axes, _ in pads]
    below = 0.36 * PAD_GAP * max(float(np.ptp(points, axis=0).max()) for points in pos)
    pose, labels = [], []
    for index, ((_, axes, shift), points) in enumerate(zip(pads, pos, strict=True)):
        low, high = points.min(axis=0), points.max(axis=0)
        pose.append(np.concatenate([axes.ravel(), shift]))
        label_pos = axes.T @ np.array([(low[0] + high[0]) / 2, low[1] - below, 0.0])
        labels.append(
            {"text": layout.link_names[int(used[index])], "link": index, "at": label_pos.tolist()}
        )
    return Scene(
        name=layout.name,
        form="pads",
        pos=layout.pos.numpy(),
        axes=layout.axes().numpy(),
        size=_taxel_sizes(layout),
        link=link,
        pose=np.array(pose, dtype=np.float32),
        labels=labels if len(used) > 1 else [],
    )


def _taxel_sizes(layout: "TaxelLayout") -> np.ndarray:
    from scipy.spatial import cKDTree

    assert layout.link is not None
    assert layout.patch is not None
    pos, patch = layout.pos.numpy(), layout.patch.numpy()
    size = np.full(len(pos), np.nan, dtype=np.float32)
    for index in np.unique(patch):
        taxels = np.flatnonzero(patch == index)
        if len(taxels) > 1:
            distance = cKDTree(pos[taxels]).query(pos[taxels], k=2)[0][:, 1]
            distances = distance[distance > 0]
            size[taxels] = np.quantile(distances, _OVERLAP_QUANTILE) if len(distances) else np.nan
    finite_sizes = size[~np.isnan(size)]
    size[np.isnan(size)] = np.median(finite_sizes) if len(finite_sizes) else 0.005
    return size


def _identity_pose() -> np.ndarray:
    return np.concatenate([np.eye(3).ravel(), np.zeros(3)])[None].astype(np.float32)
