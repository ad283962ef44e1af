r"""A trained model of windows, and the recordings that they are cut from."""

import copy

import torch
from torch import Tensor

from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.predictor._preparation import ArrayLike
from torch_geometric_tactile.predictor._trained_model import TrainedModel
from torch_geometric_tactile.transforms import Tare


class WindowedModel(TrainedModel):
    r"""A trained model that cuts windows out of recordings as in training, if it takes windows.

    Args:
        parts (Content): As of :class:`TrainedModel`.
    """

    def windows(self, recording: Recording) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of a recording, cut as in training and before the transforms of
        windows, and the last frame of each :math:`(W,)`.

        Args:
            recording (Recording): The recording.

        Raises:
            ValueError: If the model takes single frames, or as of a call.
        """
        if self.window is None:
            raise ValueError("this predictor takes single frames, not windows: call 'recording'")
        recording = self.preparation.ordered(recording)
        # A session is the same for all frames, and may be adapted to with these windows, unless it
        # is measured on the frames.
        on_frames = self.preparation.measures_frames
        frames = self.preparation.data(
            recording.tactile,
            recording.joint,
            -1 if self.preparation.session is None and not on_frames else None,
            dtype=self._dtype,
            device=self._device,
            num_frames=1,
        )
        del frames.num_frames
        frames.time = torch.as_tensor(recording.time.copy())
        return self.preparation.cut(frames)

    @property
    def measures_rest(self) -> bool:
        r"""Whether a :class:`~torch_geometric_tactile.transforms.Tare` takes all readings that a
        session is measured by for those at rest.
        """
        parts = self.preparation.fitted
        return any(isinstance(p, Tare) and p.first is None and p.seconds is None for p in parts)

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
        self._check_adapts()
        on_frames = self.preparation.measures_frames
        data = self.preparation.data(
            reading,
            joint,
            -1,
            dtype=self._dtype,
            device=self._device,
            num_frames=1 if on_frames else None,
        )
        if on_frames:
            del data.num_frames
        if time is not None:
            data.time = torch.as_tensor(time, dtype=torch.double)
        return self.preparation.adapt(data)

    def adapt_recording(self, recording: Recording) -> int:
        r"""Measures a new recording session by a recording, whatever the model takes.

        Args:
            recording (Recording): The recording, or its first seconds.

        Raises:
            ValueError: If no transform measures sessions, or as for a call.
        """
        if self.window is None or self.preparation.measures_frames:
            recording.check(self.layout)
            return self.adapt(recording.tactile, recording.joint, recording.time)
        return self.adapt_windows(self.windows(recording)[0])

    def adapt_windows(self, windows: StaticData) -> int:
        r"""Measures a new recording session by some windows: that of what
        :meth:`windows` returned.

        Args:
            windows (StaticData): The windows.

        Raises:
            ValueError: If no transform measures sessions.
        """
        self._check_adapts()
        if self.preparation.measures_frames:
            raise ValueError(
                "the session must be measured on frames, before windows are cut (got windows): "
                "call 'adapt_recording'"
            )
        return self.preparation.adapt(windows)

    def of_windows(self, windows: StaticData, batch_size: int = 256) -> Tensor:
        r"""Returns the probabilities of windows :math:`(W, C)`.

        Args:
            windows (StaticData): What :meth:`windows` returned.
            batch_size (int): Number of windows that are computed at a time.

        Raises:
            ValueError: If :obj:`batch_size` is below one.
        """
        check_size(batch_size)
        for key in self.preparation.keys:
            number = self.preparation._session(None)
            windows[key] = torch.full((windows.num_samples,), number, device=self._device)
        parts = []
        with torch.inference_mode():
            for start in range(0, windows.num_samples, batch_size):
                part = windows.index_select(slice(start, start + batch_size))
                data = self.preparation.prepared_windows(part)
                parts.append(self.probability(self.logits(data)))
        return torch.cat(parts)

    def prepare(
        self, reading: ArrayLike, joint: ArrayLike | None = None, session: int | None = None
    ) -> StaticData:
        r"""Returns readings as the model takes them, after all transforms.

        Args:
            reading (torch.Tensor or numpy.ndarray): As for a call.
            joint (torch.Tensor or numpy.ndarray, optional): As for a call.
            session (int, optional): As for a call.
        """
        data = self.preparation.data
        return self.preparation.prepared(
            data(reading, joint, session, dtype=self._dtype, device=self._device)
        )

    def prepare_frame(self, reading: ArrayLike, joint: ArrayLike | None = None) -> StaticData:
        r"""Returns one frame of a stream as the model takes it, or for a model of windows as these
        are cut from: after the transforms of frames only.

        Args:
            reading (torch.Tensor or numpy.ndarray): Raw readings :math:`(N, C)`.
            joint (torch.Tensor or numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
        """
        data = self.preparation.data(
            reading, joint, dtype=self._dtype, device=self._device, num_frames=1
        )
        if self.window is None:
            return self.preparation.prepared(data)
        del data.num_frames
        return self.preparation.prepared_frames(data)

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
        return self.preparation.prepared_windows(data)

    def _check_adapts(self) -> None:
        if not self.preparation.keys:
            raise ValueError("no transform of this predictor measures sessions: there is no need")


def check_size(size: int) -> None:
    r"""Raises a :class:`ValueError` if a number of samples is below one."""
    if size < 1:
        raise ValueError(f"'batch_size' must be at least 1 (got {size})")
