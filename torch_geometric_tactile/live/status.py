r"""What a live session tells of itself."""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.live.health import Health
from torch_geometric_tactile.live.judge import Judgement


class Status(NamedTuple):
    r"""The state of a live session, reported about twice a second: the health of its stream, the
    last prediction, the median latency of the last predictions in seconds, the number of recorded
    frames (:obj:`None` if there is no recorder), a note, such as why the rest was refused, and the
    label of the annotation that is open.

    Examples:
        >>> status = Status(Health("open", rate=100.0), None, latency=0.002, recorded=50, note="")
        >>> status.line()
        '100.0 Hz  jitter 0.0 ms  lost 0  corrupt 0  latency 2.0 ms  recorded 50'
    """

    health: Health
    judgement: Judgement | None
    latency: float | None
    recorded: int | None
    note: str
    annotation: str | None = None

    def line(self) -> str:
        r"""Returns it on one line. The last prediction is left out while no frames come; where none
        is shown, the note is first."""
        parts = [self.health.line()]
        fresh = self.health.state not in ("silent", "lost")
        judged = fresh and self.judgement is not None
        if self.judgement is not None and fresh:
            parts.append(_described(self.judgement))
        if self.latency is not None and fresh:
            parts.append(f"latency {1000 * self.latency:.1f} ms")
        if self.recorded is not None:
            parts.append(f"recorded {self.recorded}")
        if self.note:  # a narrow terminal cuts the end, and what to do is not cut
            parts.insert(len(parts) if judged else 0, self.note)
        if self.annotation is not None:
            parts.insert(0, f"[{self.annotation}]")
        return "  ".join(parts)


def _described(judgement: Judgement) -> str:
    r"""Returns a prediction in a few characters, such as :obj:`"slip 93 %"`."""
    probability = judgement.probability
    if judgement.lacks_contact:
        return judgement.label
    if np.isnan(probability).any():
        return "no answer (readings are missing)"
    if judgement.task == "regression":
        named = zip(judgement.class_names, probability, strict=True)
        return " ".join(f"{name} {value:.4g}" for name, value in named)
    if judgement.task == "multilabel":
        return judgement.label.replace(";", ", ") or "none of the labels"
    return (
        f"{judgement.label} {100 * probability[judgement.class_names.index(judgement.label)]:.0f} %"
    )
