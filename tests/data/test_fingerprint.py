import copy
import enum
import functools
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
import torch_geometric.transforms as T
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._fingerprint import (
    constructor_arguments,
    describe,
    setting_changes,
    state_changes,
    without_code,
)
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin, biotac_sp, grid
from torch_geometric_tactile.transforms import CommonMode, KNNGraph, TaxelPose, ZScore


class Kind(enum.Enum):
    A = 1
    B = 2


class Pair(NamedTuple):
    a: int
    b: int


class Plain:
    pass


class Slotted:
    __slots__ = ("k",)

    def __init__(self, k):
        self.k = k


class Private:
    def __init__(self, k):
        self._k = k
        self._cache = []


class Cached(Private):
    def __getstate__(self):
        return {"_k": self._k}


class Centred(torch.nn.Module):
    def __init__(self, center):
        super().__init__()
        self._center = torch.tensor([center])


class OwnCommonMode(CommonMode):
    def __init__(self, times):
        super().__init__([0, 0, 1])
        self._times = {"x": [times]}


def double(data):
    return 2 * data


def triple(data):
    return 3 * data


def times(k):
    return lambda data: k * data


def fitted(center):
    score = ZScore()
    score.center = torch.tensor([center])
    return score


DIFFERENT = [
    (1, 2),
    (1, 1.0),
    (1, True),
    ("a", "b"),
    (None, "None"),
    ([1], (1,)),
    ((1, 2), (2, 1)),
    ({"a": 1}, {"a": 2}),
    ({1, 2}, {1, 3}),
    (Kind.A, Kind.B),
    (Pair(1, 2), Pair(1, 3)),
    (Path("a"), Path("b")),
    (range(3), range(4)),
    (torch.zeros(2), torch.ones(2)),
    (torch.zeros(2), torch.zeros(2, 1)),
    (torch.zeros(2), torch.zeros(2).double()),
    (torch.zeros(()), torch.ones(())),
    (torch.eye(2).to_sparse(), torch.eye(3).to_sparse()),
    (np.zeros(2), np.ones(2)),
    (np.array(["a"]), np.array(["b"])),
    (torch.float, torch.double),
    (grid(2, 2, 0.01), grid(2, 2, 0.02)),
    (grid(2, 2, 0.01), grid(2, 3, 0.01)),
    (double, triple),
    (times(2), times(3)),
    (functools.partial(double, 1), functools.partial(double, 2)),
    (Plain, Pair),
    (Slotted(1), Slotted(2)),
    (Private(1), Private(2)),
    (Private([2]), Private([3])),
    (Private({"a": (1, torch.zeros(1))}), Private({"a": (1, torch.ones(1))})),
    (Private(np.zeros(2)), Private(np.ones(2))),
    (Private(double), Private(triple)),
    (Private(T.Distance()), Private(T.Cartesian())),
    (Private([T.KNNGraph(2)]), Private([T.KNNGraph(3)])),
    (Private(grid(2, 2, 0.01)), Private(grid(2, 2, 0.02))),
    (Centred(1.0), Centred(2.0)),
    (CommonMode([0, 0, 0, 1, 1, 1]), CommonMode([0, 1, 0, 1, 0, 1])),
    (CommonMode("digit", allegro_uskin()), CommonMode("patch", allegro_uskin())),
    (OwnCommonMode(1), OwnCommonMode(2)),
    (KNNGraph(2), KNNGraph(3)),
    (KNNGraph(2), T.KNNGraph(2)),
    (T.Distance(), T.Distance(cat=False)),
    (T.Compose([T.Distance()]), T.Compose([T.Cartesian()])),
    (fitted(1.0), fitted(2.0)),
    (TaxelPose(), TaxelPose(normal=False)),
    (torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)),
    (T.Distance().forward, T.Distance(cat=False).forward),
]


@pytest.mark.parametrize(("one", "other"), DIFFERENT, ids=lambda value: str(value)[:20])
def test_other_values_are_described_otherwise(one, other):
    assert describe(one) != describe(other)
    assert " at 0x" not in describe(one)


MADE_TWICE = [
    Plain,
    lambda: Private(3),
    lambda: Private([torch.ones(2), {"a": None}]),
    lambda: Private(threading.Lock()),
    lambda: Private(np.random.default_rng()),
    lambda: Centred(1.0),
    lambda: OwnCommonMode(1),
    lambda: Slotted(3),
    lambda: {"b": 1, "a": {3, 1, 2}},
    lambda: torch.arange(6).view(2, 3),
    lambda: torch.arange(6).view(3, 2).t().contiguous().t(),
    biotac_sp,
    lambda: times(3),
    lambda: functools.partial(times(2), 5),
    lambda: KNNGraph(k=2),
    lambda: T.Compose([T.Distance(), T.AddSelfLoops()]),
    lambda: TaxelPose(kinematics=HandKinematics.allegro()),
    lambda: iter,
]


@pytest.mark.parametrize("make", MADE_TWICE)
def test_equal_values_are_described_alike(make):
    assert describe(make()) == describe(make())


