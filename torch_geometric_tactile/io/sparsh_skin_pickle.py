r"""The episodes of the Sparsh-skin data set, each a folder with pickled arrays."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._limits import ARRAY_BYTES, is_absurd
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._numpy_pickle import read_numpy_pickle
from torch_geometric_tactile.sensors import allegro_uskin_368

_TOUCH, _JOINTS = Path("xela", "data.pkl"), Path("allegro", "data.pkl")
_NUM_TAXELS, _NUM_JOINTS = 368, 16
# The patches of our layout in the order of the authors' XELA_FLATTEN_ORDER: 3aftc, link_15,
# link_14; 0aftc, link_2, link_1A, link_1B; 1aftc, link_6, link_5A, link_5B; 2aftc, link_10,
# link_9A, link_9B; palm_2, palm_1, palm_3. Which patch of the palm is which is a guess.
_PATCHES = (
    *("thumb_tip", "thumb_2", "thumb_1"),
    *("index_tip", "index_3", "index_2", "index_1"),
    *("middle_tip", "middle_3", "middle_2", "middle_1"),
    *("ring_tip", "ring_3", "ring_2", "ring_1"),
    *("palm_1_index", "palm_1_ring", "palm_2_ring"),
)


def read_sparsh_skin(folder: PathLike, joints: bool = True) -> Recording:
    r"""Reads an episode of the `Sparsh-skin data set
    <https://huggingface.co/datasets/facebook/sparsh-skin-dataset>`_: a folder
    :obj:`SEQUENCE/EPISODE` with the files :obj:`xela/data.pkl`, a list of frames
    :math:`(368, 4)` of seconds and raw counts :math:`x, y, z`, and :obj:`allegro/data.pkl`, a dict
    whose :obj:`"joint_states"` :math:`(T', 33)` are seconds, 16 angles in radians and 16 efforts.
    Other files are not read. The files are pickles, of which **nothing runs**: one that holds
    anything but such arrays is refused.

    Joints are interpolated linearly at the times of the touch; frames before the first or after
    the last of them are left out, and so are frames with the time of the one before.

    **The order of the taxels is partly a guess.** Frames are put into the order of
    :func:`~torch_geometric_tactile.sensors.allegro_uskin_368` patch by patch, by the authors' list
    of patches. Digits and phalanges are right by that list. Which of the three patches of the palm
    is which, and the order of the taxels within any patch, are not known here: both are taken as
    they come (:obj:`palm_2`, :obj:`palm_1`, :obj:`palm_3` as :obj:`palm_1_index`,
    :obj:`palm_1_ring`, :obj:`palm_2_ring`), so that places within a patch may be
    permuted. Check with the URDF of the data set (:obj:`pretraining/urdf`) before you rely on the
    geometry inside a patch or the palm.

    Args:
        folder (str or PathLike): The folder.
        joints (bool): Whether to read the joints, which the recording of the untouched hand
            (:obj:`pretraining/baseline`) does not need.

    Returns:
        Recording: Of 368 taxels with three channels in counts, 16 joint angles, and in :obj:`extra`
        the :obj:`effort` :math:`(T, 16)` as published. The metadata have the nominal :obj:`"rate"`
        of 100 frames a second and, if the folder is a number, :obj:`"object"` (the folder above)
        and :obj:`"episode"`.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a file is damaged, holds other than the above, or would take far more memory
            than it has bytes, times are not in order, a number is not finite, or touch and joints
            have no time in common. The message names the file.

    Examples:
        >>> read_sparsh_skin("pretraining/corn/0")  # doctest: +SKIP
        Recording(num_frames=..., num_taxels=368, num_channels=3, num_joints=16, rate=100, ...)
    """
    folder = Path(folder).absolute()
    time, tactile = _touch(_file(folder, _TOUCH))
    meta: dict[str, Any] = {"sensor": "XELA uSkin", "unit": "count", "rate": 100.0}
    if folder.name.isdecimal():
        meta |= {"object": folder.parent.name, "episode": int(folder.name)}
    if not joints:
        return Recording(time=time, tactile=tactile, meta=meta)
    path = _file(folder, _JOINTS)
    states = _joint_states(path)
    known, values = states[:, 0], states[:, 1:]
    kept = (time >= known[0]) & (time <= known[-1])
    if not kept.any():
        raise ValueError(
            f"'{path}' must have times in common with the touch, {time[0]:g} to {time[-1]:g} s "
            f"(got {known[0]:g} to {known[-1]:g} s)"
        )
    time = time[kept]
    columns = [np.interp(time, known, column) for column in values.T]
    joint, effort = np.split(np.stack(columns, axis=1).astype(np.float32), [_NUM_JOINTS], axis=1)
    return Recording(
        time=time, tactile=tactile[kept], joint=joint, meta=meta, extra={"effort": effort}
    )


def _file(folder: Path, name: Path) -> Path:
    return existing_file(
        folder / name, "put the file of this name of facebook/sparsh-skin-dataset there"
    )


def _touch(path: Path) -> tuple[np.ndarray, np.ndarray]:
    # Times (T,), and readings (T, 368, 3) in the order of the layout.
    frames = read_numpy_pickle(path)
    is_list = isinstance(frames, list) and len(frames) > 0
    need(is_list, f"'{path}' must hold a list of frames, at least one", type(frames).__name__)
    for number, frame in enumerate(frames):
        _of_shape(path, f"frame {number}", frame, (_NUM_TAXELS, 4))
    size = sum(frame.nbytes for frame in frames)
    if is_absurd(size, path.stat().st_size, ARRAY_BYTES, expansion=1):
        raise ValueError(f"'{path}' must not hold its frames many times (got {size} bytes of them)")
    time = np.stack([frame[:, 0] for frame in frames]).astype(np.float64)
    kept = _later(path, time[:, 0])
    together = (time == time[:, :1]).all(axis=1)
    if not together.all():
        raise ValueError(
            f"'{path}' must have one time for all taxels of a frame (got several in frame "
            f"{together.argmin()})"
        )
    tactile = np.stack([frame[:, 1:].astype(np.float32) for frame in frames])
    _check_finite(path, tactile)
    return time[kept, 0], tactile[kept][:, _taxel_order()]


def _joint_states(path: Path) -> np.ndarray:
    # Times, angles and efforts (T', 33).
    content = read_numpy_pickle(path)
    states = content.get("joint_states") if isinstance(content, dict) else None
    count = len(states) if isinstance(states, np.ndarray) and states.ndim else 0
    shape = max(count, 1), 1 + 2 * _NUM_JOINTS
    states = _of_shape(path, "'joint_states'", states, shape).astype(np.float64)
    kept = _later(path, states[:, 0])
    _check_finite(path, states)
    return states[kept]


def _of_shape(path: Path, what: str, array: Any, shape: tuple[int, ...]) -> np.ndarray:
    found = array.shape if isinstance(array, np.ndarray) else type(array).__name__
    need(found == shape, f"'{path}': {what} must be an array of shape {shape}", found)
    return np.asarray(array)


def _later(path: Path, time: np.ndarray) -> np.ndarray:
    # Which rows are later than the one before: the authors' converter lets stamps repeat.
    steps = np.diff(time, prepend=-np.inf)
    wrong = (steps < 0) | ~np.isfinite(time)
    first = int(wrong.argmax())
    need(not wrong.any(), f"'{path}' must have times in order", f"{time[first]} in row {first}")
    return steps > 0


def _check_finite(path: Path, values: np.ndarray) -> None:
    wrong = np.argwhere(~np.isfinite(values))
    where = ", ".join(map(str, wrong[0])) if len(wrong) else ""
    need(not len(wrong), f"'{path}' must hold finite numbers", f"another one at {where}")


@cache
def _taxel_order() -> np.ndarray:
    # Of each taxel of the layout its place in a frame of the authors (368,).
    layout = allegro_uskin_368()
    assert layout.patch is not None
    number = layout.patch.numpy()
    place = [np.flatnonzero(number == layout.patch_names.index(name)) for name in _PATCHES]
    return np.argsort(np.concatenate(place))
