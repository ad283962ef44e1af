"""Which products of parameters run."""

from itertools import combinations, product

import pytest
from pairs import select_pairs


class Case:
    """A test as pytest collects it: its name and the values of its parameters."""

    def __init__(self, name, parameters=None, values=()):
        self.nodeid = f"{name}[{values}]"
        if parameters is not None:
            self.callspec = self
            self.params = dict(zip(parameters, values, strict=True))
            self.markers = [pytest.mark.parametrize(*entry).mark for entry in parameters.items()]

    def iter_markers(self, name):
        assert name == "parametrize"
        return self.markers


def cases(name, **parameters):
    """The tests of a function with a decorator for each parameter."""
    return [Case(name, parameters, values) for values in product(*parameters.values())]


def test_every_pair_of_values_runs_and_few_products():
    parameters = {"kind": "ab", "size": [1, 2, 3], "dtype": ["float", "double"], "bad": [None, 0.5]}
    items = cases("test_four", **parameters)
    selected = select_pairs(items)
    pairs = {pair for item in selected for pair in combinations(item.params.items(), 2)}
    assert pairs == {
        ((first, a), (second, b))
        for first, second in combinations(parameters, 2)
        for a in parameters[first]
        for b in parameters[second]
    }
    assert len(selected) < len(items) / 2
    assert selected == [item for item in items if item in selected]  # in their order


def test_tests_with_two_parameters_or_none_run_whole():
    items = [*cases("test_two", kind="ab", size=[1, 2, 3]), Case("test_plain")]
    assert select_pairs(items) == items
