r"""From live frames to labels."""

import copy
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._contact_windows import ContactWindow
from torch_geometric_tactile.data.contact_rule import NO_CONTACT, ContactRule
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._frame_gate import FrameGate, frame_info
from torch_geometric_tactile.live.onnx_judge import OnnxModel
from torch_geometric_tactile.live.rest import Rest, RestFrames
from torch_geometric_tactile.live.subscription import Subscription

if TYPE_CHECKING:
    from torch_geometric_tactile.predictor import Predictor


@dataclass(frozen=True, eq=False, slots=True)
class Judgement:
    r"""The prediction of a model for a frame, or for the window of frames that ends with it.

    Args:
        sequence (int): Number of the frame.
        time (float): Its time on this host's monotonic clock in seconds.
        received (int): When its last byte was read, on the monotonic clock in nanoseconds.
        finished (int): When the answer was there, likewise.
        probability (numpy.ndarray): Probabilities of the classes or labels :math:`(K,)`; for a
            regression the numbers themselves. NaN if a reading is missing that the model needs, or
            without contact.
        class_names (tuple of str): Names of the classes, labels or numbers.
        task (str): As of :class:`~torch_geometric_tactile.Predictor`.
        latency (Mapping of str to float): Seconds by part: :obj:`"wait"` (from the last byte to
            this model), :obj:`"prepare"`, :obj:`"model"`, and :obj:`"total"` from the last byte to
            the answer. A graph in ONNX does most of what prepares a frame within the model.
        threshold (float, optional): Of two classes, the probability of the second above which it is
            the label; one half if left out.
        lacks_contact (bool): Whether nothing touches the sensor, by the contact rule of the judge.

    Examples:
        >>> answer = np.array([0.2, 0.8])
        >>> judgement = Judgement(7, 0.07, 0, 0, answer, ("stable", "slip"), "multiclass", {})
        >>> judgement.label
        'slip'
    """

    sequence: int
    time: float
    received: int
    finished: int
    probability: np.ndarray
    class_names: tuple[str, ...]
    task: str
    latency: Mapping[str, float]
    threshold: float | None = None
    lacks_contact: bool = False

    @property
    def label(self) -> str:
        r"""The predicted class, or all labels above one half joined by semicolons;
        :obj:`"no contact"` without contact; empty if there is no answer, and for a regression.
        """
        if self.lacks_contact:
            return NO_CONTACT
        if self.task == "regression" or np.isnan(self.probability).any():
            return ""
        if self.task == "multilabel":
            chosen = np.flatnonzero(self.probability > 0.5)
            return ";".join(self.class_names[i] for i in chosen)
        if self.threshold is not None:
            return self.class_names[int(self.probability[1] > self.threshold)]
        return self.class_names[int(self.probability.argmax())]


