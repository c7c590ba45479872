"""Every exception of resgrid is also the built-in exception that users catch.

Tests internals: `resgrid.errors`.
"""

from __future__ import annotations

import copy
import io
import pickle

import pytest

import resgrid as rg
from resgrid import errors

BUILTINS = {
    rg.InputError: ValueError,
    rg.CertificateError: ValueError,
    rg.CircuitError: ArithmeticError,
    rg.AccuracyError: ArithmeticError,
    rg.BudgetError: MemoryError,
    rg.ToolMissingError: OSError,
    rg.WorkerError: RuntimeError,
}


def test_every_exception_has_a_built_in_base() -> None:
    classes = {value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, Exception)}
    assert classes == {*BUILTINS, rg.ResgridError}


@pytest.mark.parametrize("kind", BUILTINS, ids=lambda kind: kind.__name__)
def test_the_built_in_class_catches_the_exception_and_keeps_its_message(kind: type[Exception]) -> None:
    message = "map.yaml: line 3: resolution = -1 must be above 0"
    for caught in (BUILTINS[kind], rg.ResgridError, kind):
        with pytest.raises(caught) as error:
            raise kind(message)
        assert str(error.value) == message
        assert error.value.args == (message,)


@pytest.mark.parametrize("kind", BUILTINS, ids=lambda kind: kind.__name__)
def test_copies_and_pickles_keep_class_message_and_attributes(kind: type[Exception]) -> None:
    error = kind("the message", 3.0) if kind is rg.AccuracyError else kind("the message")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(again) is kind
        assert str(again) == "the message"
        assert vars(again) == vars(error)
    assert getattr(error, "best", 3.0) == 3.0


@pytest.mark.parametrize("kind", BUILTINS, ids=lambda kind: kind.__name__)
def test_exceptions_can_be_created_by_new_as_dask_does(kind: type[Exception]) -> None:
    assert kind.__new__(kind, "the message").args == ("the message",)


def test_public_functions_raise_the_built_in_exceptions() -> None:
    with pytest.raises(ValueError, match="must lie below"):
        rg.Axis("x", 1.0, 0.0, 4)
    with pytest.raises(ArithmeticError, match="contradicts"):
        rg.solve(rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]))
    axes = tuple(rg.Axis(name, 0.0, 1.0, 100_000) for name in "xyz")
    with pytest.raises(MemoryError, match="needs about"):
        rg.build_space(rg.Scene(axes, goals=(rg.GoalCell((0, 0, 0)),)))


def test_tool_missing_error_has_no_errno_and_filename() -> None:
    error = rg.ToolMissingError("ngspice is missing")
    assert (error.errno, error.strerror, error.filename) == (None, None, None)


def test_an_error_of_one_card_can_be_sent_to_another_process() -> None:
    deck = "title\nsimulator lang=spectre\nsimulator lang=spect\n"
    with pytest.raises(rg.InputError, match=r"<text>:3:1: the language 'spect'") as raised:
        rg.read_spice(io.StringIO(deck), dialect="spectre")
    again = pickle.loads(pickle.dumps(raised.value))
    assert (type(again), str(again)) == (type(raised.value), str(raised.value))
