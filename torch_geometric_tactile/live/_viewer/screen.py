r"""What all pages of a viewer show at a time."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._viewer.message import pack_message
from torch_geometric_tactile.live._viewer.rest import ViewerRest
from torch_geometric_tactile.live._viewer.scene import Scene, layout_scene, number_scene

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_LOG = logging.getLogger(__name__)
_NOTES = 20
_SHOWN_HEALTH = (
    *("state", "frames", "rate", "jitter", "lost", "corrupt", "skipped", "repeated"),
    *("reconnects", "stale_taxels", "age", "checksum"),
)


class ViewerScreen:
    r"""The scene, the rest, the notes and the last judgement, for any number of pages. Frames are
    asked for by one thread; notes and judgements may come from any.
    """

    def __init__(
        self,
        stream: Any,
        layout: "TaxelLayout | PathLike | None",
        joint: np.ndarray | None,
        kinematics: "HandKinematics | None",
    ) -> None:
        self.stream = stream
        self.rest = ViewerRest()
        self.judgement: Any = None
        self.recording_since: float | None = None
        self.on_tare: Callable[[], object] | None = None
        self.on_record: Callable[[], object] | None = None
        self.notes: deque[tuple[int, float, str]] = deque(maxlen=_NOTES)
        self._numbers = 0
        self._layout = None if layout is None else _opened(layout)
        self._asked = layout is not None
        self._joint, self._kinematics = joint, kinematics
        self._scene: Scene | None = None
        self._lock = threading.Lock()
        self._posed: tuple[np.ndarray, np.ndarray] | None = None
        if self._layout is not None:  # what does not fit is told before anything runs
            self._layout_scene = layout_scene(self._layout, kinematics, joint)

    def note(self, text: str) -> None:
        r"""Keeps a line for the pages."""
        self._numbers += 1
        self.notes.append((self._numbers, time.time(), text))

    def scene(self, num_taxels: int) -> Scene:
        r"""Returns the scene of frames with this number of taxels; the same one if asked again.

        Shapes:
            - **num_taxels:** Number of taxels :math:`N`.
        """
        with self._lock:
            if self._scene is None or self._scene.num_taxels != num_taxels:
                self._posed = None
                self._scene = self._new_scene(num_taxels)
            return self._scene

    def prepare(self) -> None:
        r"""Reads the layout that the source names, if it does already."""
        with self._lock:
            if self._layout is None and not self._asked and self.stream.meta.get("sensor"):
                self._find_layout(self.stream.meta["sensor"])

    def _new_scene(self, num_taxels: int) -> Scene:
        if self._layout is None and not self._asked:
            self._find_layout(self.stream.meta.get("sensor"))
        if self._layout is None:
            return number_scene(num_taxels)
        if self._layout.num_taxels == num_taxels:
            return self._layout_scene
        self.note(
            f"Layout {self._layout.name} has {self._layout.num_taxels} taxels, and frames have "
            f"{num_taxels}: shown by number"
        )
        return number_scene(num_taxels)

    def _find_layout(self, name: Any) -> None:
        self._asked = True
        if name is None:
            return
        try:
            from torch_geometric_tactile.sensors import stock_layout, stock_names

            if name in stock_names("layouts"):
                self._layout = stock_layout(name)
                self._layout_scene = layout_scene(self._layout, self._kinematics, self._joint)
        except ImportError:
            self.note(f"Layout {name} needs PyTorch: shown by number")

    def pose(self, scene: Scene, joint: np.ndarray | None) -> np.ndarray:
        r"""Returns the poses of the links; the same array while the joints do not move."""
        kept = self._posed
        if (
            joint is None
            or scene.kinematics is None
            or joint.shape != (scene.num_joints,)
            or not np.isfinite(joint).all()
        ):
            return scene.pose if kept is None else kept[1]
        if kept is None or not np.array_equal(kept[0], joint):
            self._posed = kept = (joint.copy(), scene.posed(joint))
        return kept[1]

    def layout_message(self, scene: Scene, channels: int) -> bytes:
        r"""Returns what a page is told once: where the taxels are, and what they read.

        Shapes:
            - **channels:** Number of channels :math:`C`.
        """
        head = {
            "kind": "layout",
            "source": self.stream.source.name,
            "unit": self.stream.meta.get("unit"),
            "channels": channels,
            **scene.head(),
        }
        return pack_message(head, scene.arrays())

    def relative(self, frame: LiveFrame) -> np.ndarray:
        r"""Returns the readings of a frame relative to the rest, float32 :math:`(N, C)`."""
        return self.rest.relative(frame.time, frame.tactile).astype(np.float32)

    def facts(self, since_note: int) -> dict[str, Any]:
        r"""Returns what changes beside the readings."""
        since = self.recording_since
        return {
            "source": self.stream.source.name,
            "health": self._health(),
            "rest": self.rest.kind,
            "recording": None if since is None else time.perf_counter() - since,
            "can_record": self.on_record is not None,
            "judgement": self._judged(),
            "notes": [note for note in tuple(self.notes) if note[0] > since_note],
        }

    def _health(self) -> dict[str, Any]:
        health = self.stream.health()
        facts = {name: getattr(health, name, None) for name in _SHOWN_HEALTH}
        error = getattr(self.stream, "error", None)
        return {**facts, "error": None if error is None else str(error) or type(error).__name__}

    def _judged(self) -> dict[str, Any] | None:
        judgement = self.judgement
        if judgement is None:
            return None
        return {
            "label": _shown_label(judgement),
            "task": judgement.task,
            "names": list(judgement.class_names),
            "probability": np.asarray(judgement.probability, dtype=float).tolist(),
            "latency": (judgement.finished - judgement.received) / 1e6,
            "since": (time.perf_counter_ns() - judgement.finished) / 1e9,
        }

    def tare(self) -> None:
        r"""Calls :obj:`on_tare`, or measures the rest that is shown anew."""
        if self.on_tare is None:
            self.rest.given = None
            self.rest.again()
            self.note("Rest measured anew")
        else:
            self._call(self.on_tare, "The tare")

    def record(self, wanted: bool) -> None:
        r"""Calls :obj:`on_record`, if this would change what is recorded."""
        if self.on_record is not None and wanted != (self.recording_since is not None):
            self._call(self.on_record, "The recording")

    def _call(self, callback: Callable[[], object], what: str) -> None:
        try:
            callback()
        except Exception as error:  # of the caller: told where the button is
            _LOG.warning("%s failed: %s", what, error)
            self.note(f"{what} failed: {error}")


def _shown_label(judgement: Any) -> str:
    if np.isnan(judgement.probability).any():
        return "no answer"
    if judgement.task == "regression":
        return ""
    label: str = judgement.label
    return (label.replace(";", ", ") or "none") if judgement.task == "multilabel" else label


def _opened(layout: Any) -> "TaxelLayout":
    from torch_geometric_tactile.sensors import as_layout

    return as_layout(layout)