class Judge:
    r"""Runs a model on live frames.

    A model of windows has an answer from the first full window on, and then one for each frame that
    it takes; a recurrent one goes from frame to frame. Frames are thinned as in training. After a
    gap in time, five frames long unless the training had another limit, it starts with an empty
    window; the numbers of frames tell a loss where times of the training are not known.

    Frames that carry their unit and the names of their columns (:attr:`LiveFrame.info
    <torch_geometric_tactile.data.LiveFrame>`) are compared with those of the training: columns are
    put in order, and another unit is an error. The rate is measured over each second; another one
    than that of the training is logged, and told by :attr:`note`.

    A model whose readings are measured session by session
    (:class:`~torch_geometric_tactile.transforms.Tare`) needs a rest. Frames then go to the
    :class:`Rest` first, and there are answers from its end on. So do they for a contact rule, which
    is measured anew by each rest.

    Args:
        model (Predictor or str or PathLike): A predictor, its file, or a file in ONNX that
            ``tactile export`` wrote. The latter needs neither PyTorch nor Lightning.
        rest (Rest or numpy.ndarray, optional): Where the rest is collected, or readings at rest
            :math:`(N, C)`.
        max_lost (int, optional): How many frames in a row may be lost within a window, by their
            numbers. If left out, times decide, or none may where the training had no times.
        contact (ContactRule, optional): What tells frames without contact, whose label is
            :obj:`"no contact"` and whose probabilities are NaN; a window lacks contact if all of
            its frames do. That of the model if left out.

    Attributes:
        relative (bool): Whether frames come relative to :obj:`rest`, as a session with
            :obj:`tare=True` gives them.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If onnxruntime is missing.
        ValueError: If the file is no model, or the model needs a rest and there is none; on a call,
            if a frame has other taxels, channels or joints.

    Examples:
        >>> from torch_geometric_tactile import Predictor
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.nn.models import TaxelNet
        >>> dataset = FakeTactileDataset(num_samples=20)
        >>> model = TaxelNet(dataset.layout, in_channels=3, out_channels=2)
        >>> judge = Judge(Predictor.from_dataset(model, dataset))
        >>> frame = LiveFrame(0, 0.0, 0, None, dataset[0].x.numpy())
        >>> judge(frame).class_names
        ('stable', 'slip')
    """

    def __init__(
        self,
        model: "Predictor | PathLike",
        rest: Rest | np.ndarray | None = None,
        *,
        max_lost: int | None = None,
        contact: ContactRule | None = None,
    ) -> None:
        is_path = isinstance(model, str | os.PathLike)
        is_onnx = is_path and os.fspath(model).endswith(".onnx")  # type: ignore[arg-type]
        self._model: Any = OnnxModel(model) if is_onnx else _PredictorModel(model)  # type: ignore[arg-type]
        self.info: Mapping[str, Any] = self._model.info
        if contact is not None:
            self._model.contact = contact
        self.relative = False
        self.frame_info = frame_info(self.info)
        with_rate = bool(self.info.get("needs_rate", self._model.length > 1))
        self._gate = FrameGate(self.frame_info, with_rate, max_lost)
        self.rest = rest if isinstance(rest, Rest) else None
        self._rest_number = -1
        self._class_names = tuple(self.info["class_names"])
        if self.rest is not None:
            self.rest.need(self._model.length * self.frame_info.stride)
        elif rest is not None:
            self._model.set_rest(np.asarray(rest))
        if self.needs_rest and self.rest is None:
            raise ValueError(
                f"'rest' must be given: the model measures each session, by "
                f"{self.info['rest']['transform']} (got None)"
            )
        rule = self.contact
        if rule is not None and not rule.is_measured and self.rest is None:
            raise ValueError(
                "'rest' must be a Rest, since the contact rule compares readings with those at "
                "rest: give one, a rule that was measured, or its threshold and the readings at "
                f"rest (got {'None' if rest is None else 'readings without their noise'})"
            )

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that tells frames without contact, :obj:`None` if there is none."""
        rule: ContactRule | None = self._model.contact
        return rule

    @property
    def measures_rest(self) -> bool:
        r"""Whether the model or the contact rule is measured by the rest."""
        return self.info["rest"] is not None or self.contact is not None

    @property
    def length(self) -> int:
        r"""Number of frames of a window, one for a model of single frames."""
        return int(self._model.length)

    @property
    def needs_rest(self) -> bool:
        r"""Whether a rest is still to be collected."""
        return bool(self._model.needs_rest)

    @property
    def max_lost(self) -> int | None:
        r"""How many frames in a row may be lost within a window; times decide if it is None."""
        return self._gate.max_lost

    @max_lost.setter
    def max_lost(self, value: int | None) -> None:
        self._gate.max_lost = value

    @property
    def note(self) -> str:
        r"""A message about a wrong rate, such as :obj:`"wrong rate: 50 in place of 100
        Hz"`; empty if nothing is, or it was not measured yet.
        """
        return self._gate.note

    @property
    def rate(self) -> float | None:
        r"""Frames per second of the stream over the last second, by the numbers of the frames;
        :obj:`None` before.
        """
        return self._gate.rate

    def reset(self) -> None:
        r"""Forgets the frames before, as at the start of another trial."""
        self._gate.reset()
        self._model.reset()

    def __call__(self, frame: LiveFrame, *, wanted: bool = True) -> Judgement | None:
        r"""Returns the judgement of a frame, or :obj:`None` as long as the window is not full or
        the rest is not there, and for frames that are left out as in training.
        """
        start = perf_counter_ns()
        self._check(frame)
        tactile, joint = self._gate.ordered(frame)
        is_seen = True
        if self.length > 1:  # single frames are all judged
            is_seen, is_break = self._gate.admit(frame)
            if is_break:
                self._model.reset()
        if tactile is not frame.tactile or joint is not frame.joint:
            frame = replace(frame, tactile=tactile, joint=joint)
        if not self._is_measured(frame) or not is_seen:
            return None
        probability = self._model.add(tactile, joint, wanted)
        if probability is None:
            return None
        finished = perf_counter_ns()
        latency = {
            "wait": (start - frame.received) * 1e-9,
            "prepare": (finished - start - self._model.model_ns) * 1e-9,
            "model": self._model.model_ns * 1e-9,
            "total": (finished - frame.received) * 1e-9,
        }
        return Judgement(
            frame.sequence,
            frame.time,
            frame.received,
            finished,
            probability,
            self._names(len(probability)),
            self.info["task"],
            latency,
            self.info["threshold"],
            self._model.contact is not None and self._model.lacks_contact,
        )

    def follow(self, subscription: Iterable[LiveFrame]) -> Iterator[Judgement]:
        r"""Yields judgements until the stream has ended: of each frame with policy :obj:`"all"`,
        and of the newest frame with :obj:`"newest"` and :obj:`"drop_oldest"`, where a model of
        windows sees those between as well.

        Args:
            subscription (Subscription or iterable of LiveFrame): The frames.

        Raises:
            ValueError: If a model of windows gets the newest frames only.
        """
        policy = getattr(subscription, "policy", "all")
        if policy == "newest" and self.length > 1:
            raise ValueError(
                "'subscription' must have policy 'all' or 'drop_oldest': the model takes windows "
                f"of {self.length} frames (got 'newest')"
            )
        queue = subscription if isinstance(subscription, Subscription) else None
        newest = queue if policy == "drop_oldest" else None
        for frame in subscription:
            while newest is not None and (newer := newest.poll()) is not None:
                self(frame, wanted=False)
                frame = newer
            judgement = self(frame)
            if judgement is not None:
                yield judgement

    def _check(self, frame: LiveFrame) -> None:
        num_taxels, num_channels = self.info["num_taxels"], self.info["num_channels"]
        shape = frame.tactile.shape
        if len(shape) != 2 or shape[0] != num_taxels or num_channels not in (None, shape[1]):
            raise ValueError(
                f"a frame must have shape ({num_taxels}, {num_channels or 'num_channels'}), the "
                f"taxels of layout '{self.info['layout']}' and their channels (got {shape})"
            )
        num_joints = self.info["num_joints"]
        if num_joints == 0:
            return
        if frame.joint is None or num_joints not in (None, len(frame.joint)):
            given = "none" if frame.joint is None else len(frame.joint)
            raise ValueError(
                f"a frame must have {num_joints or 'the'} joint angles, which the model needs "
                f"(got {given})"
            )

    def _is_measured(self, frame: LiveFrame) -> bool:
        rest = self.rest
        if rest is None or not self.measures_rest:
            return True
        if not rest.ready and not rest.add(frame):
            return False
        frames = rest.frames
        if rest.number != self._rest_number and frames is not None:
            self._measure(frames)
            self._rest_number = rest.number
            self._model.reset()
            # The last frame of the rest is the first that is judged with it.
        return True

    def _measure(self, frames: RestFrames) -> None:
        if not self.relative:
            self._model.measure(frames.tactile, frames.time, frames.joint)
        elif self.contact is not None:  # the session subtracts the rest, in the order of its source
            rule = self.contact.measured(self._gate.ordered_readings(frames.tactile))
            self._model.contact = rule.with_rest(0 * np.asarray(rule.rest))

    def _names(self, count: int) -> tuple[str, ...]:
        if len(self._class_names) != count:
            self._class_names = tuple(str(i) for i in range(count))
        return self._class_names

    def __repr__(self) -> str:
        kind = "PyTorch"
        if isinstance(self._model, OnnxModel):
            kind = "ONNX, 8 bits" if self._model.is_quantized else "ONNX"
        return (
            f"{type(self).__name__}({kind}, '{self.info['layout']}', "
            f"classes={list(self._class_names)}, task='{self.info['task']}', length={self.length})"
        )


class _PredictorModel:
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
        facts = {**predictor.network.metadata(), **predictor.preparation.metadata()}
        self.info: dict[str, Any] = {**facts, "unit": None}
        self._ring: Any = None
        self._contacts = ContactWindow(self.length)
        self.lacks_contact = False
        self.model_ns = 0

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

    @property
    def contact(self) -> ContactRule | None:
        r"""As of :class:`OnnxModel`."""
        rule: ContactRule | None = self._predictor.contact
        return rule

    @contact.setter
    def contact(self, rule: ContactRule | None) -> None:
        self._predictor.contact = rule

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""As of :class:`OnnxModel`."""
        from torch_geometric_tactile.data import Recording

        if self.info["rest"] is None and self.contact is None:
            return
        session = self._predictor.preparation.session
        session.measure_rest(Recording(time=time, tactile=frames, joint=joint))
        missing = np.isnan(frames).all(axis=0)
        for part in session.transforms:
            if part.center[-1].shape == missing.shape:
                part.center[-1][missing] = np.nan  # not zero: what was never there has no rest

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""As of :class:`OnnxModel`."""
        import torch

        session = self._predictor.preparation.session
        if session.transforms:
            session.set_rest(torch.tensor(center), None if scale is None else torch.tensor(scale))
        if self.contact is not None and center.shape[-1:] == (self.info["num_channels"],):
            self.contact = self.contact.with_rest(center)

    def add(self, tactile: np.ndarray, joint: np.ndarray | None, wanted: bool = True) -> Any:
        r"""As of :class:`OnnxModel`."""
        import torch

        predictor, rule = self._predictor, self.contact
        if rule is not None:
            self.lacks_contact = self._contacts.push(rule, tactile)
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
        return np.full_like(out, np.nan) if rule is not None and self.lacks_contact else out

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
