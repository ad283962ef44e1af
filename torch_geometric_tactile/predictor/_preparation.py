r"""From a reading to the input of a model."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data import (
    ContactRule,
    FrameInfo,
    Recording,
    StaticData,
    StaticDataset,
    apply_transform,
    split_frames,
)
from torch_geometric_tactile.data._column_order import in_column_order
from torch_geometric_tactile.data._contact_windows import windows_lacking_contact
from torch_geometric_tactile.data._dataset_info import joined_info
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.predictor._computed_once import access, apply_once, is_computed_once
from torch_geometric_tactile.predictor._readings import (
    ArrayLike,
    as_numbers,
    checked_options,
    joint_rows,
    shape_of,
    stored_options,
)
from torch_geometric_tactile.predictor._session import Session, keyed
from torch_geometric_tactile.predictor._window_cut import WindowCut, frame_by_frame
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import Tare, fitted_parts


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
        info: FrameInfo | None = None,
        contact: ContactRule | None = None,
    ) -> None:
        self.info = FrameInfo() if info is None else info
        self.read_options = checked_options(read_options or {})
        self.layout = layout
        self.shared = _only_shared(shared)
        self.pre_transform = copy.deepcopy(pre_transform)
        self.transform = copy.deepcopy(transform)
        self.num_channels = num_channels
        self.num_joints = num_joints
        self.contact = contact
        self.window = window
        self.frame_transform = copy.deepcopy(frame_transform)
        self.dtype = torch.float
        self.device: torch.device | None = None
        of_frames = flat(self.frame_transform)
        parts = [*of_frames, *flat(self.pre_transform), *flat(self.transform)]
        self.fitted = fitted_parts(Compose(parts))
        for part in self.fitted:
            if part.center is None and part.key is None:  # one with a key can be adapted
                raise ValueError(
                    f"'{part}' must be fitted before it is part of a predictor (got none of its "
                    "numbers): call its fit, or train with TactileDataModule"
                )
        self.session = Session(self)
        reads = {name for part in parts for name in access(part)[0] or ()}
        self.needs_joint = "joint" in reads
        self.constant, self.frame_parts = apply_once(self.shared, of_frames)
        self.last_parts = parts[len(of_frames) :]
        if not self.frame_parts:  # what they change may be what later parts read
            self.constant, self.last_parts = apply_once(self.constant, self.last_parts)

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that tells frames and windows without contact, :obj:`None` if there is none."""
        return self._contact

    @contact.setter
    def contact(self, rule: ContactRule | None) -> None:
        if rule is not None:
            need(isinstance(rule, ContactRule), "'contact' must be a ContactRule or None", rule)
            given = None if rule.rest is None else rule.rest.shape
            channels = self.num_channels or "num_channels"
            if given is not None and (
                given[0] != self.layout.num_taxels or self.num_channels not in (None, given[1])
            ):
                raise ValueError(
                    f"'rest' of the contact rule must have shape ({self.layout.num_taxels}, "
                    f"{channels}), as the readings (got {given})"
                )
        self._contact = rule

    def lacks_contact(self, reading: ArrayLike) -> Tensor:
        r"""Returns which frames or windows lack contact, by the rule :obj:`contact`; none of them
        without one.

        Args:
            reading (torch.Tensor or numpy.ndarray): As for a call.

        Shapes:
            - **output:** :math:`(B,)`

        Raises:
            ValueError: If the rule has no readings at rest, or those have another shape.
        """
        x = as_numbers("reading", reading, torch.float, None)
        x = x.unsqueeze(0) if x.dim() == 2 else x
        if self.contact is None:
            return torch.zeros(len(x), dtype=torch.bool)
        num_frames = self._num_frames(x)
        frames = split_frames(x, num_frames).transpose(1, 2).flatten(0, 1)  # (B * T, N, C)
        start = num_frames * np.arange(len(x))
        tactile = frames.cpu().numpy()
        out = windows_lacking_contact(self.contact, tactile, start, start + num_frames)
        return torch.from_numpy(out)

    def windows_lacking_contact(self, recording: Recording, last: Tensor) -> Tensor:
        r"""Returns which windows of a recording lack contact, by the rule :obj:`contact`.

        Args:
            recording (Recording): What :meth:`matched` returned.
            last (torch.Tensor): The last frame of each window :math:`(W,)`.

        Shapes:
            - **output:** :math:`(W,)`
        """
        assert self.window is not None
        if self.contact is None:
            return torch.zeros(len(last), dtype=torch.bool)
        index = self.info.selected_frames(recording.time, recording.num_frames)
        stop = np.searchsorted(index, last.cpu().numpy()) + 1
        start = np.maximum(stop - self.window.length, 0)
        if self.window.ragged == "pad":  # one window of all frames, however many
            start = np.zeros_like(stop)
        tactile = recording.tactile[index]
        return torch.from_numpy(windows_lacking_contact(self.contact, tactile, start, stop))

    @property
    def parts(self) -> list[Any]:
        r"""The transforms of each reading: those of frames, then those of windows."""
        return [*self.frame_parts, *self.last_parts]

    @property
    def hand(self) -> HandKinematics | None:
        r"""The hand whose joints pose the taxels, if a transform does so."""
        hands = [getattr(part, "kinematics", None) for part in self.parts]
        return next((hand for hand in hands if hand is not None), None)

    @property
    def causal(self) -> bool:
        r"""Whether no transform looks at frames to come."""
        return all(getattr(part, "causal", True) for part in self.parts)

    @property
    def measures_frames(self) -> bool:
        r"""Whether a transform measures the sessions on frames, before windows are cut."""
        return bool(keyed(self.frame_parts))

    @classmethod
    def of_dataset(cls, dataset: StaticDataset, transform: Transform | None = None) -> Self:
        r"""Returns what a data set does to its readings, and a transform after it."""
        window, frames = WindowCut.of_dataset(dataset), dataset
        while isinstance(frames, FrameView):
            frames = frames.dataset
        sample, frame = (_first_stored(part) for part in (dataset, frames))
        # Results that depend on the layout only are among what the samples share.
        steps = [part for part in flat(frames.pre_transform) if not is_computed_once(part, frame)]
        joint = frame.joint if "joint" in frame else None
        known: dict[str, Any] = {
            "num_channels": None if steps else frame.num_features,
            "num_joints": 0 if joint is None else joint.size(-1),
            "read_options": stored_options(getattr(frames, "file_options", {})),
        }
        if window is not None:
            known |= {"window": window, "frame_transform": _joined([*steps, frames.transform])}
            steps = [
                part for part in flat(dataset.pre_transform) if not is_computed_once(part, sample)
            ]
        last = Compose([*flat(dataset.transform), *flat(transform)])
        known["info"] = joined_info(dataset)
        preparation = cls(dataset.layout, sample, _joined(steps), last, **known)
        preparation.info = preparation.info.changed(rest=preparation.session.rest_seconds())
        return preparation

    def data(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        session: int | None = None,
        *,
        num_frames: int | None = None,
    ) -> StaticData:
        r"""Returns readings as data, before any transform.

        Shapes:
            - **reading:** One frame :math:`(N, F)` or many
              :math:`(B, N, F)`; for a model of windows, windows :math:`(B, N, C \cdot T)`.
            - **joint:** Angles in radians :math:`(J,)`, for
              all frames, or :math:`(B, J)`.
        """
        x = as_numbers("reading", reading, self.dtype, self.device)
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
                f"(got {shape_of(reading)})"
            )
        data = copy.copy(self.constant)
        data.x = x
        if self.window is not None:
            data.num_frames = num_frames
        if joint is not None and self.num_joints != 0:
            angles = as_numbers("joint", joint, self.dtype, self.device)
            data.joint = joint_rows(angles, len(x), self.num_joints)
        elif self.needs_joint:
            raise ValueError(
                f"'joint' must be given: {self.num_joints or 'the'} joint angles in radians, which "
                "the transform or the model needs (got None)"
            )
        self.session.mark(data, session)
        return data

    def frames(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns frames as data, before any transform, also where the model takes windows."""
        data = self.data(reading, joint, session, num_frames=1)
        if self.window is not None:
            del data.num_frames
        return data

    @property
    def columns(self) -> dict[str, list[str]]:
        r"""The names of the columns of readings and angles in their order, if they are known."""
        known = {**self.info.columns, **self.read_options}
        return {key: list(known[key]) for key in ("tactile", "joint") if key in known}

    @property
    def needs_rate(self) -> bool:
        r"""Whether the rate of a recording matters: for windows, and for whole trials that are not
        resampled to one length.
        """
        return self.window is not None and not (self.window.is_trial and not self.causal)

    def matched(self, recording: Recording, *, resample: bool = False) -> Recording:
        r"""Returns a recording with frames as those of the training: its columns in their order, if
        the names are known.

        Args:
            recording (Recording): The recording.
            resample (bool): Whether to resample it, if it has another rate.

        Raises:
            ValueError: If it has other taxels, another unit or other names of columns, or another
                rate where that matters.
        """
        recording.check(self.layout)
        info, known = recording.info, self.info
        differs = resample and known.rate_differs(info.rate, info.tolerance)
        if known.resampled or (differs and self.needs_rate):
            recording = recording.resample(known.selected_rate or known.rate or 0.0)
            info = recording.info
        known.require(info, "a recording", with_rate=self.needs_rate)
        return in_column_order(recording, self.columns)

    def _num_frames(self, x: Tensor) -> int:
        # Of a window, by the number of its channels, which is known from training.
        if self.window is None:
            return 1
        if not self.num_channels:
            return self.window.length
        return max(1, x.size(-1) // self.num_channels)

    def prepare(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns readings as the model takes them, after all transforms.

        Args:
            reading (torch.Tensor or numpy.ndarray): As for a call.
            joint (torch.Tensor or numpy.ndarray, optional): As for a call.
            session (int, optional): As for a call.
        """
        data = self.data(reading, joint, session)
        if self.frame_parts:
            data = frame_by_frame(self.frame_parts, data)
        return self.prepared_windows(data)

    def prepare_samples(self, data: StaticData) -> StaticData:
        r"""Returns samples of a data set as the model takes them.

        Args:
            data (StaticData): The samples, after the :obj:`pre_transform` of the data set and
                before its :obj:`transform`.
        """
        if data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"'data' must have {self.layout.num_taxels} taxels, as layout "
                f"'{self.layout.name}' (got {data.num_nodes})"
            )
        return apply_transform(self.transform, data)

    def prepare_frame(self, reading: ArrayLike, joint: ArrayLike | None = None) -> StaticData:
        r"""Returns one frame of a stream as the model takes it, or for a model of windows as these
        are cut from: after the transforms of frames only.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(N, C)`.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
        """
        frame = self.prepared_frames(self.frames(reading, joint))
        return self.prepared_windows(frame) if self.window is None else frame

    def prepare_window(self, frame: StaticData, window: Tensor) -> StaticData:
        r"""Returns a window of a stream as the model takes it.

        Args:
            frame (StaticData): What :meth:`prepare_frame` returned for its last frame.
            window (torch.Tensor): The readings of such frames :math:`(N, C \cdot T)`, in the order
                of :func:`~torch_geometric_tactile.data.join_frames`.
        """
        assert self.window is not None
        data = copy.copy(frame)
        data.x = window.unsqueeze(0)
        data.num_frames = self.window.length
        return self.prepared_windows(data)

    def prepared_windows(self, data: StaticData) -> StaticData:
        r"""Applies the transforms of windows to those that :meth:`windows` returned."""
        for part in self.last_parts:
            data = apply_transform(part, data)
        return data

    def prepared_frames(self, frames: StaticData) -> StaticData:
        r"""Applies the transforms of frames to those that windows are cut from."""
        for part in self.frame_parts:
            frames = apply_transform(part, frames)
        return frames

    def windows(self, recording: Recording, *, resample: bool = False) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording, thinned and cut as in training and before the
        transforms of windows, and the last frame of each :math:`(W,)`.

        Args:
            recording (Recording): The recording.
            resample (bool): Whether to resample a recording of another rate, of which the frames
                are then those of
                :meth:`Recording.resample <torch_geometric_tactile.data.Recording.resample>`.

        Raises:
            ValueError: If the model takes single frames, or as of a call.
        """
        if self.window is None:
            raise ValueError("this predictor takes single frames, not windows: call 'recording'")
        return self.matched_windows(self.matched(recording, resample=resample))

    def matched_windows(self, recording: Recording) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording that :meth:`matched` returned, as of
        :meth:`windows`.
        """
        # A session is the same for all frames, and may be adapted to with these windows, unless it
        # is measured on the frames.
        unknown = self.session.number is None and not self.measures_frames
        frames = self.frames(recording.tactile, recording.joint, -1 if unknown else None)
        frames.time = torch.as_tensor(recording.time.copy())
        return self.cut(frames)

    def cut(self, frames: StaticData) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of the frames of one recording, before the transforms of windows,
        and the last frame of each :math:`(W,)`.
        """
        assert self.window is not None
        frames, index, part = self.thinned(frames)
        windows, last = self.window.cut(self.prepared_frames(frames), self.layout, part)
        return windows, index[last]

    def thinned(self, frames: StaticData) -> tuple[StaticData, Tensor, Tensor]:
        r"""Returns those frames of one recording that training used of each, their indices, and the
        number of the continuous part of each.

        Shapes:
            - **output:** indices and numbers :math:`(K,)`
        """
        count, value = frames.num_samples, frames.get("time")
        time = None if value is None else value.cpu().double().numpy()
        index = self.info.selected_frames(time, count)
        part = torch.from_numpy(self.info.part_numbers(time, count)[index])
        if len(index) == count:
            return frames, torch.arange(count), part
        return frames.index_select(torch.from_numpy(index)), torch.from_numpy(index), part

    def facts(self) -> dict[str, Any]:
        r"""Returns what live use must know of the readings, as JSON values."""
        parts = self.session.parts
        return {
            "layout": self.layout.name,
            "layout_content": self.layout.to_dict(),
            "num_taxels": self.layout.num_taxels,
            "num_channels": self.num_channels,
            "num_joints": (self.num_joints or None) if self.needs_joint else 0,
            "window": None if self.window is None else self.window.to_dict(),
            "frames": self.info.changed(columns=self.columns).to_dict(),
            "needs_rate": self.needs_rate,
            "rest": {"transform": repr(parts[0])} if parts else None,
            "contact": None if self.contact is None else self.contact.to_dict(),
        }

    def to(self, device: torch.device, dtype: torch.dtype) -> None:
        r"""Moves what all frames share to a device, and takes readings in a precision."""
        self.device, self.dtype = device, dtype
        self.constant = self.constant.to(device)


def tared(preparation: Preparation) -> Preparation:
    r"""Returns a preparation that subtracts the rest before all that another one does."""
    measuring = preparation.session.parts
    if measuring:
        raise ValueError(f"the predictor measures the rest already, by {measuring[0]!r}")
    if flat(preparation.frame_transform):
        raise ValueError(
            "the rest must be subtracted before all other transforms, and frames go through "
            f"{preparation.frame_transform!r} before they are cut to windows"
        )
    return Preparation(
        preparation.layout,
        preparation.shared,
        Compose([Tare(), *flat(preparation.pre_transform)]),
        preparation.transform,
        preparation.num_channels,
        preparation.num_joints,
        window=preparation.window,
        read_options=preparation.read_options,
        info=preparation.info,
        contact=preparation.contact,
    )


def with_shared(preparation: Preparation, **shared: Tensor) -> Preparation:
    r"""Returns a preparation whose frames share further attributes, unless they have them.

    Shapes:
        - **shared:** The same for all frames, such as edges :math:`(2, |\mathcal{E}|)`.
    """
    known = copy.copy(preparation.shared)
    for key, value in shared.items():
        if known.get(key) is None:
            known[key] = value
    return Preparation(
        preparation.layout,
        known,
        preparation.pre_transform,
        preparation.transform,
        preparation.num_channels,
        preparation.num_joints,
        window=preparation.window,
        frame_transform=preparation.frame_transform,
        read_options=preparation.read_options,
        info=preparation.info,
        contact=preparation.contact,
    )


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
