import builtins
import os
import pickle
import tracemalloc
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
from hostile_pickle import Touch
from published_files import pickled

from torch_geometric_tactile.io import _numpy_pickle
from torch_geometric_tactile.io._numpy_pickle import read_numpy_pickle

P = pickle
NUMPY = "numpy._core" if np.lib.NumpyVersion(np.__version__) >= "2.0.0" else "numpy.core"
HUGE = 2**40


class Calls:
    """Calls a function when it is unpickled, and then sets a state."""

    def __init__(self, function, *arguments, state=None):
        self.parts = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self):
        return self.parts


def read(folder, content):
    path = folder / "data.pkl"
    path.write_bytes(content if isinstance(content, bytes) else pickle.dumps(content, 4))
    return read_numpy_pickle(path)


def refused(folder, content, match):
    with pytest.raises(ValueError, match=rf"data.pkl' cannot be read as a pickle.*{match}"):
        read(folder, content)


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "i1", ">u2", "<u8", "?", "f2"])
def test_arrays_are_those_of_the_unpickler(tmp_path, protocol, dtype):
    numbers = np.arange(24).reshape(2, 3, 4).astype(dtype)
    content = {"a": [numbers, numbers.T, numbers[0, 0, 1], (numbers, 1, 2.5, None, "é", b"b")]}
    content["b"] = [
        content["a"][0],
        [],
        {},
        (),
        (True, False, -5, 2**70),
        np.asfortranarray(numbers),
    ]
    found = read_numpy_pickle(pickled(tmp_path / "a.pkl", content, protocol))
    known = pickle.loads((tmp_path / "a.pkl").read_bytes())
    np.testing.assert_equal(found, known)
    for one, other in zip(found["a"][:3], known["a"], strict=False):
        assert type(one) is type(other)
        assert one.dtype.newbyteorder("=") == other.dtype.newbyteorder("=")
    assert found["b"][0] is found["a"][0]  # what a file has once is there once


def test_names_of_both_numpys(tmp_path):
    data = pickle.dumps([np.arange(3.0)], 4)
    for name in (b"\x8c\x16numpy._core.multiarray", b"\x8c\x15numpy.core.multiarray"):
        old = b"\x8c" + bytes([len(f"{NUMPY}.multiarray")]) + f"{NUMPY}.multiarray".encode()
        assert old in data
        assert read(tmp_path, data.replace(old, name))[0].tolist() == [0, 1, 2]


@pytest.mark.parametrize("protocol", [0, 2, 3, 4, 5])
@pytest.mark.parametrize(
    ("function", "name"),
    [(os.system, "(posix|nt)[. ]system"), (eval, "(__builtin__|builtins)[. ]eval")],
)
def test_payloads_name_what_they_would_call(tmp_path, monkeypatch, protocol, function, name):
    called = []
    payload = pickle.dumps([Calls(function, "boom")], protocol)
    monkeypatch.setattr(os, "system", called.append)
    monkeypatch.setattr(builtins, "eval", called.append)
    said = rf"got '{name}'" if protocol > 0 else "got"
    refused(tmp_path, payload, said)
    assert not called


def test_nothing_of_a_payload_runs(tmp_path):
    mark = tmp_path / "mark"
    refused(tmp_path, [np.zeros(3), {"a": Touch(mark)}], "not name classes or functions")
    assert not mark.exists()
    pickle.loads(pickle.dumps(Touch(mark)))  # it would have
    assert mark.exists()


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (np.array([1, "a"], dtype=object), r"not objects \(got 'O8'\)"),
        ([np.array(["a"])], r"not objects \(got 'U1'\)"),
        ([np.zeros(2, "f4,f4")], r"not objects \(got 'V8'\)"),
        ([np.zeros(2, complex)], r"not objects \(got 'c16'\)"),
        (OrderedDict(a=1), "got 'collections.OrderedDict'"),
        ([Path("a")], "got 'pathlib"),
        ({1, 2}, "got the step EMPTY_SET"),
        ({1: 2}, r"must find a str \(got int\)"),
        ([np.memmap], "got 'numpy.*memmap'"),
    ],
)
def test_other_content_is_refused(tmp_path, content, match):
    refused(tmp_path, content, match)


def steps(*parts):
    return P.PROTO + b"\x04" + b"".join(parts) + P.STOP


def text(value):
    return P.SHORT_BINUNICODE + bytes([len(value)]) + value.encode()


def named(module, name):
    return text(module) + text(name) + P.STACK_GLOBAL


def number(value):
    content = value.to_bytes(8, "little", signed=True)
    return P.LONG1 + b"\x08" + content


FORM = named("numpy", "dtype") + text("f8") + P.NEWFALSE + P.NEWTRUE + P.TUPLE3 + P.REDUCE
STATE = b"".join([P.MARK, number(3), text("<"), 3 * P.NONE, 2 * number(-1), number(0), P.TUPLE])
FORM += STATE + P.BUILD
BLANK = named(f"{NUMPY}.multiarray", "_reconstruct") + named("numpy", "ndarray")
BLANK += number(0) + P.TUPLE1 + P.SHORT_BINBYTES + b"\x01b" + P.TUPLE3 + P.REDUCE
RECONSTRUCT = named(f"{NUMPY}.multiarray", "_reconstruct")
BUFFER = named(f"{NUMPY}.numeric", "_frombuffer")
EIGHT = P.SHORT_BINBYTES + b"\x08" + bytes(8)


