r"""How long the last judgements took."""

import statistics
from collections import deque
from collections.abc import Mapping


class Latencies:
    r"""The latencies of the last judgements by part, in seconds."""

    def __init__(self, size: int = 500) -> None:
        self._kept: deque[Mapping[str, float]] = deque(maxlen=size)

    def add(self, latency: Mapping[str, float]) -> None:
        r"""Takes those of one judgement."""
        self._kept.append(latency)

    def median(self, part: str = "total") -> float | None:
        r"""Returns the median of a part, or :obj:`None` without judgements."""
        kept = [one[part] for one in list(self._kept)]
        return statistics.median(kept) if kept else None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self._kept)})"
