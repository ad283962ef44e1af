r"""The preparation of raw readings as input of a model, and its calibration to a session."""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from torch_geometric_tactile.predictor._constant_transforms import (
    apply_constant_transforms,
    attribute_access,
    is_precomputed,
)
from torch_geometric_tactile.predictor._file_names import FileNameForm
from torch_geometric_tactile.predictor._readings import (
    ArrayLike,
    array_shape,
    check_read_options,
    joint_rows,
    select_read_options,
    to_float_tensor,
)
from torch_geometric_tactile.predictor._window_cut import WindowCut, apply_to_frames
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import (
    FittedTransform,
    Tare,
    fit_parts,
)
from torch_geometric_tactile.transforms.fitting import fitted_parts


class Preparation:
    r"""The preparation of raw readings as input of a model: the layout, the attributes that all
    frames share, and the transforms.

    Args:
        layout (TaxelLayout): The taxels.
        shared (StaticData): Attributes that all frames share, such as positions and edges.
        pre_transform (callable, optional): Transform that is applied to each reading first.
        transform (callable, optional): Transform that is applied after :obj:`pre_transform`.
        num_channels (int, optional): Number of channels per taxel. Not checked if left out.
        num_joints (int, optional): Number of joint angles per frame. Not checked if left out.
        window (WindowCut, optional): Settings of windows, for a model that reads windows.
        frame_transform (callable, optional): Transform of single frames, before windows are cut.
        read_options (Mapping, optional): Options with which recordings are read.
        info (FrameInfo, optional): Unit, columns, rate and thinning of the training frames.
        contact (ContactRule, optional): The rule that detects frames without contact.
        file_names (FileNameForm, optional): The form of the file names in the training set, if they
            contain the class.

    Raises:
        ValueError: If a transform is not fitted.
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
        file_names: FileNameForm | None = None,
    ) -> None:
        self.file_names = file_names
        self.info = FrameInfo() if info is None else info
        self.read_options = check_read_options(read_options or {})
        self.layout = layout
        self.shared = _select_shared(shared)
        self.pre_transform = copy.deepcopy(pre_transform)
        self.transform = copy.deepcopy(transform)
        self.num_channels = num_channels
        self.num_joints = num_joints
        self.contact = contact
        self.window = window
        self.frame_transform = copy.deepcopy(frame_transform)
        self.dtype = torch.float
        self.device: torch.device | None = None
        frame_steps = flat(self.frame_transform)
        parts = [*frame_steps, *flat(self.pre_transform), *flat(self.transform)]
        self.fitted = fitted_parts(Compose(parts))
        for part in self.fitted:
            if part.center is None and part.key is None:  # with a key, `adapt` fits it
                raise ValueError(
                    f"'{part}' must be fitted before it is part of a predictor (got no fitted "
                    "values): call its method 'fit', or train with TactileDataModule"
                )
        self.session = Session(self)
        reads = {name for part in parts for name in attribute_access(part)[0] or ()}
        self.needs_joint = "joint" in reads
        self.constant, self.frame_transforms = apply_constant_transforms(self.shared, frame_steps)
        self.sample_transforms = parts[len(frame_steps) :]
        # Per-frame transforms may change attributes that transforms of samples read.
        if not self.frame_transforms:
            self.constant, self.sample_transforms = apply_constant_transforms(
                self.constant, self.sample_transforms
            )

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that detects frames and windows without contact, or :obj:`None`."""
        return self._contact

    @contact.setter
    def contact(self, rule: ContactRule | None) -> None:
        if rule is not None:
            need(isinstance(rule, ContactRule), "'contact' must be a ContactRule or None", rule)
            rest_shape = None if rule.rest is None else rule.rest.shape
            expected_channels = self.num_channels or "num_channels"
            if rest_shape is not None and (
                rest_shape[0] != self.layout.num_taxels
                or self.num_channels not in (None, rest_shape[1])
            ):
                raise ValueError(
                    f"'rest' of the contact rule must have shape ({self.layout.num_taxels}, "
                    f"{expected_channels}), like the readings (got {rest_shape})"
                )
        self._contact = rule

    def lacks_contact(self, reading: ArrayLike) -> Tensor:
        r"""Returns a mask of the frames or windows without contact, by the rule :obj:`contact`.
        Without a rule, all of them have contact.

        Args:
            reading (torch.Tensor or numpy.ndarray): Readings, as for :meth:`prepare`.

        Shapes:
            - **output:** :math:`(B,)`

        Raises:
            ValueError: If the rule has no readings at rest, or their shape differs.
        """
        x = to_float_tensor("reading", reading, torch.float, None)
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
        r"""Returns a mask of the windows of a recording without contact.

        Args:
            recording (Recording): A recording from :meth:`match_recording`.
            last (torch.Tensor): Index of the last frame of each window :math:`(W,)`.

        Shapes:
            - **output:** :math:`(W,)`
        """
        assert self.window is not None
        if self.contact is None:
            return torch.zeros(len(last), dtype=torch.bool)
        index = self.info.selected_frames(recording.time, recording.num_frames)
        stop = np.searchsorted(index, last.cpu().numpy()) + 1
        start = np.maximum(stop - self.window.length, 0)
        if self.window.ragged == "pad":  # a single window that contains all frames
            start = np.zeros_like(stop)
        tactile = recording.tactile[index]
        return torch.from_numpy(windows_lacking_contact(self.contact, tactile, start, stop))

    @property
    def transforms(self) -> list[Any]:
        r"""The transforms of each reading: first the transforms of single frames, then the
        transforms of samples.
        """
        return [*self.frame_transforms, *self.sample_transforms]

    @property
    def hand(self) -> HandKinematics | None:
        r"""The hand kinematics of the transform that poses the taxels, or :obj:`None`."""
        hands = [getattr(part, "kinematics", None) for part in self.transforms]
        return next((hand for hand in hands if hand is not None), None)

    @property
    def causal(self) -> bool:
        r"""Whether no transform uses later frames."""
        return all(getattr(part, "causal", True) for part in self.transforms)

    @property
    def measures_frames(self) -> bool:
        r"""Whether a transform measures sessions on single frames, before windows are cut."""
        return bool(session_transforms(self.frame_transforms))

    @classmethod
    def from_dataset(cls, dataset: StaticDataset, transform: Transform | None = None) -> Self:
        r"""Returns the preparation that a data set applies to its readings.

        Args:
            dataset (StaticDataset): The data set.
            transform (callable, optional): Transform that is applied after the transforms of the
                data set.
        """
        window, frame_dataset = WindowCut.from_dataset(dataset), dataset
        while isinstance(frame_dataset, FrameView):
            frame_dataset = frame_dataset.dataset
        stored_sample, stored_frame = (
            _first_stored_sample(part) for part in (dataset, frame_dataset)
        )
        # Transforms that depend only on the layout need not run again: samples share their output.
        steps = [
            part
            for part in flat(frame_dataset.pre_transform)
            if not is_precomputed(part, stored_frame)
        ]
        joint = stored_frame.joint if "joint" in stored_frame else None
        arguments: dict[str, Any] = {
            "num_channels": None if steps else stored_frame.num_features,
            "num_joints": 0 if joint is None else joint.size(-1),
            "read_options": select_read_options(getattr(frame_dataset, "file_options", {})),
            "file_names": FileNameForm.from_dataset(frame_dataset),
        }
        if window is not None:
            arguments |= {
                "window": window,
                "frame_transform": _compose([*steps, frame_dataset.transform]),
            }
            steps = [
                part
                for part in flat(dataset.pre_transform)
                if not is_precomputed(part, stored_sample)
            ]
        transforms = Compose([*flat(dataset.transform), *flat(transform)])
        arguments["info"] = joined_info(dataset)
        preparation = cls(dataset.layout, stored_sample, _compose(steps), transforms, **arguments)
        preparation.info = preparation.info.changed(rest=preparation.session.rest_seconds())
        return preparation

    def readings_to_data(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        session: int | None = None,
        *,
        num_frames: int | None = None,
    ) -> StaticData:
        r"""Returns readings as data, before any transform.

        Shapes:
            - **reading:** One frame :math:`(N, F)` or several frames :math:`(B, N, F)`; for a model
              that reads windows, windows :math:`(B, N, C \cdot T)`.
            - **joint:** Angles in radians, one row for all frames :math:`(J,)` or one row per frame
              :math:`(B, J)`.
        """
        x = to_float_tensor("reading", reading, self.dtype, self.device)
        num_taxels = self.layout.num_taxels
        if x.dim() == 2:
            x = x.unsqueeze(0)
        num_frames = self._num_frames(x) if num_frames is None else num_frames
        reading_channels = x.size(-1) / num_frames
        if (
            x.dim() != 3
            or x.size(1) != num_taxels
            or self.num_channels not in (None, reading_channels)
        ):
            channels = self.num_channels or "num_channels"
            channels = channels if self.window is None else f"{channels} * num_frames"
            raise ValueError(
                f"'reading' must have shape ({num_taxels}, {channels}), a frame of layout "
                f"'{self.layout.name}', or (num_frames, {num_taxels}, {channels}) "
                f"(got {array_shape(reading)})"
            )
        data = copy.copy(self.constant)
        data.x = x
        if self.window is not None:
            data.num_frames = num_frames
        if joint is not None and self.num_joints != 0:
            angles = to_float_tensor("joint", joint, self.dtype, self.device)
            data.joint = joint_rows(angles, len(x), self.num_joints)
        elif self.needs_joint:
            raise ValueError(
                f"'joint' must be given: {self.num_joints or 'the'} joint angles in radians, "
                "because the transform or the model reads them (got None)"
            )
        self.session.set_session_number(data, session)
        return data

    def frames_to_data(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns single frames as data, before any transform, for models that read frames and for
        models that read windows.
        """
        data = self.readings_to_data(reading, joint, session, num_frames=1)
        if self.window is not None:
            del data.num_frames
        return data

    @property
    def columns(self) -> dict[str, list[str]]:
        r"""The column names of readings and joint angles in order, as far as they are known."""
        stored_columns = {**self.info.columns, **self.read_options}
        return {
            key: list(stored_columns[key]) for key in ("tactile", "joint") if key in stored_columns
        }

    @property
    def needs_rate(self) -> bool:
        r"""Whether a recording must have the frame rate of the training data. This is the case for
        windows, and for trials unless a transform resamples them to one length.
        """
        return self.window is not None and not (self.window.is_trial and not self.causal)

    def match_recording(self, recording: Recording, *, resample: bool = False) -> Recording:
        r"""Returns a recording with the column order of the training data, if the names are known.
        The recording is resampled if the training data was resampled, or if :obj:`resample` is
        :obj:`True` and the frame rate matters.

        Args:
            recording (Recording): The recording.
            resample (bool): Whether to resample a recording with another frame rate.

        Raises:
            ValueError: If the taxels, unit or column names differ from the training data, or, if
                :attr:`needs_rate`, the frame rate.
        """
        recording.check(self.layout)
        info, expected = recording.info, self.info
        must_resample = resample and expected.rate_differs(info.rate, info.tolerance)
        if expected.resampled or (must_resample and self.needs_rate):
            recording = recording.resample(expected.selected_rate or expected.rate or 0.0)
            info = recording.info
        expected.require(info, "a recording", with_rate=self.needs_rate)
        return in_column_order(recording, self.columns)

    def _num_frames(self, x: Tensor) -> int:
        # The number of frames of a window, from its width and the number of channels in training.
        if self.window is None:
            return 1
        if not self.num_channels:
            return self.window.length
        return max(1, x.size(-1) // self.num_channels)

    def prepare(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns readings after all transforms, as in :meth:`Predictor.prepare`."""
        data = self.readings_to_data(reading, joint, session)
        if self.frame_transforms:
            data = apply_to_frames(self.frame_transforms, data)
        return self.apply_sample_transforms(data)

    def prepare_samples(self, data: StaticData) -> StaticData:
        r"""Returns samples of a data set after its :obj:`transform`, as input of the model."""
        if data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"'data' must have {self.layout.num_taxels} taxels, like layout "
                f"'{self.layout.name}' (got {data.num_nodes})"
            )
        return apply_transform(self.transform, data)

    def prepare_frame(self, reading: ArrayLike, joint: ArrayLike | None = None) -> StaticData:
        r"""Returns one frame of a stream as input of the model, or for its windows."""
        frame = self.apply_frame_transforms(self.frames_to_data(reading, joint))
        return self.apply_sample_transforms(frame) if self.window is None else frame

    def prepare_window(self, frame: StaticData, window: Tensor) -> StaticData:
        r"""Returns a window of a stream as input of the model."""
        assert self.window is not None
        data = copy.copy(frame)
        data.x = window.unsqueeze(0)
        data.num_frames = self.window.length
        return self.apply_sample_transforms(data)

    def apply_sample_transforms(self, data: StaticData) -> StaticData:
        r"""Returns samples after the transforms of windows or, for a model that reads frames, of
        frames.
        """
        for part in self.sample_transforms:
            data = apply_transform(part, data)
        return data

    def apply_frame_transforms(self, frames: StaticData) -> StaticData:
        r"""Returns frames after the transforms that are applied before windows are cut."""
        for part in self.frame_transforms:
            frames = apply_transform(part, frames)
        return frames

    def windows(self, recording: Recording, *, resample: bool = False) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording, as in :meth:`Predictor.windows`."""
        if self.window is None:
            raise ValueError("this predictor reads single frames, not windows: call 'recording'")
        return self.cut_recording(self.match_recording(recording, resample=resample))

    def cut_recording(self, recording: Recording) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording that :meth:`match_recording` returned."""
        # The session need not be measured yet: these windows may be meant for `adapt_windows`.
        # If the session is measured on frames, it must be known before windows are cut.
        is_unmeasured = self.session.number is None and not self.measures_frames
        frames = self.frames_to_data(
            recording.tactile, recording.joint, -1 if is_unmeasured else None
        )
        frames.time = torch.as_tensor(recording.time.copy())
        return self.cut_frames(frames)

    def cut_frames(self, frames: StaticData) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of the frames of one recording, before the transforms of windows are
        applied, and the index of the last frame of each window :math:`(W,)`.
        """
        assert self.window is not None
        frames, index, part = self.thin_frames(frames)
        windows, last = self.window.cut(self.apply_frame_transforms(frames), self.layout, part)
        return windows, index[last]

    def thin_frames(self, frames: StaticData) -> tuple[StaticData, Tensor, Tensor]:
        r"""Returns the selected frames of one recording, their indices, and the index of the
        continuous part to which each frame belongs. Frames are selected as in training.

        Shapes:
            - **output:** frames :math:`(K, N, C)`, frame indices and part indices :math:`(K,)`
        """
        num_frames, times = frames.num_samples, frames.get("time")
        time = None if times is None else times.cpu().double().numpy()
        index = self.info.selected_frames(time, num_frames)
        part = torch.from_numpy(self.info.part_numbers(time, num_frames)[index])
        if len(index) == num_frames:
            return frames, torch.arange(num_frames), part
        return frames.index_select(torch.from_numpy(index)), torch.from_numpy(index), part

    def metadata(self) -> dict[str, Any]:
        r"""Returns the layout, shapes and settings of the readings as JSON values, for exported
        models.
        """
        session_parts = self.session.transforms
        return {
            "layout": self.layout.name,
            "layout_content": self.layout.to_dict(),
            "num_taxels": self.layout.num_taxels,
            "num_channels": self.num_channels,
            "num_joints": (self.num_joints or None) if self.needs_joint else 0,
            "window": None if self.window is None else self.window.to_dict(),
            "frames": self.info.changed(columns=self.columns).to_dict(),
            "needs_rate": self.needs_rate,
            "rest": {"transform": repr(session_parts[0])} if session_parts else None,
            "contact": None if self.contact is None else self.contact.to_dict(),
        }

    def to(self, device: torch.device, dtype: torch.dtype) -> None:
        r"""Moves the shared attributes to a device, and sets the precision of readings."""
        self.device, self.dtype = device, dtype
        self.constant = self.constant.to(device)


class Session:
    r"""The transforms that are fitted to each session separately, such as a tare, and the number of
    the session that was measured last.

    Args:
        preparation (Preparation): The preparation to which the session belongs.
    """

    def __init__(self, preparation: Preparation) -> None:
        self._preparation = preparation
        self.transforms = session_transforms(preparation.fitted)
        self.keys = tuple(
            dict.fromkeys(part.key for part in self.transforms if part.key is not None)
        )
        self.number: int | None = None

    @property
    def measures_rest(self) -> bool:
        r"""Whether a tare averages all readings passed to :meth:`adapt`. All of them must then be
        at rest.
        """
        return any(
            isinstance(p, Tare) and p.first is None and p.seconds is None for p in self.transforms
        )

    def set_session_number(self, data: StaticData, number: int | None = None) -> None:
        r"""Sets the session attributes of samples to a session number. The default is the session
        that was measured last.
        """
        if not self.keys:
            return
        number = self.number if number is None else number
        if number is None:
            names = " and ".join(map(repr, self.transforms))
            raise ValueError(
                f"'session' must be given, since {names} measures each session separately (got "
                "None): call 'adapt' first, with some unlabelled readings of this session"
            )
        for key in self.keys:
            data[key] = torch.full((data.num_samples,), number, device=data.x.device)

    def adapt(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> int:
        r"""Measures a new session from some of its readings, as in :meth:`Predictor.adapt`."""
        self._require_session_transform()
        preparation = self._preparation
        if preparation.contact is not None and (self.measures_rest or not self.transforms):
            data = preparation.readings_to_data(reading, joint, -1)
            x = split_frames(data.x, data.get("num_frames", 1))  # (B, N, T, C)
            self._measure_contact(x.transpose(1, 2).flatten(0, 1).cpu().numpy())
        return self._adapt(reading, joint, time)

    def _adapt(self, reading: ArrayLike, joint: ArrayLike | None, time: ArrayLike | None) -> int:
        preparation = self._preparation
        if not self.transforms:
            return 0
        on_frames = preparation.measures_frames
        to_data = preparation.frames_to_data if on_frames else preparation.readings_to_data
        data = to_data(reading, joint, -1)
        if time is not None:
            data.time = torch.as_tensor(time, dtype=torch.double)
        return self._measure(data)

    def adapt_recording(
        self, recording: Recording, *, rest: float | None = None, resample: bool = False
    ) -> int:
        r"""Measures a new session from a recording, as in :meth:`Predictor.adapt_recording`."""
        recording = self._preparation.match_recording(recording, resample=resample)
        if rest is not None:
            num_frames = int((recording.time < recording.time[:1] + rest).sum())
            return self.measure_rest(recording.select(slice(num_frames)))
        self._measure_contact(recording.tactile[recording.time < self._rest_end_time(recording)])
        return self._adapt_matched_frames(recording)

    def _rest_end_time(self, recording: Recording) -> float:
        # The contact rule measures as long as the tare. Without a tare, the end is unknown.
        if self.measures_rest:
            return math.inf
        seconds = self.rest_seconds() if any(isinstance(p, Tare) for p in self.transforms) else None
        contact = self._preparation.contact
        if seconds is None and contact is not None and not contact.is_measured:
            raise ValueError(
                "'rest' must be the number of seconds at the beginning in which nothing touches "
                "the sensor, since the contact rule compares readings with them (got None)"
            )
        return -math.inf if seconds is None else float(recording.time[0]) + seconds

    def _measure_contact(self, frames: np.ndarray) -> None:
        preparation = self._preparation
        if preparation.contact is not None and len(frames):
            preparation.contact = preparation.contact.measured(frames)

    def measure_rest(self, recording: Recording) -> int:
        r"""Measures a new session from a recording at rest, and returns the number of the session.
        The recording must come from :meth:`Preparation.match_recording`. A tare averages all its
        frames.
        """
        self._measure_contact(recording.tactile)
        with _tare_without_limits(self.transforms):
            return self._adapt_matched_frames(recording)

    def _adapt_matched_frames(self, recording: Recording) -> int:
        preparation = self._preparation
        if preparation.window is None or preparation.measures_frames:
            return self._adapt(recording.tactile, recording.joint, recording.time)
        if not self.transforms:
            return 0
        return self.adapt_windows(preparation.cut_recording(recording)[0])

    def rest_seconds(self) -> float | None:
        r"""Returns the time at rest at the start of the training recordings in seconds, from the
        settings of a tare or from the data set. Returns :obj:`None` if it is unknown.
        """
        info, window = self._preparation.info, self._preparation.window
        rate = info.frame_rate
        for part in self.transforms:
            if not isinstance(part, Tare):
                continue
            if part.seconds is not None:
                return float(part.seconds)
            if part.first is not None and rate is not None:
                last = part.first - 1
                if window is not None and not self._preparation.measures_frames:
                    last = last * window.hop + window.length - 1
                # Half a frame later, so that time jitter does not lose the last frame.
                return (last + 0.5) / rate
        return info.rest

    def adapt_windows(self, windows: StaticData) -> int:
        r"""Measures a new session from windows, as in :meth:`Predictor.adapt_windows`."""
        self._require_session_transform()
        if self._preparation.measures_frames:
            raise ValueError(
                "the session must be measured on frames, before windows are cut (got windows): "
                "call 'adapt_recording' in place of 'adapt_windows'"
            )
        return self._measure(windows)

    def _measure(self, data: StaticData) -> int:
        session_numbers = [
            int(part.key_values.max()) for part in self.transforms if part.key_values is not None
        ]
        number, preparation = 1 + max(session_numbers, default=-1), self._preparation
        self.set_session_number(data, number)
        if preparation.window is None or preparation.measures_frames:
            data = preparation.thin_frames(data)[0]
        if preparation.measures_frames:
            fit_parts(Compose(preparation.frame_transforms), data, adapt=True)
            if session_transforms(preparation.sample_transforms):
                data, _ = preparation.cut_frames(data)
                self.set_session_number(data, number)
        if session_transforms(preparation.sample_transforms):
            fit_parts(Compose(preparation.sample_transforms), data, adapt=True)
        self.number = number
        return number

    def _require_session_transform(self) -> None:
        can_measure = self.transforms or self._preparation.contact is not None
        need(can_measure, "no transform of this predictor measures sessions: 'adapt' is not needed")

    def set_rest(self, center: Tensor, scale: Tensor | None = None) -> None:
        r"""Replaces all measured sessions by one session with the given centre and scale.

        Shapes:
            - **center:** Readings at rest :math:`(N, C)`.
            - **scale:** Divisor of the readings :math:`(N, C)`, if a transform scales sessions.
        """
        if len(self.transforms) > 1:
            raise ValueError(
                f"'rest' must be a Rest with frames, since {self.transforms} all measure it (got "
                "one array)"
            )
        (part,) = self.transforms
        if part.center is not None and part.center.shape[1:] != center.shape:
            shape = tuple(part.center.shape[1:])
            raise ValueError(f"'rest' must have shape {shape} (got {tuple(center.shape)})")
        if not part.unit_scale and scale is None:
            raise ValueError(
                "'scale' must be given, since the model scales each session (got None)"
            )
        part.center = center.double().unsqueeze(0)
        part.scale = torch.ones_like(part.center).float()
        if scale is not None and not part.unit_scale:
            part.scale = scale.float().unsqueeze(0)
        part.key_values = torch.zeros(1, dtype=torch.long)
        self.number = 0


def add_tare(preparation: Preparation) -> Preparation:
    r"""Returns a copy of a preparation with :class:`~torch_geometric_tactile.transforms.Tare` as
    its first transform.
    """
    session_parts = preparation.session.transforms
    if session_parts:
        raise ValueError(f"the predictor already measures the rest, by {session_parts[0]!r}")
    if flat(preparation.frame_transform):
        raise ValueError(
            "the rest must be subtracted before all other transforms (got "
            f"{preparation.frame_transform!r}, which is applied before windows are cut)"
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
        file_names=preparation.file_names,
    )


def add_shared_attributes(preparation: Preparation, **shared: Tensor) -> Preparation:
    r"""Returns a copy of a preparation with further attributes that all frames share. Existing
    attributes are not replaced.

    Shapes:
        - **shared:** Any shape, such as edges :math:`(2, |\mathcal{E}|)`.
    """
    attributes = copy.copy(preparation.shared)
    for key, value in shared.items():
        if attributes.get(key) is None:
            attributes[key] = value
    return Preparation(
        preparation.layout,
        attributes,
        preparation.pre_transform,
        preparation.transform,
        preparation.num_channels,
        preparation.num_joints,
        window=preparation.window,
        frame_transform=preparation.frame_transform,
        read_options=preparation.read_options,
        info=preparation.info,
        contact=preparation.contact,
        file_names=preparation.file_names,
    )


def shared_attributes(layout: TaxelLayout, adjacency: str | Tensor | None) -> StaticData:
    r"""Returns the attributes that all frames of a sensor share: positions, and normals and edges
    if there are any. The readings have no channels.

    Shapes:
        - **adjacency:** The name of an adjacency of the layout, or edges
          :math:`(2, |\mathcal{E}|)`.
    """
    edges = layout.edge_index(adjacency) if isinstance(adjacency, str) else adjacency
    shared = StaticData(x=torch.zeros(1, layout.num_taxels, 0), pos=layout.pos)
    for key, value in (("normal", layout.normal), ("edge_index", edges)):
        if value is not None:
            shared[key] = value
    return shared


def _first_stored_sample(dataset: StaticDataset) -> StaticData:
    # The sample as it is stored, without the transform of the data set.
    stored = copy.copy(dataset)
    stored.transform = None
    return stored.batch([0])


def _compose(transforms: Sequence[Any]) -> Compose | None:
    steps = [step for transform in transforms for step in flat(transform)]
    return Compose(steps) if steps else None


def _select_shared(data: StaticData) -> StaticData:
    # Edges come first, because the number of edge features is checked against them.
    schema: dict[str, Any] = data.schema
    out = StaticData(x=torch.zeros(1, data.num_nodes, 0), **schema)
    plain_types = Tensor | bool | int | float | str
    keys = [key for key, value in data.to_dict().items() if isinstance(value, plain_types)]
    for key in sorted(keys, key=lambda key: key != "edge_index"):
        if key != "x" and data.is_shared(key):
            out[key] = data[key]
    return out


@contextmanager
def _tare_without_limits(transforms: Sequence[FittedTransform]) -> Iterator[None]:
    # Tares measure all samples on which they are fitted, not only the first samples as in training.
    tares = [tare for tare in transforms if isinstance(tare, Tare)]
    limits = [(tare.first, tare.seconds) for tare in tares]
    for tare in tares:
        tare.first = tare.seconds = None
    try:
        yield
    finally:
        for tare, (first, seconds) in zip(tares, limits, strict=True):
            tare.first, tare.seconds = first, seconds


def session_transforms(transforms: Sequence[Any]) -> list[FittedTransform]:
    r"""Returns the transforms that are fitted to each session separately."""
    return [
        transform for transform in fitted_parts(Compose(transforms)) if transform.key is not None
    ]
