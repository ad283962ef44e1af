"""Errors that know which words of their text are names of arguments."""

import pickle
from argparse import Namespace

import pytest

from torch_geometric_tactile._checks import (
    Argument,
    ArgumentError,
    need_argument,
    with_context,
)
from torch_geometric_tactile.commands._runs import option_names_in_errors


def fail(error, **more):
    with (
        pytest.raises(ValueError, match=r".") as caught,
        option_names_in_errors(Namespace(model=1, time_axis=2), **more),
    ):
        raise error
    return str(caught.value)


def test_only_the_argument_is_renamed():
    error = ArgumentError(Argument("model"), " must be a column (got the column 'model')")
    assert error.argument == "model"
    assert str(error) == "'model' must be a column (got the column 'model')"
    assert fail(error) == "'--model' must be a column (got the column 'model')"
    assert fail(error, model="NAME") == "'NAME' must be a column (got the column 'model')"
    assert fail(ValueError("the column 'model' is empty")) == "the column 'model' is empty"


def test_several_arguments_are_renamed():
    parts = ("only one of ", Argument("model"), " and ", Argument("time_axis"), " may be given")
    renamed = "only one of '--model' and '--time-axis' may be given"
    assert fail(ArgumentError(*parts)) == renamed
    assert fail(with_context("'a.npz': ", ArgumentError(*parts))) == f"'a.npz': {renamed}"
    assert fail(ArgumentError(Argument("other"), " is wrong")) == "'other' is wrong"
    assert ArgumentError("no argument").argument is None


def test_errors_of_arguments_come_out_of_processes_whole():
    with pytest.raises(ValueError, match=r"^'k' must be positive \(got 0\)$") as caught:
        need_argument(False, "k", "must be positive", 0)
    error = pickle.loads(pickle.dumps(caught.value))
    assert (str(error), error.argument) == (str(caught.value), "k")
    assert fail(error, k="-k") == "'-k' must be positive (got 0)"
