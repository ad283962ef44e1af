r"""Status of a live session."""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.live.health import Health
from torch_geometric_tactile.live.judge import Judgement


class Status(NamedTuple):
    r"""The state of a live session, reported about twice a second.

    Args:
        health (Health): Health of the stream.
        judgement (Judgement, optional): The last prediction.
        latency (float, optional): Median latency of the last predictions in seconds.
        recorded (int, optional): Number of recorded frames; :obj:`None` without a recorder.
        note (str): A message, such as the reason why a rest was rejected.
        annotation (str, optional): Label of the current annotation.

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
        r"""Returns the status as one line. The last prediction is left out while no frames arrive;
        the note then comes first."""
        parts = [self.health.line()]
        is_current = self.health.state not in ("silent", "lost")
        has_judgement = is_current and self.judgement is not None
        if self.judgement is not None and is_current:
            parts.append(_format_judgement(self.judgement))
        if self.latency is not None and is_current:
            parts.append(f"latency {1000 * self.latency:.1f} ms")
        if self.recorded is not None:
            parts.append(f"recorded {self.recorded}")
        if self.note:  # first, since a narrow terminal cuts the end
            parts.insert(len(parts) if has_judgement else 0, self.note)
        if self.annotation is not None:
            parts.insert(0, f"[{self.annotation}]")
        return "  ".join(parts)


def _format_judgement(judgement: Judgement) -> str:
    r"""Returns a prediction in a few characters, such as :obj:`"slip 93 %"`."""
    probability = judgement.probability
    if judgement.lacks_contact:
        return judgement.label
    if np.isnan(probability).any():
        return "no answer (readings are missing)"
    if judgement.task == "regression":
        pairs = zip(judgement.class_names, probability, strict=True)
        return " ".join(f"{name} {value:.4g}" for name, value in pairs)
    if judgement.task == "multilabel":
        return judgement.label.replace(";", ", ") or "none of the labels"
    return (
        f"{judgement.label} {100 * probability[judgement.class_names.index(judgement.label)]:.0f} %"
    )
