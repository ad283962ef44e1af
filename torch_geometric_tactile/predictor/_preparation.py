r"""From a reading to the input of a model."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data import Recording, StaticData, StaticDataset, apply_transform
from torch_geometric_tactile.data._column_order import in_column_order
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.predictor._file_options import checked_options, stored_options
from torch_geometric_tactile.predictor._settling import access, apply_once, is_settled
from torch_geometric_tactile.predictor._window_cut import WindowCut, frame_by_frame
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import fit_parts, fitted_parts

ArrayLike = Tensor | np.ndarray | Sequence[Any]


class Preparation:
    r"""What turns a reading into the input of a model: the layout, what all frames share, and the
    transforms.
    """

    def __init__(
        self,
        layout: TaxelLayout,
        shared: StaticData,
        pre_transform: Transform | None = None,
        transform: Transform | None = None,
        num_channels: int | None = None,
        num_joints: int | None = None,
        *,
        window: WindowCut | None = None,
        frame_transform: Transform | None = None,
        read_options: Mapping[str, Any] | None = None,
    ) -> None:
        self.read_options = checked_options(read_options or {})
        self.layout = layout
        self.shared = _only_shared(shared)
        self.pre_transform = copy.deepcopy(pre_transform)
        self.transform = copy.deepcopy(transform)
        self.num_channels = num_channels
        self.num_joints = num_joints
        self.window = window
        self.frame_transform = copy.deepcopy(frame_transform)
        self.session: int | None = None
        of_frames = flat(self.frame_transform)
        parts = [*of_frames, *flat(self.pre_transform), *flat(self.transform)]
        self.fitted = fitted_parts(Compose(parts))
        for part in self.fitted:
            if part.center is None and part.key is None:  # one with a key can be adapted
                raise ValueError(
                    f"'{part}' must be fitted before it is part of a predictor (got none of its "
                    "numbers): call its fit, or train with TactileDataModule"
                )
        self.keys = tuple(dict.fromkeys(part.key for part in self.fitted if part.key is not None))
        reads = {name for part in parts for name in access(part)[0] or ()}
        self.needs_joint = "joint" in reads
        self._constant, self._frame_parts = apply_once(self.shared, of_frames)
        self._parts = parts[len(of_frames) :]
        if not self._frame_parts:  # what they change may be what later parts read
            self._constant, self._parts = apply_once(self._constant, self._parts)

    @property
    def causal(self) -> bool:
        r"""Whether no transform looks at frames to come."""
        parts = [*self._frame_parts, *self._parts]
        return all(getattr(part, "causal", True) for part in parts)

    @property
    def measures_frames(self) -> bool:
        r"""Whether a transform measures the sessions on frames, before windows are cut."""
        return bool(_keyed(self._frame_parts))

    @classmethod
    def of_dataset(cls, dataset: StaticDataset, transform: Transform | None = None) -> Self:
        r"""Returns what a data set does to its readings, and a transform after it."""
        window, frames = WindowCut.of_dataset(dataset), dataset
        while isinstance(frames, FrameView):
            frames = frames.dataset
        sample, frame = (_first_stored(part) for part in (dataset, frames))
        # Results that depend on the layout only are among what the samples share.
        steps = [part for part in flat(frames.pre_transform) if not is_settled(part, frame)]
        joint = frame.joint if "joint" in frame else None
        known: dict[str, Any] = {
            "num_channels": None if steps else frame.num_features,
            "num_joints": 0 if joint is None else joint.size(-1),
            "read_options": stored_options(getattr(frames, "file_options", {})),
        }
        if window is not None:
            known |= {"window": window, "frame_transform": _joined([*steps, frames.transform])}
            steps = [part for part in flat(dataset.pre_transform) if not is_settled(part, sample)]
        last = Compose([*flat(dataset.transform), *flat(transform)])
        return cls(dataset.layout, sample, _joined(steps), last, **known)

    def data(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        session: int | None = None,
        *,
        dtype: torch.dtype = torch.float,
        device: torch.device | None = None,
        num_frames: int | None = None,
    ) -> StaticData:
        r"""Returns readings as data, before any transform.

        Shapes:
            - **reading:** One frame :math:`(N, F)` or many
              :math:`(B, N, F)`; for a model of windows, windows :math:`(B, N, C \cdot T)`.
            - **joint:** Angles in radians :math:`(J,)`, for
              all frames, or :math:`(B, J)`.
        """
        x = _tensor("reading", reading, dtype, device)
        num_taxels = self.layout.num_taxels
        if x.dim() == 2:
            x = x.unsqueeze(0)
        num_frames = self._num_frames(x) if num_frames is None else num_frames
        given = x.size(-1) / num_frames
        if x.dim() != 3 or x.size(1) != num_taxels or self.num_channels not in (None, given):
            channels = self.num_channels or "num_channels"
            channels = channels if self.window is None else f"{channels} * num_frames"
            raise ValueError(
                f"'reading' must have shape ({num_taxels}, {channels}), a frame of layout "
                f"'{self.layout.name}', or (num_frames, {num_taxels}, {channels}) "
                f"(got {tuple(_shape(reading))})"
            )
        data = copy.copy(self._constant)
        data.x = x
        if self.window is not None:
            data.num_frames = num_frames
        if joint is not None and self.num_joints != 0:
            data.joint = self._joint(_tensor("joint", joint, dtype, device), len(x))
        elif self.needs_joint:
            raise ValueError(
                f"'joint' must be given: {self.num_joints or 'the'} joint angles in radians, which "
                "the transform or the model needs (got None)"
            )
        for key in self.keys:
            data[key] = torch.full((len(x),), self._session(session), device=device)
        return data

    def ordered(self, recording: Recording) -> Recording:
        r"""Returns a recording with its columns in the order of those of the training, if their
        names are known.
        """
        recording.check(self.layout)
        return in_column_order(recording, self.read_options)

    def _num_frames(self, x: Tensor) -> int:
        # Of a window, by the number of its channels, which is known from training.
        if self.window is None:
            return 1
        if not self.num_channels:
            return self.window.length
        return max(1, x.size(-1) // self.num_channels)

    def _joint(self, joint: Tensor, num_frames: int) -> Tensor:
        given = tuple(joint.shape)
        if joint.dim() == 1:
            joint = joint.expand(num_frames, -1)
        if (
            joint.dim() != 2
            or len(joint) != num_frames
            or self.num_joints
            not in (
                None,
                joint.size(1),
            )
        ):
            raise ValueError(
                f"'joint' must have shape ({self.num_joints or 'num_joints'},) or ({num_frames}, "
                f"{self.num_joints or 'num_joints'}), angles in radians (got {given})"
            )
        return joint

    def _session(self, session: int | None) -> int:
        session = self.session if session is None else session
        if session is None:
            names = " and ".join(repr(part) for part in self.fitted if part.key is not None)
            raise ValueError(
                f"'session' must be given, or adapt to a new one first: {names} measures each "
                "session by itself; call 'adapt' with some unlabelled readings of this session"
            )
        return session

    def prepared(self, data: StaticData) -> StaticData:
        r"""Applies the transforms to readings."""
        if self._frame_parts:
            data = frame_by_frame(self._frame_parts, data)
        return self.prepared_windows(data)

    def prepared_windows(self, data: StaticData) -> StaticData:
        r"""Applies the transforms of windows to those that :meth:`cut` returned."""
        for part in self._parts:
            data = apply_transform(part, data)
        return data

    def cut(self, frames: StaticData) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of the frames of one recording, before the transforms of windows,
        and the last frame of each :math:`(W,)`.
        """
        assert self.window is not None
        return self.window.cut(self.prepared_frames(frames), self.layout)

    def prepared_frames(self, frames: StaticData) -> StaticData:
        r"""Applies the transforms of frames to those that windows are cut from."""
        for part in self._frame_parts:
            frames = apply_transform(part, frames)
        return frames

    def prepared_samples(self, data: StaticData) -> StaticData:
        r"""Applies :obj:`transform` to samples of a data set."""
        if data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"'data' must have {self.layout.num_taxels} taxels, as layout "
                f"'{self.layout.name}' (got {data.num_nodes})"
            )
        return apply_transform(self.transform, data)

    def adapt(self, data: StaticData) -> int:
        r"""Measures a session that is new, without labels, and returns its number."""
        known = [int(p.key_values.max()) for p in self.fitted if p.key and p.key_values is not None]
        number = 1 + max(known, default=-1)
        for key in self.keys:
            data[key] = torch.full((data.num_samples,), number)
        if self.measures_frames:
            fit_parts(Compose(self._frame_parts), data, adapt=True)
        if not self.measures_frames or _keyed(self._parts):
            if self.measures_frames:
                data, _ = self.cut(data)
                for key in self.keys:
                    data[key] = torch.full((data.num_samples,), number)
            fit_parts(Compose(self._parts), data, adapt=True)
        self.session = number
        return number

    def to(self, device: torch.device) -> None:
        r"""Moves what all frames share to a device."""
        self._constant = self._constant.to(device)


