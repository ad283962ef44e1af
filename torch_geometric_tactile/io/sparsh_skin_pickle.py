r"""Reader of the episodes of the Sparsh-skin data set, which are folders with pickled arrays."""

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
# The patches of `allegro_uskin_368` in the order of the authors' XELA_FLATTEN_ORDER: 3aftc,
# link_15, link_14; 0aftc, link_2, link_1A, link_1B; 1aftc, link_6, link_5A, link_5B; 2aftc,
# link_10, link_9A, link_9B; palm_2, palm_1, palm_3. The assignment within the palm is a guess.
_PATCHES = (
    *("thumb_tip", "thumb_2", "thumb_1"),
    *("index_tip", "index_3", "index_2", "index_1"),
    *("middle_tip", "middle_3", "middle_2", "middle_1"),
    *("ring_tip", "ring_3", "ring_2", "ring_1"),
    *("palm_1_index", "palm_1_ring", "palm_2_ring"),
)


def read_sparsh_skin(folder: PathLike, joints: bool = True) -> Recording:
    r"""Reads an episode of the `Sparsh-skin data set
    <https://huggingface.co/datasets/facebook/sparsh-skin-dataset>`_. An episode is a folder
    :obj:`SEQUENCE/EPISODE` with two files:

    * :obj:`xela/data.pkl`: a list of frames :math:`(368, 4)` of seconds and raw counts
      :math:`x, y, z`;
    * :obj:`allegro/data.pkl`: a dict whose :obj:`"joint_states"` :math:`(T', 33)` are seconds, 16
      angles in radians and 16 efforts.

    Other files are not read. The files are pickles, but **no code in them is run**: a file with
    anything except such arrays is an error.

    Joints are interpolated linearly at the times of the touch. Frames before the first or after the
    last joint state are left out, as are frames with the same time as the previous frame.

    **The order of the taxels is partly a guess.** Frames are reordered to
    :func:`~torch_geometric_tactile.sensors.allegro_uskin_368` patch by patch, by the authors' list
    of patches. This list determines digits and phalanges. The assignment of the three patches of
    the palm and the order of the taxels within a patch are unknown. Both follow the order of the
    files (:obj:`palm_2`, :obj:`palm_1`, :obj:`palm_3` as :obj:`palm_1_index`,
    :obj:`palm_1_ring`, :obj:`palm_2_ring`), so positions within a patch may be permuted. Check
    with the URDF of the data set (:obj:`pretraining/urdf`) before you rely on the geometry within a
    patch or the palm.

    Args:
        folder (str or PathLike): The folder.
        joints (bool): Whether to read the joints, which the recording of the untouched hand
            (:obj:`pretraining/baseline`) does not need.

    Returns:
        Recording: 368 taxels with three channels in counts, and 16 joint angles. :obj:`extra` holds
        the :obj:`effort` :math:`(T, 16)` as published. The metadata have the nominal :obj:`"rate"`
        of 100 frames per second and, if the folder is a number, :obj:`"object"` (the parent folder)
        and :obj:`"episode"`.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a file is damaged, holds other content, or would take far more memory than
            its size, if times are not in order, a number is not finite, or touch and joints do not
            overlap in time. The message names the file.

    Examples:
        >>> read_sparsh_skin("pretraining/corn/0")  # doctest: +SKIP
        Recording(num_frames=..., num_taxels=368, num_channels=3, num_joints=16, rate=100, ...)
    """
    folder = Path(folder).absolute()
    time, tactile = _read_touch(_find_file(folder, _TOUCH))
    meta: dict[str, Any] = {"sensor": "XELA uSkin", "unit": "count", "rate": 100.0}
    if folder.name.isdecimal():
        meta |= {"object": folder.parent.name, "episode": int(folder.name)}
    if not joints:
        return Recording(time=time, tactile=tactile, meta=meta)
    path = _find_file(folder, _JOINTS)
    states = _read_joint_states(path)
    joint_time, values = states[:, 0], states[:, 1:]
    has_joints = (time >= joint_time[0]) & (time <= joint_time[-1])
    if not has_joints.any():
        raise ValueError(
            f"'{path}' must overlap in time with the touch, {time[0]:g} to {time[-1]:g} s "
            f"(got {joint_time[0]:g} to {joint_time[-1]:g} s)"
        )
    time = time[has_joints]
    columns = [np.interp(time, joint_time, column) for column in values.T]
    joint, effort = np.split(np.stack(columns, axis=1).astype(np.float32), [_NUM_JOINTS], axis=1)
    return Recording(
        time=time, tactile=tactile[has_joints], joint=joint, meta=meta, extra={"effort": effort}
    )


