r"""A predictor in PyTorch, frame by frame."""

import copy
import os
from time import perf_counter_ns
from typing import Any

import numpy as np

from torch_geometric_tactile._typing import PathLike


class PredictorModel:
    r"""A :class:`~torch_geometric_tactile.Predictor` that takes frame after frame, as
    :class:`OnnxModel` does.
    """

    def __init__(self, predictor: Any) -> None:
        from torch_geometric_tactile.predictor import Predictor

        if isinstance(predictor, Predictor):
            predictor = copy.deepcopy(predictor)
        else:
            predictor = _opened(predictor)
        self._predictor = predictor
        preparation = predictor.preparation
        names = {"task": predictor.task, "threshold": predictor.threshold}
        window = predictor.window
        rest = preparation.session.parts
        self.info: dict[str, Any] = {
            **names,
            "class_names": list(predictor.class_names),
            "layout": predictor.layout.name,
            "layout_content": predictor.layout.to_dict(),
            "num_taxels": predictor.layout.num_taxels,
            "num_channels": preparation.num_channels,
            "num_joints": (preparation.num_joints or None) if preparation.needs_joint else 0,
            "unit": None,
            "window": None if window is None else window.to_dict(),
            "rest": {"transform": repr(rest[0])} if rest else None,
        }
        self._ring: Any = None
        self.prepare_ns = self.model_ns = 0

    @property
    def length(self) -> int:
        r"""Number of frames of a window, one for a model of single frames."""
        window = self._predictor.window
        return 1 if window is None else int(window.length)

    @property
    def needs_rest(self) -> bool:
        r"""Whether the session must be measured first, and was not."""
        return self.info["rest"] is not None and self._predictor.preparation.session.number is None

    def reset(self) -> None:
        r"""Forgets all frames, not the rest."""
        if self._ring is not None:
            self._ring.clear()

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""As of :class:`OnnxModel`."""
        from torch_geometric_tactile.data import Recording

        if self.info["rest"] is None:
            return
        self._predictor.adapt_recording(Recording(time=time, tactile=frames, joint=joint))
        missing = np.isnan(frames).all(axis=0)
        for part in self._predictor.preparation.session.parts:
            if part.center[-1].shape == missing.shape:
                part.center[-1][missing] = np.nan  # not zero: what was never there has no rest

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""As of :class:`OnnxModel`."""
        import torch

        session = self._predictor.preparation.session
        if session.parts:
            session.give(torch.tensor(center), None if scale is None else torch.tensor(scale))

    def add(self, tactile: np.ndarray, joint: np.ndarray | None, wanted: bool = True) -> Any:
        r"""As of :class:`OnnxModel`."""
        import torch

        start = perf_counter_ns()
        predictor = self._predictor
        with torch.inference_mode():
            data = predictor.prepare_frame(tactile, joint)
            if predictor.window is not None:
                ring = self._frame_ring(data.x)
                ring.push(data.x[0])
                if not (wanted and ring.is_full):
                    return None
                data = predictor.prepare_window(data, ring.window())
            elif not wanted:
                return None
            ready = perf_counter_ns()
            out = predictor.probability(predictor.logits(data))[0].cpu().float().numpy()
        self.model_ns = perf_counter_ns() - ready
        self.prepare_ns = ready - start
        return out

    def _frame_ring(self, x: Any) -> Any:
        from torch_geometric_tactile.data import FrameRing

        if self._ring is None:
            self._ring = FrameRing(self.length, x.size(1), x.size(2), x.dtype)
        return self._ring


def _opened(path: PathLike) -> Any:
    from torch_geometric_tactile.predictor import Predictor, is_checkpoint

    if not os.path.isfile(path):
        raise FileNotFoundError(f"there is no model '{os.fspath(path)}'")
    read = Predictor.from_checkpoint if is_checkpoint(path) else Predictor.load
    return read(path)
