"""What compiled loops ask of the processor that numba has no word for.

Arrays that stand at an address: whoever made a table of addresses keeps the arrays.

Jobs that threads share in compiled code: parts are claimed by whoever is free, with atomic operations on an array.

A thread that gets no core claims nothing, and is not waited for; who waits for a part in another's hands gives up its
core to others, again and again, and never sleeps.

Subnormal numbers counted as zero: behind a rail a potential falls by any number of decades, and single precision ends
at 1e-38.  Down to 1e-45 follow subnormal numbers, which x86 processors work on many times as slowly: bands of them
across a maze tripled the time of its field.  What lies so far below the largest residual is left to later passes.
"""

from __future__ import annotations

import platform
import sys
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj
from numpy.typing import NDArray

from resgrid._internal.jit import inner

_numba: Any = cgutils
_arrays: Any = arrayobj

Integers = NDArray[np.int64]

_FLUSHED = np.uint32(0x1F80 | 1 << 15 | 1 << 6)
"""The control and status register (MXCSR) as it begins, but results are flushed to zero, and so are operands."""

_BITS, _ADDRESS = ir.IntType(32), ir.IntType(8).as_pointer()
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


def _generate_view(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """The array at an address, which is the first argument, as its shape is the others."""
    view, (address, *shape) = _arrays.make_array(signature.return_type)(context, builder), arguments
    size = context.get_abi_sizeof(context.get_data_type(signature.return_type.dtype))
    strides = [context.get_constant(types.intp, size)]
    for count in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], count))
    data = builder.inttoptr(address, view.data.type)
    _arrays.populate_array(view, data=data, shape=shape, strides=strides, itemsize=strides[-1], meminfo=None)
    return view._getvalue()


def _view(number: Any) -> Any:
    def viewing(_typing: Any, _address: Any, _count: Any) -> Any:
        return types.Array(number, 1, "C")(types.int64, types.int64), _generate_view

    return intrinsic(viewing)


def _viewing_sides(_typing: Any, _address: Any, _sides: Any, _count: Any) -> Any:
    return types.Array(types.float32, 2, "C")(types.int64, types.int64, types.int64), _generate_view


singles, doubles, indices, integers = (_view(n) for n in (types.float32, types.float64, types.int32, types.int64))
singles_by_side: Any = intrinsic(_viewing_sides)


def _prefetching(_typing: Any, array: Any, _place: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole = _arrays.make_array(array)(context, builder, arguments[0])
        place = _numba.get_item_pointer(context, builder, array, whole, [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [_ADDRESS, _BITS, _BITS, _BITS])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", (_ADDRESS,), kind)
        builder.call(fetch, [builder.bitcast(place, _ADDRESS), *map(_BITS, (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


prefetch: Any = intrinsic(_prefetching)
"""Have an element of an array brought into the cache, for a loop that does not run along it."""


def _controlling(_typing: Any, _value: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        if not _IS_X86:
            return arguments[0]
        before, after = builder.alloca(_BITS), builder.alloca(_BITS)
        builder.store(arguments[0], after)
        for name, slot in (("llvm.x86.sse.stmxcsr", before), ("llvm.x86.sse.ldmxcsr", after)):
            function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [_ADDRESS]))
            builder.call(function, [builder.bitcast(slot, _ADDRESS)])
        return builder.load(before)

    return types.uint32(types.uint32), generate


_control: Any = intrinsic(_controlling)


@inner
def flush_subnormals() -> np.uint32:
    """Let this thread's compiled loops take subnormal numbers for zero; returns what restores them.

    Does nothing on other processors, which work on subnormal numbers at full speed.
    """
    return np.uint32(_control(_FLUSHED))


@inner
def restore_subnormals(before: np.uint32) -> None:
    """Undo `flush_subnormals`."""
    _control(before)


_LEFT, _DONE, KIND, LEVEL, VISIT, _OVER = 0, 8, 16, 17, 18, 24
"""Where in the array stand how many parts of the job are left, and are done, what and where it is to be done, and
whether no other follows."""

PLACES = 32

_SPINS = 32
"""Looks at the array between two offers of the core to others."""

_PATIENCE = 50_000
"""Offers of its core after which a helper that finds nothing to do leaves, for its caller may have been interrupted."""


def _atomic(operation: str) -> Any:
    """What changes a place of an array at once, whoever else does, and returns what stood there."""

    def changing(_typing: Any, array: Any, _place: Any, _value: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            whole = _arrays.make_array(array)(context, builder, arguments[0])
            place = _numba.get_item_pointer(context, builder, array, whole, [arguments[1]])
            return builder.atomic_rmw(operation, place, arguments[2], "seq_cst")

        return types.int64(array, types.intp, types.int64), generate

    return intrinsic(changing)


def _yielding(_typing: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if sys.platform != "win32":
            offer = _numba.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(32), []), "sched_yield")
            builder.call(offer, [])
        return context.get_dummy_value()

    return types.void(), generate


_add, _put = _atomic("add"), _atomic("xchg")
_offer_core: Any = intrinsic(_yielding)


@inner
def announce(state: Integers, kind: int, level: int, visit: int, parts: int) -> None:
    """Begin a job; the one before has been waited for."""
    state[KIND], state[LEVEL], state[VISIT] = kind, level, visit
    _put(state, _DONE, 0)
    _put(state, _LEFT, parts)


@inner
def claim(state: Integers) -> int:
    """A part of the job that nobody has claimed; negative for none."""
    return int(_add(state, _LEFT, -1) - 1) if _add(state, _LEFT, 0) > 0 else -1


@inner
def finish(state: Integers) -> None:
    """Note that a part is done."""
    _add(state, _DONE, 1)


@inner
def wait_for(state: Integers, parts: int) -> None:
    """Wait until so many parts are done."""
    spins = 0
    while _add(state, _DONE, 0) < parts:
        spins += 1
        if spins % _SPINS == 0:
            _offer_core()


@inner
def end_jobs(state: Integers) -> None:
    """Tell the helpers that no other job follows."""
    _put(state, _OVER, 1)


@inner
def await_part(state: Integers) -> int:
    """A part of this job or a later one, as soon as there is one; -1 if no other follows."""
    spins = 0
    while _add(state, _OVER, 0) == 0 and spins < _SPINS * _PATIENCE:
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
