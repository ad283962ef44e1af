r"""Predictions of a model for live frames."""

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
        time (float): Time of the frame on this host's monotonic clock in seconds.
        received (int): Time at which the last byte of the frame was read, on the monotonic clock in
            nanoseconds.
        finished (int): Time at which the prediction was ready, on the monotonic clock in
            nanoseconds.
        probability (numpy.ndarray): Probabilities of the classes or labels :math:`(K,)`, or the
            predicted numbers of a regression. NaN if a reading that the model needs is missing, or
            without contact.
        class_names (tuple of str): Names of the classes, labels or numbers.
        task (str): The task, as in :class:`~torch_geometric_tactile.Predictor`.
        latency (Mapping of str to float): Seconds of each step: :obj:`"wait"` (from the last byte
            to the start of the preparation), :obj:`"prepare"`, :obj:`"model"`, and :obj:`"total"`
            from the last byte to the prediction. An ONNX graph does most of the preparation within
            the model.
        threshold (float, optional): For two classes, the probability above which the label is the
            second class. By default one half.
        lacks_contact (bool): Whether nothing touches the sensor, according to the contact rule.

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
        r"""The predicted class, or all labels with a probability above one half, joined by
        semicolons. It is :obj:`"no contact"` without contact, and empty for a regression or if the
        probabilities are NaN.
        """
        if self.lacks_contact:
            return NO_CONTACT
        if self.task == "regression" or np.isnan(self.probability).any():
            return ""
        if self.task == "multilabel":
            indices = np.flatnonzero(self.probability > 0.5)
            return ";".join(self.class_names[i] for i in indices)
        if self.threshold is not None:
            return self.class_names[int(self.probability[1] > self.threshold)]
        return self.class_names[int(self.probability.argmax())]