def array_of(shape, content=EIGHT):
    return BLANK + P.MARK + number(1) + shape + FORM + P.NEWFALSE + content + P.TUPLE + P.BUILD


def test_steps_by_hand_are_an_array(tmp_path):
    assert read(tmp_path, steps(array_of(number(1) + P.TUPLE1))).tolist() == [0]


CALL = number(HUGE) + P.TUPLE1


@pytest.mark.parametrize(
    ("parts", "match"),
    [
        (
            [named("numpy", "ndarray"), CALL, P.TUPLE1, P.REDUCE],
            "must call a constructor of arrays",
        ),
        ([named("numpy", "ndarray"), CALL, P.NEWOBJ], "got the step NEWOBJ"),
        ([RECONSTRUCT, named("numpy", "ndarray"), CALL, EIGHT, P.TUPLE3, P.REDUCE], "reconstruct"),
        ([RECONSTRUCT, RECONSTRUCT, CALL, EIGHT, P.TUPLE3, P.REDUCE], "must reconstruct arrays"),
        ([array_of(number(HUGE) + P.TUPLE1)], rf"{8 * HUGE} bytes of their shape \(got 8\)"),
        ([array_of(number(2**32) + number(2**32) + P.TUPLE2)], r"bytes of their shape \(got 8\)"),
        ([array_of(number(-1) + P.TUPLE1)], "a type and a shape"),
        ([array_of(P.NEWTRUE + P.TUPLE1)], "a type and a shape"),
        ([array_of(number(1) + P.TUPLE1, P.EMPTY_LIST)], r"8 bytes of their shape \(got list\)"),
        ([array_of(number(1) + P.TUPLE1, text("12345678"))], r"8 bytes of their shape \(got str\)"),
        ([BUFFER, EIGHT, FORM, CALL, text("C"), P.MARK, P.TUPLE, P.REDUCE], r"Name \(got str\)"),
        (
            [BUFFER, P.MARK, EIGHT, FORM, CALL, text("C"), P.TUPLE, P.REDUCE],
            r"bytes of their shape \(got 8\)",
        ),
        ([FORM, STATE, P.BUILD], r"must find a PendingObject \(got Float64DType\)"),
        ([BUFFER, P.EMPTY_DICT, P.BUILD], r"must find a PendingObject \(got _GlobalName\)"),
        ([P.EMPTY_DICT, P.EMPTY_DICT, P.BUILD], r"must find a PendingObject \(got dict\)"),
        ([text("numpy.dtype"), P.EMPTY_TUPLE, P.REDUCE], r"must find a GlobalName \(got str\)"),
        ([P.NONE, P.LONG_BINPUT, b"\xff\xff\xff\xff", P.POP], "got the step POP"),
        ([P.BINBYTES8, (2**40).to_bytes(8, "little"), b"a"], "expected 1099511627776 bytes"),
        ([P.PERSID, b"a\n"], "got the step PERSID"),
        ([P.GLOBAL, b"os\nsystem\n"], "got 'os.system'"),
        ([P.TUPLE2], "must find their operands"),
        ([P.TUPLE], "pop from empty list"),
        ([P.BINGET, b"\x07"], "7"),
        ([P.NONE, P.NONE], "too many values"),
        ([P.EMPTY_LIST, P.APPEND], "index out of range"),
    ],
)
def test_hostile_steps_take_no_memory(tmp_path, parts, match):
    tracemalloc.start()
    try:
        refused(tmp_path, steps(*parts), match)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_nested_calls_are_refused(tmp_path):
    inner = Calls(Path.touch, Path(tmp_path / "mark"))
    refused(tmp_path, Calls(np.dtype, "f8", state=(3, "<", inner)), "got 'pathlib")
    nested = Calls(Calls, Calls, Calls(np.frombuffer, b"12345678", "f8"))
    refused(tmp_path, nested, "not name classes or functions")
    assert not (tmp_path / "mark").exists()


def test_deep_nesting_is_no_crash(tmp_path):
    deep = steps(20_000 * P.EMPTY_LIST, 19_999 * P.APPEND)
    assert isinstance(read(tmp_path, deep), list)
    refused(
        tmp_path, steps(P.EMPTY_DICT, P.EMPTY_TUPLE, 10**4 * P.TUPLE1, P.NONE, P.SETITEM), "str"
    )
    refused(
        tmp_path, steps(BUFFER, P.EMPTY_TUPLE, 10**4 * P.TUPLE1, P.REDUCE), "missing|positional"
    )


def test_a_cut_file_and_one_with_more_are_refused(tmp_path):
    data = pickle.dumps([np.arange(4.0), np.arange(3.0)], 4)
    refused(tmp_path, data[:-9], "copy or write it again")
    refused(tmp_path, data + b"N.", "must hold one pickle")


def test_too_many_steps_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(_numpy_pickle, "PICKLE_STEPS", 100)
    assert len(read(tmp_path, list(range(90)))) == 90
    refused(tmp_path, list(range(100)), "must take at most 100 steps")
