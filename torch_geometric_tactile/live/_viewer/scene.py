r"""Where the viewer draws the taxels."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._typing import PathLike

if TYPE_CHECKING:  # without a layout, a live robot is shown without torch
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_NEAR = 0.1  # share of the taxels of a patch that may overlap their nearest
# Rows: what the viewer sees to the right, above, and towards himself, in the frame of the root.
_HAND_VIEW = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
_FLAT_VIEW = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Scene:
    r"""The taxels on their links, and how the links move.

    Shapes:
        - **pos:** Places in the frame of the link :math:`(N, 3)`.
        - **axes:** Unit axes :math:`x`, :math:`y` and normal, likewise
          :math:`(N, 3, 3)`.
        - **size:** Distance to the nearest taxel of the patch :math:`(N,)`.
        - **link:** Index of the link :math:`(N,)`.
        - **pose:** Pose of the links without joint angles: rows of the rotation, and the
          translation :math:`(L, 12)`.
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
        r"""The number of taxels :math:`N`."""
        return len(self.pos)

    @property
    def num_joints(self) -> int:
        r"""The number of joint angles that pose it, 0 if none do."""
        return 0 if self.kinematics is None else self.kinematics.num_joints

    def posed(self, joint: np.ndarray) -> np.ndarray:
        r"""Returns the poses of the links as :obj:`pose` has them.

        Shapes:
            - **joint:** Joint angles in radians :math:`(J,)`.
        """
        import torch

        assert self.kinematics is not None
        angle = torch.from_numpy(np.ascontiguousarray(joint, dtype=np.float32))
        rotation, translation = self.kinematics.link_pose(angle)
        return torch.cat([rotation.flatten(1), translation], dim=1).numpy()

    def head(self) -> dict[str, Any]:
        r"""Returns what the page is told beside the arrays."""
        return {
            "layout": self.name,
            "form": self.form,
            "view": self.view,
            "bodies": self.bodies,
            "labels": self.labels,
        }

    def arrays(self) -> dict[str, np.ndarray]:
        r"""Returns the arrays that the page is sent."""
        names = ("pos", "axes", "size", "link", "pose")
        return {name: getattr(self, name) for name in names}


