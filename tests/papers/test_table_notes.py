import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from dataclasses import replace

from torch_geometric_tactile.experiments.differences import Difference
from torch_geometric_tactile.experiments.tables import Ordering
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.papers._table_notes import (
    OrderedPair,
    _pair_cells,
    _verdict_rows,
)

ORDERING = Ordering("a above b", (("a", "b"), ("c", "d")))


def compared(mean, error, pair=("a", "b"), protocol="random"):
    return OrderedPair(ORDERING, protocol, pair, Difference(mean, error, error / 2, 5, 100))


@pytest.mark.parametrize(
    ("mean", "error", "verdict"),
    [
        (0.1, 0.03, "yes"),
        (-0.1, 0.03, "no"),
        (0.1, 0.04, "within the noise"),
        (0.0, 0.0, "within the noise"),
    ],
)
def test_verdict_is_that_of_the_difference(mean, error, verdict):
    assert compared(mean, error).verdict == verdict
    few = replace(compared(mean, error), difference=Difference(mean, error, error, 2, 100))
    assert few.verdict == "too few splits"


def test_lines_of_the_page():
    entries = [compared(0.1, 0.03), compared(-0.2, 0.03, ("c", "d"))]
    assert " ".join(_pair_cells(entries[0])) == "a above b random a b 10 3 5 yes"
    assert _pair_cells(compared(-0.2, float("nan")))[4:6] == ["-20", ""]
    assert list(_verdict_rows(entries)) == [["a above b", "random", "yes in 1 of 2, no in 1 of 2"]]
    assert list(_verdict_rows(entries[:1])) == [["a above b", "random", "yes"]]


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (
            {"orderings": (Ordering("x above y", (("x", "gcn_df"),)),)},
            r"'x above y' of table 'p3' must be of its experiments \(got \['x'\]\)",
        ),
        ({"axis": "k"}, r"the columns of table 'p3' must be numbers, .* \(got 'left'\)"),
    ],
)
def test_wrong_tables(changes, match):
    with pytest.raises(ValueError, match=match):
        replace(load_table("p3"), **changes)


def test_ordering_needs_a_pair():
    with pytest.raises(ValueError, match="'pairs' of 'nothing' must hold at least one pair"):
        Ordering("nothing", ())


def test_threshold_of_a_cell_is_a_metric():
    with pytest.raises(ValueError, match=r"'threshold' of 'svm_f' must be one of .*got 'recall'"):
        replace(load_table("p3").cells[3], threshold="recall")
