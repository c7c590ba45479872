"""Jobs that threads share in compiled code: parts are claimed by whoever is free, with atomic operations on an array.

A thread that gets no core claims nothing, and is not waited for; who waits for a part in another's hands gives up its
core to others, again and again, and never sleeps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

from resgrid.jit import inner
from resgrid.solvers.multigrid.red_black import Integers

_numba: Any = cgutils
_arrays: Any = arrayobj

_JOB, _DONE, KIND, LEVEL, VISIT, _OVER = 0, 8, 16, 17, 18, 24
"""Where in the array stand the job (its number, parts, and the next part), its parts that are done, what and where it
is to be done, and whether no other follows."""

PLACES = 32

_PARTS, _NUMBER = 16, 32
"""Bits from which on a job tells its parts and its number."""

_ORDER = "seq_cst"
_SPINS = 32
"""Looks at the array between two offers of the core to others."""

_PATIENCE = 50_000
"""Offers of its core after which a helper that finds nothing to do leaves, for its caller may have been interrupted."""


def _on_place(result: Any, array: Any, values: int, operation: Callable[..., Any]) -> Any:
    """How an atomic operation on a place of an array, with so many values, is typed and generated."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, whole = signature.args[0], _arrays.make_array(signature.args[0])(context, builder, arguments[0])
        place = _numba.get_item_pointer(context, builder, kind, whole, [arguments[1]])
        found = operation(builder, place, *arguments[2:])
        return context.get_dummy_value() if result is types.void else found

    return result(array, types.intp, *[types.int64] * values), generate


def _loading(_typing: Any, array: Any, _place: Any) -> Any:
    return _on_place(types.int64, array, 0, lambda builder, place: builder.load_atomic(place, _ORDER, 8))


def _storing(_typing: Any, array: Any, _place: Any, _value: Any) -> Any:
    return _on_place(types.void, array, 1, lambda builder, place, value: builder.store_atomic(value, place, _ORDER, 8))


def _adding(_typing: Any, array: Any, _place: Any, _value: Any) -> Any:
    return _on_place(
        types.int64, array, 1, lambda builder, place, value: builder.atomic_rmw("add", place, value, _ORDER)
    )


def _swapping(_typing: Any, array: Any, _place: Any, _old: Any, _new: Any) -> Any:
    def swap(builder: Any, place: Any, old: Any, new: Any) -> Any:
        return builder.extract_value(builder.cmpxchg(place, old, new, _ORDER, _ORDER), 1)

    return _on_place(types.boolean, array, 2, swap)


def _yielding(_typing: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if sys.platform != "win32":
            offer = _numba.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(32), []), "sched_yield")
            builder.call(offer, [])
        return context.get_dummy_value()

    return types.void(), generate


_load: Any = intrinsic(_loading)
_store: Any = intrinsic(_storing)
_add: Any = intrinsic(_adding)
_swap: Any = intrinsic(_swapping)
_offer_core: Any = intrinsic(_yielding)


@inner
def announce(state: Integers, kind: int, level: int, visit: int, parts: int) -> None:
    """Begin a job; the one before has been waited for."""
    state[KIND], state[LEVEL], state[VISIT] = kind, level, visit
    _store(state, _DONE, 0)
    _store(state, _JOB, ((_load(state, _JOB) >> _NUMBER) + 1 << _NUMBER) | parts << _PARTS)


@inner
def claim(state: Integers) -> int:
    """A part of the job that nobody has claimed; -1 for none."""
    while True:
        job = _load(state, _JOB)
        part = job & 0xFFFF
        if part >= (job >> _PARTS) & 0xFFFF:
            return -1
        if _swap(state, _JOB, job, job + 1):
            return int(part)


@inner
def finish(state: Integers) -> None:
    """Note that a part is done."""
    _add(state, _DONE, 1)


@inner
def wait_for(state: Integers, parts: int) -> None:
    """Wait until so many parts are done."""
    spins = 0
    while _load(state, _DONE) < parts:
        spins += 1
        if spins % _SPINS == 0:
            _offer_core()


@inner
def end_jobs(state: Integers) -> None:
    """Tell the helpers that no other job follows."""
    _store(state, _OVER, 1)


@inner
def await_part(state: Integers) -> int:
    """A part of this job or a later one, as soon as there is one; -1 if no other follows."""
    spins = 0
    while _load(state, _OVER) == 0 and spins < _SPINS * _PATIENCE:
        part = claim(state)
        if part >= 0:
            return part
        spins += 1
        if spins % _SPINS == 0:
            _offer_core()
    return -1


def begin_jobs(state: Integers) -> None:
    """Tell that jobs follow."""
    state[_OVER] = 0