class Judge:
    r"""Runs a model on live frames.

    A windowed model predicts as soon as the first window is full, then at each selected frame. A
    recurrent model steps from frame to frame. Frames are selected as in training. After a gap in
    time, the window starts empty. A gap is longer than five frames, unless training used another
    limit. If the training times are unknown, lost frames are detected from their numbers.

    Frames may carry their unit and column names (:attr:`LiveFrame.info
    <torch_geometric_tactile.data.LiveFrame>`). Their columns are then reordered as in training, and
    a different unit is an error. The rate is measured over each second. If it differs from the
    training rate, a warning is logged, and :attr:`note` describes it.

    A model that measures each session (:class:`~torch_geometric_tactile.transforms.Tare`) needs the
    sensor at rest. The :class:`Rest` first collects frames, and predictions start when it is ready.
    Each rest also measures the contact rule.

    Args:
        model (Predictor or str or PathLike): A predictor, its file, the name of a predictor of the
            package, or an ONNX file that ``tactile export`` wrote. ONNX files need neither PyTorch
            nor Lightning.
        rest (Rest or numpy.ndarray, optional): The object that collects frames at rest, or readings
            at rest :math:`(N, C)`.
        max_lost (int, optional): Number of consecutive frames that may be lost within a window. By
            default, gaps are detected from the times. If the training times are unknown, no frame
            may be lost.
        contact (ContactRule, optional): The rule that detects frames without contact. Their label
            is :obj:`"no contact"`, and their probabilities are NaN. By default the rule of the
            model. A window lacks contact if all of its frames do.

    Attributes:
        relative (bool): Whether frames are relative to :obj:`rest`, as in a session with
            :obj:`tare=True`.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If onnxruntime is missing.
        ValueError: If the file is not a model, or the model needs a rest and there is none. A call
            raises it if a frame has the wrong number of taxels, channels or joints.

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
                f"'rest' must be given: the model measures each session with "
                f"{self.info['rest']['transform']} (got None)"
            )
        rule = self.contact
        if rule is not None and not rule.is_measured and self.rest is None:
            raise ValueError(
                "'rest' must be a Rest, since the contact rule compares readings with those at "
                f"rest (got {'None' if rest is None else 'readings without their noise'}): pass a "
                "Rest, or a rule with its threshold and readings at rest"
            )

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that detects frames without contact, or :obj:`None`."""
        rule: ContactRule | None = self._model.contact
        return rule

    @property
    def measures_rest(self) -> bool:
        r"""Whether the model or the contact rule needs readings at rest."""
        return self.info["rest"] is not None or self.contact is not None

    @property
    def length(self) -> int:
        r"""Number of frames in a window; 1 for a single-frame model."""
        return int(self._model.length)

    @property
    def needs_rest(self) -> bool:
        r"""Whether the model needs a rest that has not been measured yet."""
        return bool(self._model.needs_rest)

    @property
    def max_lost(self) -> int | None:
        r"""Number of consecutive frames that may be lost within a window. If :obj:`None`, gaps are
        detected from the times.
        """
        return self._gate.max_lost

    @max_lost.setter
    def max_lost(self, value: int | None) -> None:
        self._gate.max_lost = value

    @property
    def note(self) -> str:
        r"""A message about a wrong rate, such as :obj:`"wrong rate: 50 instead of 100
        Hz"`. It is empty if the rate is right or has not been measured yet.
        """
        return self._gate.note

    @property
    def rate(self) -> float | None:
        r"""Frames per second of the stream over the last second, by frame numbers;
        :obj:`None` in the first second.
        """
        return self._gate.rate

    def reset(self) -> None:
        r"""Forgets earlier frames. Call it at the start of a trial."""
        self._gate.reset()
        self._model.reset()

    def __call__(self, frame: LiveFrame, *, predict: bool = True) -> Judgement | None:
        r"""Returns the judgement of a frame, or :obj:`None` while the window is not full or the
        rest is not ready, and for frames that are not selected.

        Args:
            frame (LiveFrame): The frame.
            predict (bool): Whether to predict. If :obj:`False`, the frame only enters the window.
        """
        start = perf_counter_ns()
        self._check_shape(frame)
        tactile, joint = self._gate.reorder(frame)
        is_selected = True
        if self.length > 1:  # single-frame models take every frame
            is_selected, is_break = self._gate.admit(frame)
            if is_break:
                self._model.reset()
        if tactile is not frame.tactile or joint is not frame.joint:
            frame = replace(frame, tactile=tactile, joint=joint)
        if not self._update_rest(frame) or not is_selected:
            return None
        probability = self._model.add(tactile, joint, predict)
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
            self._output_names(len(probability)),
            self.info["task"],
            latency,
            self.info["threshold"],
            self._model.contact is not None and self._model.lacks_contact,
        )

    def follow(self, subscription: Iterable[LiveFrame]) -> Iterator[Judgement]:
        r"""Yields judgements until the stream has ended. With policy :obj:`"all"`, each frame is
        judged. With :obj:`"newest"` and :obj:`"drop_oldest"`, only the newest frame is judged. With
        :obj:`"drop_oldest"`, the frames in between still enter the window.

        Args:
            subscription (Subscription or iterable of LiveFrame): The frames.

        Raises:
            ValueError: If a windowed model is used with policy :obj:`"newest"`.
        """
        policy = getattr(subscription, "policy", "all")
        if policy == "newest" and self.length > 1:
            raise ValueError(
                "'subscription' must have policy 'all' or 'drop_oldest', since the model needs "
                f"windows of {self.length} frames (got 'newest')"
            )
        queue = subscription if isinstance(subscription, Subscription) else None
        newest_queue = queue if policy == "drop_oldest" else None
        for frame in subscription:
            while newest_queue is not None and (newer := newest_queue.poll()) is not None:
                self(frame, predict=False)
                frame = newer
            judgement = self(frame)
            if judgement is not None:
                yield judgement

    def _check_shape(self, frame: LiveFrame) -> None:
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
            num_angles = "none" if frame.joint is None else len(frame.joint)
            raise ValueError(
                f"a frame must have {num_joints or 'the'} joint angles, since the model reads them "
                f"(got {num_angles})"
            )

    def _update_rest(self, frame: LiveFrame) -> bool:
        rest = self.rest
        if rest is None or not self.measures_rest:
            return True
        if not rest.ready and not rest.add(frame):
            return False
        frames = rest.frames
        if rest.number != self._rest_number and frames is not None:
            self._measure_rest(frames)
            self._rest_number = rest.number
            self._model.reset()
            # The last frame of the rest is judged like the frames that follow.
        return True

    def _measure_rest(self, frames: RestFrames) -> None:
        if not self.relative:
            self._model.measure(frames.tactile, frames.time, frames.joint)
        elif (
            self.contact is not None
        ):  # the session subtracts the rest, before columns are reordered
            rule = self.contact.measured(self._gate.reorder_readings(frames.tactile))
            self._model.contact = rule.with_rest(0 * np.asarray(rule.rest))

    def _output_names(self, count: int) -> tuple[str, ...]:
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
    r"""A :class:`~torch_geometric_tactile.Predictor` with the interface of :class:`OnnxModel`,
    which takes one frame after another.
    """

    def __init__(self, predictor: Any) -> None:
        from torch_geometric_tactile.predictor import Predictor

        if isinstance(predictor, Predictor):
            # A copy, since sessions and the contact rule must not change the caller's predictor.
            predictor = copy.deepcopy(predictor)
        else:
            predictor = _load_predictor(predictor)
        self._predictor = predictor
        metadata = {**predictor.network.metadata(), **predictor.preparation.metadata()}
        self.info: dict[str, Any] = {**metadata, "unit": None}
        self._ring: Any = None
        self._contact_window = ContactWindow(self.length)
        self.lacks_contact = False
        self.model_ns = 0

    @property
    def length(self) -> int:
        r"""Number of frames in a window; 1 for a single-frame model."""
        window = self._predictor.window
        return 1 if window is None else int(window.length)

    @property
    def needs_rest(self) -> bool:
        r"""Whether the model needs a rest that has not been measured yet."""
        return self.info["rest"] is not None and self._predictor.preparation.session.number is None

    def reset(self) -> None:
        r"""Forgets all frames, but not the rest."""
        if self._ring is not None:
            self._ring.clear()

    @property
    def contact(self) -> ContactRule | None:
        r"""The rule that detects frames without contact, or :obj:`None`."""
        rule: ContactRule | None = self._predictor.contact
        return rule

    @contact.setter
    def contact(self, rule: ContactRule | None) -> None:
        self._predictor.contact = rule

    def measure(self, frames: np.ndarray, time: np.ndarray, joint: np.ndarray | None) -> None:
        r"""Measures the session from frames at rest, as :meth:`OnnxModel.measure`."""
        from torch_geometric_tactile.data import Recording

        if self.info["rest"] is None and self.contact is None:
            return
        session = self._predictor.preparation.session
        session.measure_rest(Recording(time=time, tactile=frames, joint=joint))
        missing = np.isnan(frames).all(axis=0)
        for part in session.transforms:
            if part.center[-1].shape == missing.shape:
                part.center[-1][missing] = (
                    np.nan
                )  # a taxel without readings has no rest, and zero would look like a rest

    def set_rest(self, center: np.ndarray, scale: np.ndarray | None = None) -> None:
        r"""Sets the centre and scale of the session, as :meth:`OnnxModel.set_rest`."""
        import torch

        session = self._predictor.preparation.session
        if session.transforms:
            session.set_rest(torch.tensor(center), None if scale is None else torch.tensor(scale))
        if self.contact is not None and center.shape[-1:] == (self.info["num_channels"],):
            self.contact = self.contact.with_rest(center)

    def add(self, tactile: np.ndarray, joint: np.ndarray | None, predict: bool = True) -> Any:
        r"""Adds the next frame and returns the probabilities, as :meth:`OnnxModel.add`."""
        import torch

        predictor, rule = self._predictor, self.contact
        if rule is not None:
            self.lacks_contact = self._contact_window.push(rule, tactile)
        with torch.inference_mode():
            data = predictor.prepare_frame(tactile, joint)
            if predictor.window is not None:
                ring = self._frame_ring(data.x)
                ring.push(data.x[0])
                if not (predict and ring.is_full):
                    return None
                data = predictor.prepare_window(data, ring.window())
            elif not predict:
                return None
            start = perf_counter_ns()
            out = predictor.probability(predictor.logits(data))[0].cpu().float().numpy()
        self.model_ns = perf_counter_ns() - start
        return np.full_like(out, np.nan) if rule is not None and self.lacks_contact else out

    def _frame_ring(self, x: Any) -> Any:
        from torch_geometric_tactile.data import FrameRing

        if self._ring is None:
            self._ring = FrameRing(self.length, x.size(1), x.size(2), x.dtype)
        return self._ring


def _load_predictor(path: PathLike) -> Any:
    from torch_geometric_tactile.predictor import Predictor, predictor_path
    from torch_geometric_tactile.predictor._content import is_checkpoint

    path = predictor_path(path)
    read = Predictor.from_checkpoint if is_checkpoint(path) else Predictor.load
    return read(path)
