r"""The board: the same models on all real data sets, each by one fixed protocol."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.experiments.compared_windows import FrameCut, data_source
from torch_geometric_tactile.experiments.comparison import (
    Comparison,
    ComparisonSettings,
    ModelResult,
    comparison_plan,
)
from torch_geometric_tactile.experiments.plan import Plan

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BoardSet:
    r"""One column of the board.

    Args:
        name (str): Its name.
        dataset (str): The class of :mod:`torch_geometric_tactile.datasets`.
        task (str): What is predicted, and what is new in the test part.
        by (str): What a split keeps together, as in :class:`ComparisonSettings`.
        arguments (dict): Arguments of the class, but for its root.
        stride (int, optional): Which frames of each trial.
        trials (int, optional): The number of frames that whole trials are resampled to.
        rest (int, optional): How many first frames of each trial are at rest.
        ranks (bool): Whether it counts for the mean place; not where a trap of the data set or
            perfect scores tell nothing of models.
    """

    name: str
    dataset: str
    task: str
    by: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    stride: int | None = None
    trials: int | None = None
    rest: int | None = None
    ranks: bool = True


BOARD: tuple[BoardSet, ...] = (
    BoardSet(
        "BTS3",
        "BioTacSP",
        "slip or stable; new objects in other sessions, the official test",
        "given",
        {"split": None},
    ),
    BoardSet(
        "DoS",
        "BioTacSPDoS",
        "direction of slip; new objects, every tenth frame",
        "given",
        stride=10,
    ),
    BoardSet(
        "mat",
        "PressureMat",
        "17 postures, every 32nd frame; new persons, five folds",
        "group",
        stride=32,
    ),
    BoardSet(
        "mattresses",
        "PressureMat",
        "supine, left or right on two mattresses; new persons, five folds",
        "group",
        {"experiment": "ii", "target": "side"},
    ),
    BoardSet(
        "Braille",
        "BrailleLetters",
        "27 letters, slides of 40 frames; new slides, five folds",
        "trial",
        trials=40,
    ),
    BoardSet(
        "materials",
        "BioTacSlide",
        "20 materials, slides of 40 frames; new slides, five folds",
        "trial",
        trials=40,
    ),
    BoardSet(
        "picks",
        "USkinPick",
        "does the object fall, picks of 40 frames; the published parts",
        "given",
        trials=40,
    ),
    BoardSet(
        "glove",
        "TactileGlove",
        "27 objects, every 20th frame; the published parts",
        "given",
        stride=20,
    ),
    BoardSet("letters", "LetterShape", "26 letters; new presses, five folds", "trial"),
    BoardSet(
        "digits",
        "DigitImages",
        "ten digits of ink; new images, five folds",
        "trial",
        {"root": None},  # they come with scikit-learn
    ),
    BoardSet(
        "iCub",
        "ICubGrasp",
        "ten objects, every fourth frame; new trials, five folds (the first frame tells)",
        "trial",
        stride=4,
        ranks=False,
    ),
    BoardSet(
        "eFlesh",
        "EFleshSlip",
        "slip or hold, sequences of 30 frames less their rest; another run of slip (too easy)",
        "given",
        trials=30,
        rest=10,
        ranks=False,
    ),
)


class BoardColumn(NamedTuple):
    r"""What came of one data set: the comparison of the stock models, and those of one's own."""

    board_set: BoardSet
    comparisons: Sequence[Comparison]

    @property
    def results(self) -> dict[str, ModelResult]:
        r"""What came of each model, the best first."""
        found = [(one.goodness(r), r) for one in self.comparisons for r in one.results]
        found.sort(key=lambda pair: -pair[0])
        return {result.model.name: result for _, result in found}

    def places(self) -> dict[str, float]:
        r"""The place of each model, 1 for the best; models with one score share the mean place."""
        scores = {n: round(r.scores["accuracy"].mean, 6) for n, r in self.results.items()}
        return {
            name: 1 + sum(s > score for s in scores.values())
            + (sum(s == score for s in scores.values()) - 1) / 2
            for name, score in scores.items()
        }  # fmt: skip


def board_plans(
    data: PathLike | None, own: Sequence[str] = (), names: Sequence[str] | None = None, **more: Any
) -> Iterator[tuple[BoardSet, list[Plan]]]:
    r"""Yields the data sets of the board that can be opened, with the plan of our models that fit
    them, and that of the user's own. A set whose files are missing is named in the log.

    Args:
        data (str or PathLike, optional): The folder that has a folder for each data set, named
            like its class; the default root of each if left out.
        own (sequence of str): Import paths of models of one's own.
        names (sequence of str, optional): Names of the sets; all if left out.
        **more (Any): Further :class:`ComparisonSettings`.
    """
    known = [board_set.name for board_set in BOARD]
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise ArgumentError(
            Argument("names"), f" must be some of {', '.join(known)} (got '{unknown[0]}')"
        )
    for board_set in BOARD:
        if names is not None and board_set.name not in names:
            continue
        arguments = dict(board_set.arguments)
        if data is not None:
            arguments.setdefault("root", str(Path(data) / board_set.dataset))
        cut = None if board_set.trials is None else FrameCut(trials=board_set.trials)
        tare = None if board_set.rest is None else {"key": "trial", "first": board_set.rest}
        settings = {"by": board_set.by, "tare": tare, "metric": "accuracy", **more}
        try:
            path = f"torch_geometric_tactile.datasets.{board_set.dataset}"
            source = data_source(path, arguments=arguments, stride=board_set.stride, cut=cut)
            plans = [
                comparison_plan(
                    source, ComparisonSettings(models=m, **settings), name=board_set.name
                )
                for m in (None, *((tuple(own),) if own else ()))
            ]
        except (FileNotFoundError, ConnectionError) as error:
            reason = str(error).partition("\n")[0]
            _logger.warning("%s is left out: %s", board_set.name, reason)
            continue
        yield board_set, plans
