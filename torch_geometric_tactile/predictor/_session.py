r"""Calibration of a predictor to a recording session, such as its readings at rest."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording, StaticData, split_frames
from torch_geometric_tactile.predictor._readings import ArrayLike
from torch_geometric_tactile.transforms import FittedTransform, Tare, fit_parts, fitted_parts

if TYPE_CHECKING:
    from torch_geometric_tactile.predictor._preparation import Preparation


@contextmanager
def _tare_without_limits(transforms: Sequence[FittedTransform]) -> Iterator[None]:
    # Tares measure all samples that they are fitted on, not the first ones as in training.
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


class Session:
    r"""The transforms that are fitted to each session separately, such as a tare, and the number of
    the session that was measured last.

    Args:
        preparation (Preparation): The preparation that the session belongs to.
    """

    def __init__(self, preparation: "Preparation") -> None:
        self._preparation = preparation
        self.transforms = session_transforms(preparation.fitted)
        self.keys = tuple(
            dict.fromkeys(part.key for part in self.transforms if part.key is not None)
        )
        self.number: int | None = None

    @property
    def measures_rest(self) -> bool:
        r"""Whether a tare averages all readings of :meth:`adapt`, so that all must be at rest."""
        return any(
            isinstance(p, Tare) and p.first is None and p.seconds is None for p in self.transforms
        )

    def set_session_number(self, data: StaticData, number: int | None = None) -> None:
        r"""Sets the session attributes of samples to a session number, by default to that of the
        session that was measured last.
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
        r"""Measures a new recording session from some of its readings, which need no labels.
        Returns the number of the session, which later calls use by default. See
        :class:`~torch_geometric_tactile.transforms.SessionZScore` and
        :class:`~torch_geometric_tactile.transforms.Tare`.

        If no transform measures sessions, or a tare measures all readings, the same readings are
        also the rest of :attr:`Predictor.contact`.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(B, N, F)`. A model of
                windows takes windows, or frames if a transform of frames measures the session.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians.
            time (torch.Tensor or numpy.ndarray, optional): Time of each reading in seconds
                :math:`(B,)`, if :class:`~torch_geometric_tactile.transforms.Tare` needs it.

        Raises:
            ValueError: If nothing measures sessions, or for the reasons of a call.
        """
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
        r"""Measures a new recording session from a recording. Works for models of frames and of
        windows. The frames are selected as in training.

        Args:
            recording (Recording): The recording, or its first seconds.
            rest (float, optional): Seconds at the beginning in which nothing touches the sensor.
                :class:`~torch_geometric_tactile.transforms.Tare` and :attr:`Predictor.contact`
                measure all of these frames. If left out, they measure as many as in training.
            resample (bool): Whether to resample a recording of another rate.

        Raises:
            ValueError: If nothing measures sessions, or for the reasons of a call.
        """
        recording = self._preparation.match_recording(recording, resample=resample)
        if rest is not None:
            num_frames = int((recording.time < recording.time[:1] + rest).sum())
            return self.measure_rest(recording.select(slice(num_frames)))
        self._measure_contact(recording.tactile[recording.time < self._rest_end_time(recording)])
        return self._adapt_matched_frames(recording)

    def _rest_end_time(self, recording: Recording) -> float:
        # The contact rule measures as long as the tare does. Without a tare, the end is unknown.
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
        r"""Measures a new recording session from a recording at rest, which :meth:`Preparation.
        match_recording` returned. A tare averages all of its frames. Returns the session number.
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
        r"""Returns for how many seconds the training recordings were at rest, from the settings of
        a tare or from their data set; :obj:`None` if unknown.
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
                # Half a frame later, so that a jitter of the time does not lose the last frame.
                return (last + 0.5) / rate
        return info.rest

    def adapt_windows(self, windows: StaticData) -> int:
        r"""Measures a new recording session from windows, and returns its number.

        Args:
            windows (StaticData): Windows from :meth:`Predictor.windows`.

        Raises:
            ValueError: If nothing measures sessions, or a transform measures them on frames.
        """
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
        r"""Replaces all measured sessions by one session with a given centre and scale.

        Shapes:
            - **center:** Readings at rest :math:`(N, C)`.
            - **scale:** Divisor of the readings, if a transform scales sessions :math:`(N, C)`.
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