def shared_by_frames(layout: TaxelLayout, adjacency: str | Tensor | None) -> StaticData:
    r"""Returns what all frames of a sensor have in common, without a frame: positions, normals and
    edges, as far as there are some.

    Shapes:
        - **adjacency:** An adjacency of the layout by its name, or edges
          :math:`(2, |\mathcal{E}|)`.
    """
    edges = layout.edge_index(adjacency) if isinstance(adjacency, str) else adjacency
    shared = StaticData(x=torch.zeros(1, layout.num_taxels, 0), pos=layout.pos)
    for key, value in (("normal", layout.normal), ("edge_index", edges)):
        if value is not None:
            shared[key] = value
    return shared


def _keyed(parts: Sequence[Any]) -> list[Any]:
    return [part for part in fitted_parts(Compose(parts)) if part.key is not None]


def _first_stored(dataset: StaticDataset) -> StaticData:
    # The first sample before the transform of its data set.
    stored = copy.copy(dataset)
    stored.transform = None
    return stored.batch([0])


def _joined(parts: Sequence[Any]) -> Compose | None:
    steps = [step for part in parts for step in flat(part)]
    return Compose(steps) if steps else None


def _only_shared(data: StaticData) -> StaticData:
    # One empty frame with what all share; edges first, by which their features are checked.
    schema: dict[str, Any] = data.schema
    out = StaticData(x=torch.zeros(1, data.num_nodes, 0), **schema)
    plain = Tensor | bool | int | float | str  # numbers, such as `num_frames`, are shared
    keys = [key for key, value in data.to_dict().items() if isinstance(value, plain)]
    for key in sorted(keys, key=lambda key: key != "edge_index"):
        if key != "x" and data.is_shared(key):
            out[key] = data[key]
    return out


def _tensor(name: str, value: ArrayLike, dtype: torch.dtype, device: torch.device | None) -> Tensor:
    try:
        if isinstance(value, np.ma.MaskedArray):  # what is masked is missing
            value = np.ma.filled(value.astype(np.result_type(value.dtype, np.float32)), np.nan)
        elif isinstance(value, np.ndarray) and not value.flags.writeable:
            value = value.copy()  # PyTorch has no tensors that cannot be written
        tensor = torch.as_tensor(value).to(device=device, dtype=dtype)
        return tensor.masked_fill(tensor.isinf(), torch.nan)  # no reading: it is missing too
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"'{name}' must be an array of numbers ({error})") from error


def _shape(value: Any) -> Sequence[int]:
    return tuple(value.shape) if hasattr(value, "shape") else np.shape(value)
