r"""What is measured of a recording session before its readings are predicted."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.predictor._readings import ArrayLike
from torch_geometric_tactile.transforms import FittedTransform, Tare, fit_parts, fitted_parts

if TYPE_CHECKING:
    from torch_geometric_tactile.predictor._preparation import Preparation


@contextmanager
def _all_at_rest(parts: Sequence[FittedTransform]) -> Iterator[None]:
    # A tare measures all samples that it is given, not as many as in training.
    tares = [part for part in parts if isinstance(part, Tare)]
    limits = [(part.first, part.seconds) for part in tares]
    for part in tares:
        part.first = part.seconds = None
    try:
        yield
    finally:
        for part, (first, seconds) in zip(tares, limits, strict=True):
            part.first, part.seconds = first, seconds


def keyed(parts: Sequence[Any]) -> list[FittedTransform]:
    r"""Returns the transforms that measure each session by itself."""
    return [part for part in fitted_parts(Compose(parts)) if part.key is not None]


class Session:
    r"""The transforms that measure each session by itself, such as the sensor at rest, and the
    number of the session that was measured last.
    """

    def __init__(self, preparation: "Preparation") -> None:
        self._preparation = preparation
        self.parts = keyed(preparation.fitted)
        self.keys = tuple(dict.fromkeys(part.key for part in self.parts if part.key is not None))
        self.number: int | None = None

    @property
    def is_of_rest(self) -> bool:
        r"""Whether a tare takes all readings that a session is measured by for those at rest."""
        return any(
            isinstance(p, Tare) and p.first is None and p.seconds is None for p in self.parts
        )

    def mark(self, data: StaticData, number: int | None = None) -> None:
        r"""Writes the number of their session into samples: of the last one, if left out."""
        if not self.keys:
            return
        number = self.number if number is None else number
        if number is None:
            names = " and ".join(map(repr, self.parts))
            raise ValueError(
                f"'session' must be given, or adapt to a new one first: {names} measures each "
                "session by itself; call 'adapt' with some unlabelled readings of this session"
            )
        for key in self.keys:
            data[key] = torch.full((data.num_samples,), number, device=data.x.device)

    def adapt(
        self,
        reading: ArrayLike,
        joint: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> int:
        r"""Measures a new recording session by some of its readings, without labels, and returns
        its number; it is the session of the calls that follow. See
        :class:`~torch_geometric_tactile.transforms.SessionZScore` and
        :class:`~torch_geometric_tactile.transforms.Tare`.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(B, N, F)`; windows for a
                model of windows, but frames if a transform of frames measures the session.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians.
            time (torch.Tensor or numpy.ndarray, optional): Time of each in seconds :math:`(B,)`,
                where :class:`~torch_geometric_tactile.transforms.Tare` needs it.

        Raises:
            ValueError: If no transform measures sessions, or as for a call.
        """
        self._require_parts()
        preparation = self._preparation
        take = preparation.frames if preparation.measures_frames else preparation.data
        data = take(reading, joint, -1)
        if time is not None:
            data.time = torch.as_tensor(time, dtype=torch.double)
        return self._measure(data)

    def adapt_recording(
        self, recording: Recording, *, rest: float | None = None, resample: bool = False
    ) -> int:
        r"""Measures a new recording session by a recording, whatever the model takes. Its frames
        are thinned as those of the training.

        Args:
            recording (Recording): The recording, or its first seconds.
            rest (float, optional): How many seconds it begins with at rest; a
                :class:`~torch_geometric_tactile.transforms.Tare` measures all of their frames, in
                place of as many as in training.
            resample (bool): Whether to resample a recording of another rate.

        Raises:
            ValueError: If no transform measures sessions, or as for a call.
        """
        recording = self._preparation.matched(recording, resample=resample)
        if rest is not None:
            num_frames = int((recording.time < recording.time[:1] + rest).sum())
            return self.measure_rest(recording.select(slice(num_frames)))
        return self._adapt_matched(recording)

    def measure_rest(self, recording: Recording) -> int:
        r"""Measures a new recording session by a recording at rest, with frames as those of the
        training: a tare takes all of them, not as many as in training.
        """
        with _all_at_rest(self.parts):
            return self._adapt_matched(recording)

    def _adapt_matched(self, recording: Recording) -> int:
        preparation = self._preparation
        if preparation.window is None or preparation.measures_frames:
            return self.adapt(recording.tactile, recording.joint, recording.time)
        return self.adapt_windows(preparation.matched_windows(recording)[0])

    def rest_seconds(self) -> float | None:
        r"""Returns how long the recordings of the training were at rest, as far as a tare or their
        data set tells it; half a frame more than to the last frame at rest.
        """
        info, window = self._preparation.info, self._preparation.window
        rate = info.frame_rate
        for part in self.parts:
            if not isinstance(part, Tare):
                continue
            if part.seconds is not None:
                return float(part.seconds)
            if part.first is not None and rate is not None:
                last = part.first - 1
                if window is not None and not self._preparation.measures_frames:
                    last = last * window.hop + window.length - 1
                return (last + 0.5) / rate
        return info.rest

    def adapt_windows(self, windows: StaticData) -> int:
        r"""Measures a new recording session by some windows: that of what
        :meth:`windows` returned.

        Args:
            windows (StaticData): The windows.

        Raises:
            ValueError: If no transform measures sessions.
        """
        self._require_parts()
        if self._preparation.measures_frames:
            raise ValueError(
                "the session must be measured on frames, before windows are cut (got windows): "
                "call 'adapt_recording'"
            )
        return self._measure(windows)

    def _measure(self, data: StaticData) -> int:
        known = [int(part.key_values.max()) for part in self.parts if part.key_values is not None]
        number, preparation = 1 + max(known, default=-1), self._preparation
        self.mark(data, number)
        if preparation.window is None or preparation.measures_frames:
            data = preparation.thinned(data)[0]
        if preparation.measures_frames:
            fit_parts(Compose(preparation.frame_parts), data, adapt=True)
            if keyed(preparation.last_parts):
                data, _ = preparation.cut(data)
                self.mark(data, number)
        if keyed(preparation.last_parts):
            fit_parts(Compose(preparation.last_parts), data, adapt=True)
        self.number = number
        return number

    def _require_parts(self) -> None:
        need(self.parts, "no transform of this predictor measures sessions: there is no need")

    def give(self, center: Tensor, scale: Tensor | None = None) -> None:
        r"""Sets what was measured elsewhere, in place of all sessions before.

        Shapes:
            - **center:** Readings at rest :math:`(N, C)`.
            - **scale:** What they are divided by, if a transform scales sessions.
        """
        if len(self.parts) > 1:
            raise ValueError(f"a rest must be measured with frames, for {self.parts}: give a Rest")
        (part,) = self.parts
        if part.center is not None and part.center.shape[1:] != center.shape:
            shape = tuple(part.center.shape[1:])
            raise ValueError(f"'rest' must have shape {shape} (got {tuple(center.shape)})")
        if not part.unit_scale and scale is None:
            raise ValueError("'scale' must be given: the model scales each session (got None)")
        part.center = center.double().unsqueeze(0)
        part.scale = torch.ones_like(part.center).float()
        if scale is not None and not part.unit_scale:
            part.scale = scale.float().unsqueeze(0)
        part.key_values = torch.zeros(1, dtype=torch.long)
        self.number = 0