def _find_file(folder: Path, name: Path) -> Path:
    return existing_file(
        folder / name, "put the file with this name from facebook/sparsh-skin-dataset there"
    )


def _read_touch(path: Path) -> tuple[np.ndarray, np.ndarray]:
    # Returns times (T,) and readings (T, 368, 3) in the order of the layout.
    frames = read_numpy_pickle(path)
    is_list = isinstance(frames, list) and len(frames) > 0
    need(is_list, f"'{path}' must hold a list of at least one frame", type(frames).__name__)
    for number, frame in enumerate(frames):
        _check_shape(path, f"frame {number}", frame, (_NUM_TAXELS, 4))
    size = sum(frame.nbytes for frame in frames)
    if is_absurd(size, path.stat().st_size, ARRAY_BYTES, expansion=1):
        raise ValueError(f"'{path}' must not repeat its frames (got {size} bytes in memory)")
    time = np.stack([frame[:, 0] for frame in frames]).astype(np.float64)
    is_later = _is_later(path, time[:, 0])
    is_simultaneous = (time == time[:, :1]).all(axis=1)
    if not is_simultaneous.all():
        raise ValueError(
            f"'{path}' must have the same time for all taxels of a frame (got several in frame "
            f"{is_simultaneous.argmin()})"
        )
    tactile = np.stack([frame[:, 1:].astype(np.float32) for frame in frames])
    _check_finite(path, tactile)
    return time[is_later, 0], tactile[is_later][:, _taxel_order()]


def _read_joint_states(path: Path) -> np.ndarray:
    # Returns times, angles and efforts (T', 33).
    content = read_numpy_pickle(path)
    states = content.get("joint_states") if isinstance(content, dict) else None
    num_states = len(states) if isinstance(states, np.ndarray) and states.ndim else 0
    shape = max(num_states, 1), 1 + 2 * _NUM_JOINTS
    states = _check_shape(path, "'joint_states'", states, shape).astype(np.float64)
    is_later = _is_later(path, states[:, 0])
    _check_finite(path, states)
    return states[is_later]


def _check_shape(path: Path, noun: str, array: Any, shape: tuple[int, ...]) -> np.ndarray:
    actual_shape = array.shape if isinstance(array, np.ndarray) else type(array).__name__
    need(actual_shape == shape, f"'{path}': {noun} must be an array of shape {shape}", actual_shape)
    return np.asarray(array)


def _is_later(path: Path, time: np.ndarray) -> np.ndarray:
    # Whether each row is later than the previous one: timestamps in the files may repeat.
    steps = np.diff(time, prepend=-np.inf)
    is_invalid = (steps < 0) | ~np.isfinite(time)
    first_invalid = int(is_invalid.argmax())
    need(
        not is_invalid.any(),
        f"'{path}' must have times in order",
        f"{time[first_invalid]} in row {first_invalid}",
    )
    return steps > 0


def _check_finite(path: Path, values: np.ndarray) -> None:
    invalid = np.argwhere(~np.isfinite(values))
    where = ", ".join(map(str, invalid[0])) if len(invalid) else ""
    need(
        not len(invalid),
        f"'{path}' must hold finite numbers",
        f"an infinite number or NaN at {where}",
    )


@cache
def _taxel_order() -> np.ndarray:
    # For each taxel of the layout, its index in a frame of the files (368,).
    layout = allegro_uskin_368()
    assert layout.patch is not None
    patch_of_taxel = layout.patch.numpy()
    layout_indices = [
        np.flatnonzero(patch_of_taxel == layout.patch_names.index(name)) for name in _PATCHES
    ]
    return np.argsort(np.concatenate(layout_indices))