def test_private_attribute_that_becomes_a_cache_does_not_count():
    one, used = Private(None), Private(None)
    used._k = Slotted(torch.zeros(2))  # neither data nor a transform
    assert describe(used) == describe(one) != describe(Private(2))


def test_use_does_not_change_the_description():
    pose = TaxelPose()
    before = describe(pose)
    pose(Data(joint=torch.zeros(1, 16)))
    assert describe(pose) == before


def test_use_does_not_change_the_description_of_a_fitted_one():
    data = StaticData(x=torch.rand(3, 2, 1))
    score = ZScore().fit(data)
    before = describe(score)
    score(copy.copy(data))
    assert score._kept is not None
    assert describe(score) == before


def test_what_a_copy_leaves_out_does_not_count():
    used = Cached(1)
    used._cache.append(torch.zeros(2))
    assert describe(used) == describe(Cached(1)) != describe(Cached(2))


@pytest.mark.full
def test_description_in_another_run():
    # Hashes of texts, and so the order of sets, differ from run to run.
    code = (
        "from torch_geometric_tactile.data._fingerprint import describe\n"
        "def keep(data):\n"
        "    return data.name in {'cup', 'box', 'can', 'jar'}\n"
        "class Plain:\n"
        "    names = {'a', 'b'}\n"
        "    def __init__(self): self.names = {'cup', 'box', 'can', 'jar'}\n"
        "print(describe([keep, Plain(), lambda data: data.y, object()]))\n"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(found) == 1


def test_object_that_holds_itself():
    loop = Plain()
    loop.me = loop
    assert describe(loop).startswith("tests.data.test_fingerprint.Plain[source ")


def test_long_description_is_hashed():
    text = describe(list(range(1000)))
    assert text.startswith("[0, 1, 2, ")
    assert len(text) < 120
    assert text != describe(list(range(1001)))


def test_constructor_arguments_defaults_and_stars():
    class A:
        def __init__(self, a, *more, b=2, **rest):
            pass

    assert constructor_arguments(A, [1], {}) == {"a": 1, "b": 2}
    assert constructor_arguments(A, [1, 3], {"c": 4}) == {"a": 1, "more": (3,), "b": 2, "c": 4}
    assert constructor_arguments(A, [], {"a": 1, "b": 5}) == {"a": 1, "b": 5}
    assert constructor_arguments(Plain, [1, 2, 3], {}) in ({}, {"args": (1, 2, 3)})


def test_changes_name_old_and_new():
    assert setting_changes({"k": "2"}, {"k": "2"}) == []
    found = setting_changes({"k": "2", "gone": "1"}, {"k": "5", "new": "'a'"})
    assert found == ["k: 2 -> 5", "gone: 1 -> none", "new: none -> 'a'"]
    (long,) = setting_changes({"k": "a" * 100}, {"k": "b"})
    assert long == "k: " + "a" * 57 + "... -> b"


def test_bytecode_of_another_python_is_not_compared():
    text = describe(double)
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    other = text.replace(f"bytecode {version} ", "bytecode 2.7 abc")
    assert other != text
    assert setting_changes({"f": text}, {"f": other}) == []
    assert len(setting_changes({"f": text}, {"f": describe(triple)})) == 1
    assert len(setting_changes({"f": describe(triple)}, {"f": other})) == 1  # another name


def test_state_changes():
    before = ["content=1", "a.h5=3,4", "b=c.h5=1", "gone.h5=1"]
    now = ["content=1", "a.h5=3,5", "b=c.h5=2", "new.h5=1"]
    found = state_changes(before, now)
    assert found == [
        "'a.h5' was changed",
        "'b=c.h5' was changed",
        "'gone.h5' was removed",
        "'new.h5' was added",
    ]


NOTEBOOK = """
import math
GAIN = {gain}
LIMITS = [1, 2]
def helper(x): return {body}
def pre(data): return helper(data)
class Pre:
    limit = {gain}
    def __call__(self, data): return self.scaled(data)
    @staticmethod
    def scaled(data): return helper(data)
"""


@pytest.mark.parametrize("name", ["pre", "Pre"])
def test_code_of_a_notebook_is_followed(name):
    def described(gain=1.0, body="GAIN * x", more=""):
        cells = {"__name__": "__main__"}
        exec(NOTEBOOK.format(gain=gain, body=body) + more, cells)
        value = cells[name]
        return describe(value() if isinstance(value, type) else value)

    assert described() == described() == described(more="unrelated = 1\ndef other(): pass\n")
    assert len({described(), described(gain=2.0), described(body="GAIN + x")}) == 3


def test_function_that_calls_itself_without_source():
    cells = {"__name__": "__main__"}
    exec("def f(n): return f(n - 1) if n else g()\ndef g(): return f(0)\n", cells)
    assert describe(cells["f"]).startswith("__main__.f(bytecode ")


def test_mark_of_own_source_is_left_in_a_long_description():
    text = describe([Plain()] * 40)
    assert re.search(r"\(sha256 [0-9a-f]{16}\)\[source [0-9a-f]{16}\]$", text)
    assert without_code({"a": text})["a"].endswith(")")
