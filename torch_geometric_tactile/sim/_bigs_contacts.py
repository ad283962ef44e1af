r"""Forces and sliding at the fingertips, kept tick by tick and worked out at the end."""

from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.sim._bigs_scene import FINGERS


class FingertipContacts(NamedTuple):
    r"""Forces, places and sliding velocities in the frames of the fingertips :math:`(K, 3, 3)`, and
    the parts of the force along the normal and in the plane of contact :math:`(K, 3)`.
    """

    force: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    place: np.ndarray
    slide: np.ndarray


class ContactLog:
    r"""Keeps the contacts of fingertips and object while a simulation runs."""

    def __init__(self, model: Any) -> None:
        self._finger = np.full(model.ngeom, -1)
        self._finger[[model.geom(f"skin_{name}").id for name in FINGERS]] = range(3)
        self._site = np.array([model.site(f"tip_{name}").id for name in FINGERS])
        # Object first, then fingertips; MuJoCo gives velocities at the centre of mass of the tree.
        names = ["object", *(f"tip_{name}" for name in FINGERS)]
        self._body = np.array([model.body(name).id for name in names])
        self._tree = np.array([model.body("object").id, model.body("hand").id])
        self._contacts: list[tuple[np.ndarray, ...]] = []
        self._ticks: list[tuple[np.ndarray, ...]] = []

    def add(self, data: Any) -> np.ndarray:
        r"""Keeps the contacts of now, and returns the normal force of each finger in newtons."""
        normal = np.zeros(3)
        self._ticks.append(
            (
                data.site_xmat[self._site],
                data.site_xpos[self._site],
                data.cvel[self._body],
                data.subtree_com[self._tree],
            )
        )
        if data.ncon:
            contact = data.contact
            address = contact.efc_address
            finger = self._finger[contact.geom]  # of both sides
            mine = np.flatnonzero((finger.max(axis=1) >= 0) & (address >= 0))
            if len(mine):
                local = data.efc_force[address[mine, None] + np.arange(3)]
                tick = np.full(len(mine), len(self._ticks) - 1)
                frame, pos = contact.frame[mine], contact.pos[mine]
                self._contacts.append((tick, finger[mine], local, frame, pos))
                np.add.at(normal, finger[mine].max(axis=1), local[:, 0])
        return normal

    def finish(self) -> FingertipContacts:
        r"""Returns what was kept."""
        num_ticks = len(self._ticks)
        force, place, slide = np.zeros((3, num_ticks, 3, 3))
        normal, shear = np.zeros((2, num_ticks, 3))
        result = FingertipContacts(force, normal, shear, place, slide)
        if not self._contacts:
            return result
        tick, fingers, local, frame, pos = map(np.concatenate, zip(*self._contacts, strict=True))
        turn, origin, velocity, centre = map(np.array, zip(*self._ticks, strict=True))
        finger = fingers.max(axis=1)
        sign = np.where(fingers[:, 0] >= 0, -1.0, 1.0)  # the frame points from first to second
        frame = frame.reshape(-1, 3, 3)
        turn = turn.reshape(-1, 3, 3, 3)[tick, finger]
        at = (tick, finger)
        world = sign[:, None] * np.einsum("ca,cai->ci", local, frame)
        np.add.at(force, at, np.einsum("ci,cia->ca", world, turn))
        np.add.at(normal, at, local[:, 0])
        np.add.at(shear, at, np.hypot(local[:, 1], local[:, 2]))
        place[at] = np.einsum("ci,cia->ca", pos - origin[at], turn)

        def speed(body: Any, tree: int) -> np.ndarray:
            twist = velocity[tick, body]
            return np.asarray(twist[:, 3:] + np.cross(twist[:, :3], pos - centre[tick, tree]))

        relative = speed(0, 0) - speed(1 + finger, 1)
        out = frame[:, 0]
        relative -= out * (out * relative).sum(axis=1, keepdims=True)
        slide[at] = np.einsum("ci,cia->ca", relative, turn)
        return result