class Scenes:
    r"""The scene of a stream for any number of pages: on its layout, which is given or named by the
    source, or else a grid by number.
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
        self._asked = layout is not None
        self._joint, self._kinematics = joint, kinematics
        self._scene: Scene | None = None
        self._lock = threading.Lock()
        self._posed: tuple[np.ndarray, np.ndarray] | None = None
        if layout is not None:  # what does not fit is told before anything runs
            from torch_geometric_tactile.sensors import as_layout

            self._layout = as_layout(layout)
            self._layout_scene = layout_scene(self._layout, kinematics, joint)

    def scene(self, num_taxels: int) -> Scene:
        r"""Returns the scene of frames with this number of taxels; the same one if asked again.

        Shapes:
            - **num_taxels:** Number of taxels :math:`N`.
        """
        with self._lock:
            if self._scene is None or self._scene.num_taxels != num_taxels:
                self._posed = None
                self._scene = self._new_scene(num_taxels)
            return self._scene

    def prepare(self) -> None:
        r"""Reads the layout that the source names, if it does already."""
        with self._lock:
            if self._layout is None and not self._asked and self._stream.meta.get("sensor"):
                self._find_layout(self._stream.meta["sensor"])

    def _new_scene(self, num_taxels: int) -> Scene:
        if self._layout is None and not self._asked:
            self._find_layout(self._stream.meta.get("sensor"))
        if self._layout is None:
            return number_scene(num_taxels)
        if self._layout.num_taxels == num_taxels:
            return self._layout_scene
        self._note(
            f"Layout {self._layout.name} has {self._layout.num_taxels} taxels, and frames have "
            f"{num_taxels}: shown by number"
        )
        return number_scene(num_taxels)

    def _find_layout(self, name: Any) -> None:
        self._asked = True
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
        r"""Returns the poses of the links; the same array while the joints do not move."""
        kept = self._posed
        if (
            joint is None
            or scene.kinematics is None
            or joint.shape != (scene.num_joints,)
            or not np.isfinite(joint).all()
        ):
            return scene.pose if kept is None else kept[1]
        if kept is None or not np.array_equal(kept[0], joint):
            self._posed = kept = (joint.copy(), scene.posed(joint))
        return kept[1]


def number_scene(num_taxels: int) -> Scene:
    r"""Returns a grid of the taxels by number, row by row from the top left.

    Shapes:
        - **num_taxels:** Number of taxels :math:`N`.
    """
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
        pose=_still(),
    )


def layout_scene(
    layout: "TaxelLayout",
    kinematics: "HandKinematics | None" = None,
    joint: np.ndarray | None = None,
) -> Scene:
    r"""Returns the scene of a layout: on the hand that carries its links, or pad beside pad."""
    from torch_geometric_tactile._texts import read_json
    from torch_geometric_tactile.sensors import HandKinematics, stock_path

    bodies: Sequence[Mapping[str, Any]] = ()
    if kinematics is None:
        allegro = HandKinematics.allegro()
        if set(layout.link_names) <= set(allegro.link_names):
            kinematics = allegro
            bodies = read_json(stock_path("chains", "allegro_right"))["bodies"]
    if kinematics is None:
        return _pads(layout)
    return _hand(layout, kinematics, joint, bodies)


def _hand(
    layout: "TaxelLayout",
    kinematics: "HandKinematics",
    joint: np.ndarray | None,
    bodies: Sequence[Mapping[str, Any]],
) -> Scene:
    from torch_geometric_tactile.sensors._views import open_angles

    kinematics.require_links(layout)
    number = {name: i for i, name in enumerate(kinematics.link_names)}
    assert layout.link is not None
    link = np.array([number.get(name, 0) for name in layout.link_names])[layout.link.numpy()]
    angle = open_angles(kinematics).numpy() if joint is None else np.asarray(joint, np.float32)
    scene = Scene(
        name=layout.name,
        form="hand",
        pos=layout.pos.numpy(),
        axes=layout.axes().numpy(),
        size=_sizes(layout),
        link=link,
        pose=np.zeros((0, 12), np.float32),
        view=_HAND_VIEW,
        bodies=[_body(body, kinematics) for body in bodies],
        labels=_digit_labels(layout, link),
        kinematics=kinematics,
    )
    object.__setattr__(scene, "pose", scene.posed(angle))
    return scene


def _body(body: Mapping[str, Any], kinematics: "HandKinematics") -> dict[str, Any]:
    # A sphere on a link that does not move on its parent is drawn as the parent's, so that the
    # taxels on the parent are in front of it.
    link, center = body["link"], np.array(body["center"])
    fixed = {joint.child: joint for joint in kinematics.joints if joint.axis is None}
    if "sphere" in body and link in fixed:
        joint = fixed[link]
        link, center = joint.parent, center + np.array(joint.xyz)  # a sphere: however it is turned
    return {
        "link": kinematics.link_names.index(link),
        "center": center.tolist(),
        "box": body.get("box"),
        "sphere": body.get("sphere"),
    }


def _digit_labels(layout: "TaxelLayout", link: np.ndarray) -> list[dict[str, Any]]:
    # At the last patch of each digit that moves; patches are numbered from base to tip.
    assert layout.digit is not None
    assert layout.patch is not None
    digit, patch, pos = layout.digit.numpy(), layout.patch.numpy(), layout.pos.numpy()
    labels = []
    for index, name in enumerate(layout.digit_names):
        mine = np.flatnonzero(digit == index)
        if not len(mine) or (link[mine] == 0).all():
            continue
        first, last = (mine[patch[mine] == end(patch[mine])] for end in (np.min, np.max))
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


def _pads(layout: "TaxelLayout") -> Scene:
    from torch_geometric_tactile.sensors._views import PAD_GAP, pads_side_by_side

    assert layout.link is not None
    used, link = np.unique(layout.link.numpy(), return_inverse=True)
    pads = [[part.numpy() for part in pad] for pad in pads_side_by_side(layout)]
    pos = [layout.pos.numpy()[mine] @ axes.T for mine, axes, _ in pads]
    below = 0.6 * PAD_GAP * max(float(np.ptp(places, axis=0).max()) for places in pos)
    pose, labels = [], []
    for index, ((_, axes, shift), places) in enumerate(zip(pads, pos, strict=True)):
        low, high = places.min(axis=0), places.max(axis=0)
        pose.append(np.concatenate([axes.ravel(), shift]))
        at = axes.T @ np.array([(low[0] + high[0]) / 2, low[1] - below, 0.0])
        labels.append(
            {"text": layout.link_names[int(used[index])], "link": index, "at": at.tolist()}
        )
    return Scene(
        name=layout.name,
        form="pads",
        pos=layout.pos.numpy(),
        axes=layout.axes().numpy(),
        size=_sizes(layout),
        link=link,
        pose=np.array(pose, dtype=np.float32),
        labels=labels if len(used) > 1 else [],
    )


def _sizes(layout: "TaxelLayout") -> np.ndarray:
    from scipy.spatial import cKDTree

    assert layout.link is not None
    assert layout.patch is not None
    pos, patch = layout.pos.numpy(), layout.patch.numpy()
    size = np.full(len(pos), np.nan, dtype=np.float32)
    for index in np.unique(patch):
        mine = np.flatnonzero(patch == index)
        if len(mine) > 1:
            distance = cKDTree(pos[mine]).query(pos[mine], k=2)[0][:, 1]
            apart = distance[distance > 0]
            size[mine] = np.quantile(apart, _NEAR) if len(apart) else np.nan
    known = size[~np.isnan(size)]
    size[np.isnan(size)] = np.median(known) if len(known) else 0.005
    return size


def _still() -> np.ndarray:
    return np.concatenate([np.eye(3).ravel(), np.zeros(3)])[None].astype(np.float32)
