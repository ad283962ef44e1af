r"""What of a model is chosen on a validation part, as a value."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

METRICS = ("accuracy", "balanced_accuracy", "mae")


@dataclass(frozen=True, eq=False)
class Choice:
    r"""How the settings of a model are chosen: each setting is trained on the
    training part without a validation part, which is cut from it by the protocol of the test, and
    scored there; the best of them (the first, of equals) is trained on the whole training part.
    """

    settings: Sequence[Mapping[str, Any]] = ({},)
    metric: str = "accuracy"
    members: int = 1

    def __post_init__(self) -> None:
        if self.metric not in METRICS:
            raise ValueError(f"'metric' must be one of {list(METRICS)} (got '{self.metric}')")
        if not self.settings:
            raise ValueError("'settings' must hold at least one setting (got none)")
        if self.members < 1:
            raise ValueError(f"'members' must be at least 1 (got {self.members})")

    @property
    def of_numbers(self) -> bool:
        r"""Whether :obj:`y` is numbers, not classes."""
        return self.metric == "mae"

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values."""
        return {**asdict(self), "settings": [dict(setting) for setting in self.settings]}
