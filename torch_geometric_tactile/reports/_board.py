r"""The page of the board, which ranks models over data sets."""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import markdown_table, markdown_text
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.experiments._board import BoardColumn

_RANK_COLUMNS = ("model", "mean rank", "ranked sets")
_NUM_SETS_PER_TABLE = 3  # a table with the columns of the ranks then has six columns


def board_rows(columns: Sequence[BoardColumn]) -> tuple[list[str], list[list[str]]]:
    r"""Returns the header and the rows of the board, sorted by mean rank."""
    places_by_set = [column.places() for column in columns if column.board_set.ranks]
    names = list(dict.fromkeys(name for column in columns for name in column.results))
    mean_place = {
        name: statistics.fmean(model_places)
        for name in names
        if (model_places := [places[name] for places in places_by_set if name in places])
    }
    num_sets = {name: sum(name in places for places in places_by_set) for name in names}
    header = [*_RANK_COLUMNS, *(column.board_set.name for column in columns)]
    ordered = sorted(names, key=lambda name: (name not in mean_place, mean_place.get(name, 0.0)))
    rows = [
        [
            name,
            f"{mean_place[name]:.1f}" if name in mean_place else "",
            str(num_sets[name]),
            *(_accuracy_cell(column, name) for column in columns),
        ]
        for name in ordered
    ]
    return header, rows


def _accuracy_cell(column: BoardColumn, name: str) -> str:
    result = column.results.get(name)
    if result is None:
        return ""
    mean, sd = (100 * value for value in result.scores["accuracy"])
    text = f"{mean:.1f}" + (f" ± {sd:.1f}" if sd == sd else "")  # NaN for a single fold
    # Two models that share the first place are both at 1.5.
    return f"**{text}**" if column.places()[name] < 2 else text


def board_markdown(columns: Sequence[BoardColumn], machine: str, hours: float) -> str:
    r"""Returns the page of the board as Markdown."""
    header, rows = board_rows(columns)
    set_rows = [
        [
            markdown_text(column.board_set.name),
            f"`{column.board_set.dataset}`",
            markdown_text(column.board_set.task),
            f"{plan.facts.num_samples:,}",
            markdown_text(plan.protocols[0].protocol.describe()),
            "" if column.board_set.ranks else "no",
        ]
        for column in columns
        for plan in [column.comparisons[0].run.plan]
    ]
    return "\n".join(
        [
            "# The board",
            "",
            "This page compares all models of `tactile compare` on all real data sets that were "
            "available. Use it to see which models do well on data like yours.",
            "",
            "Models have their default settings, and readings are only scaled. The tables show the "
            "accuracy in percent on the test part, as mean and standard deviation over the folds. "
            "The best accuracy of each column is bold. The mean rank (1 is the best) is over the "
            "data sets that rank models and that the model supports; the next column counts them.",
            "",
            *_score_tables(header, rows),
            "",
            "## The data sets",
            "",
            *markdown_table(
                ["set", "class", "task; test part", "samples", "split", "ranks models"],
                set_rows,
            ),
            "",
            f"All runs have seed 0. They took {hours:.1f} hours of training and testing "
            f"({machine}).",
            "",
            "`tactile board --data DIR` writes this page and resumes an interrupted run. `--own "
            "my_nets.MyNet` adds your own model by its import path.",
            "",
        ]
    )


def _score_tables(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    r"""Returns the lines of one Markdown table for each three data sets. The first one also has the
    ranks; the others leave out models without a score.
    """
    lines: list[str] = []
    num_rank_columns = len(_RANK_COLUMNS)
    for start in range(num_rank_columns, len(header), _NUM_SETS_PER_TABLE):
        stop = start + _NUM_SETS_PER_TABLE
        is_first = start == num_rank_columns
        num_names = num_rank_columns if is_first else 1
        table_rows = [
            [_code(row[0]), *row[1:num_names], *row[start:stop]]
            for row in rows
            if is_first or any(row[start:stop])
        ]
        lines += ["", *markdown_table([*header[:num_names], *header[start:stop]], table_rows)]
    return lines[1:]


def write_board(
    columns: Sequence[BoardColumn], out: PathLike, machine: str, hours: float
) -> list[Path]:
    r"""Writes :obj:`board.md` and :obj:`board.json`, and returns their paths."""
    scores = {
        column.board_set.name: {
            name: dict(zip(("mean", "sd"), result.scores["accuracy"], strict=True))
            for name, result in column.results.items()
        }
        for column in columns
    }
    texts = {
        "board.md": board_markdown(columns, machine, hours),
        "board.json": json.dumps({"accuracy": scores, "machine": machine}, indent=1) + "\n",
    }
    paths = [Path(out) / name for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        with atomic_path(path) as temporary:
            # JSON has no NaN.
            temporary.write_text(text.replace("NaN", "null"), encoding="utf-8")
    return paths


def _code(name: str) -> str:
    return f"`{name}`"
