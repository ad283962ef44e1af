r"""The board: the same models on all real data sets, each with one fixed protocol."""

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
    r"""One column of the board: a data set with its fixed protocol.

    Args:
        name (str): Name of the column.
        dataset (str): Name of a class of :mod:`torch_geometric_tactile.datasets`.
        task (str): The classes and what is new in the test part, in words.
        by (str): The unit that a split keeps together, as in :class:`ComparisonSettings`.
        arguments (dict): Arguments of the class, except its root.
        stride (int, optional): Keeps every :obj:`stride`-th frame of each trial.
        trials (int, optional): Number of frames that whole trials are resampled to.
        rest (int, optional): Number of frames at the start of each trial in which nothing touches
            the sensor.
        ranks (bool): Whether the data set counts for the mean rank. It does not count if a
            shortcut in the data set or perfect scores make models look alike.
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
        {"root": None},  # scikit-learn contains them
    ),
    BoardSet(
        "iCub",
        "ICubGrasp",
        "ten objects, every fourth frame; new trials, five folds (the first frame is enough)",
        "trial",
        stride=4,
        ranks=False,
    ),
    BoardSet(
        "eFlesh",
        "EFleshSlip",
        "slip or hold, 30 frames minus their rest; another run of slip (too easy)",
        "given",
        trials=30,
        rest=10,
        ranks=False,
    ),
)


class BoardColumn(NamedTuple):
    r"""The comparisons of the stock models and of the user's models on one data set."""

    board_set: BoardSet
    comparisons: Sequence[Comparison]

    @property
    def results(self) -> dict[str, ModelResult]:
        r"""The result of each model by its name, best model first."""
        scored_results = [
            (comparison.goodness(result), result)
            for comparison in self.comparisons
            for result in comparison.results
        ]
        scored_results.sort(key=lambda pair: -pair[0])
        return {result.model.name: result for _, result in scored_results}

    def places(self) -> dict[str, float]:
        r"""Returns the place of each model, 1 for the best. Models with equal scores share the mean
        of their places.
        """
        scores = {n: round(r.scores["accuracy"].mean, 6) for n, r in self.results.items()}
        return {
            name: 1 + sum(s > score for s in scores.values())
            + (sum(s == score for s in scores.values()) - 1) / 2
            for name, score in scores.items()
        }  # fmt: skip


def board_plans(
    data: PathLike | None,
    user_models: Sequence[str] = (),
    names: Sequence[str] | None = None,
    **overrides: Any,
) -> Iterator[tuple[BoardSet, list[Plan]]]:
    r"""Yields the data sets of the board that can be opened, each with one or two plans: for the
    stock models that fit it and, if there are any, for the user's models. Data sets with missing
    files are logged and skipped.

    Args:
        data (str or PathLike, optional): A folder with a subfolder for each data set, named like
            its class. If left out, each data set is read from its default root.
        user_models (sequence of str): Import paths of the user's models.
        names (sequence of str, optional): Names of the columns. Defaults to all columns.
        **overrides (Any): Further :class:`ComparisonSettings`.

    Raises:
        ValueError: If a name is unknown.
    """
    board_names = [board_set.name for board_set in BOARD]
    unknown = [name for name in names or () if name not in board_names]
    if unknown:
        raise ArgumentError(
            Argument("names"), f" must be some of {', '.join(board_names)} (got '{unknown[0]}')"
        )
    for board_set in BOARD:
        if names is not None and board_set.name not in names:
            continue
        arguments = dict(board_set.arguments)
        if data is not None:
            arguments.setdefault("root", str(Path(data) / board_set.dataset))
        cut = None if board_set.trials is None else FrameCut(trials=board_set.trials)
        tare = None if board_set.rest is None else {"key": "trial", "first": board_set.rest}
        settings = {"by": board_set.by, "tare": tare, "metric": "accuracy", **overrides}
        try:
            path = f"torch_geometric_tactile.datasets.{board_set.dataset}"
            source = data_source(path, arguments=arguments, stride=board_set.stride, cut=cut)
            plans = [
                comparison_plan(
                    source, ComparisonSettings(models=models, **settings), name=board_set.name
                )
                for models in (None, *((tuple(user_models),) if user_models else ()))
            ]
        except (FileNotFoundError, ConnectionError) as error:
            reason = str(error).partition("\n")[0]
            _logger.warning("%s is left out: %s", board_set.name, reason)
            continue
        yield board_set, plans
