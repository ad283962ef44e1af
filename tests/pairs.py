"""Tests with several parameters run on a selection of their products that has every pair."""

from collections import defaultdict
from itertools import combinations


def select_pairs(items):
    """Returns the tests to run: of a test with three parameters or more, as few of the products as
    a greedy choice needs for every pair of values of two parameters.
    """
    products = defaultdict(list)
    for item in items:
        products[item.nodeid.partition("[")[0]].append(item)
    selected = set()
    for cases in products.values():
        selected.update(_cover_pairs(cases))
    return [item for item in items if item in selected]


def _cover_pairs(cases):
    pairs = {item: _pairs(item) for item in cases}
    if len(cases) == 1 or not all(pairs.values()):  # fewer than three parameters
        return cases
    missing = set().union(*pairs.values())
    cover = []
    while missing:
        best = max(pairs, key=lambda item: len(pairs[item] & missing))
        missing -= pairs.pop(best)
        cover.append(best)
    return cover


def _pairs(item):
    # Names that one decorator sets together are one parameter.
    if not hasattr(item, "callspec"):
        return set()
    values = {name: id(value) for name, value in item.callspec.params.items()}
    parameters = []
    for marker in item.iter_markers("parametrize"):
        names = marker.args[0] if marker.args else marker.kwargs["argnames"]
        names = [n.strip() for n in names.split(",")] if isinstance(names, str) else names
        parameters.append((names[0], tuple(values.pop(name) for name in names)))
    parameters += [(name, (value,)) for name, value in values.items()]  # of fixtures
    if len(parameters) < 3:
        return set()
    return set(combinations(sorted(parameters), 2))
