r"""The seven combining patterns of the MS-CNN: the maps and filters of each convolution."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

Level = Literal["patch", "finger", "hand"]
LEVELS: tuple[Level, ...] = ("patch", "finger", "hand")
NO_OTHERS: Mapping[str, tuple[int, int]] = MappingProxyType({})


class Stage(NamedTuple):
    r"""One convolution of a pattern."""

    level: Level
    size: tuple[int, int]
    stride: int = 1
    others: Mapping[str, tuple[int, int]] = NO_OTHERS

    def filter_of(self, kinds: tuple[str, ...]) -> tuple[int, int]:
        r"""Returns height and width of the filters of a map."""
        return next((self.others[kind] for kind in kinds if kind in self.others), self.size)


#: Three convolutions each. Pattern IV gives 2 x 2 to the thumb and 4 x 2 to the fingers: the text
#: has it the other way round, which gives neither equal heights nor the printed size.
PATTERNS: Mapping[str, tuple[Stage, Stage, Stage]] = MappingProxyType(
    {
        "I": (Stage("hand", (3, 3), stride=2), Stage("hand", (3, 3)), Stage("hand", (2, 2))),
        "II": (
            Stage("patch", (3, 3), others={"thumb phalanx": (2, 3)}),
            Stage("hand", (3, 3)),
            Stage("hand", (4, 3)),
        ),
        "III": (
            Stage("patch", (3, 3)),
            Stage("patch", (2, 2), others={"tip": (3, 2), "thumb tip": (2, 2)}),
            Stage("hand", (2, 1)),
        ),
        "IV": (
            Stage("patch", (3, 3)),
            Stage("finger", (4, 2), others={"thumb": (2, 2)}),
            Stage("hand", (2, 2)),
        ),
        "V": (Stage("patch", (2, 2)), Stage("finger", (5, 2)), Stage("finger", (5, 2))),
        "VI": (Stage("patch", (2, 2)), Stage("patch", (2, 2)), Stage("patch", (2, 2))),
        "VII": (
            Stage("finger", (4, 2), stride=2),
            Stage("finger", (3, 2)),
            Stage("finger", (2, 1)),
        ),
    }
)
