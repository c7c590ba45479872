"""LLVM instructions that numba lacks, for kernels: arrays by address, prefetch, subnormal numbers, work sharing.

Array views of memory addresses: the owner of a table of addresses must keep the arrays alive.

Work sharing between threads in compiled code. A job is one sweep over an array, divided into numbered parts. Free
threads claim parts by atomic operations on an integer array, the shared state. A thread without a processor core claims
no part and is not waited for. A thread that waits for a part of another thread yields its core repeatedly and never
sleeps.

Flush of subnormal numbers to zero: behind a rail a potential falls by any number of orders of magnitude, and the normal
numbers of single precision end at 1e-38. Below, down to 1e-45, numbers are subnormal, and x86 processors are many times
slower with them: bands of subnormal numbers across a maze tripled the time of its field. Values so far below the
largest residual are computed by later refinement steps.
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
"""Value of the x86 control and status register (MXCSR) that flushes subnormal results and operands to zero."""

_BITS, _ADDRESS = ir.IntType(32), ir.IntType(8).as_pointer()
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


def _generate_view(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Generate LLVM code that views memory at an address as an array; return the LLVM value of the array.

    `arguments`: LLVM values of the address and of the array's shape; `context, builder, signature`: numba's target
    context, LLVM instruction builder, and types of the intrinsic.
    """
    view, (address, *shape) = _arrays.make_array(signature.return_type)(context, builder), arguments
    size = context.get_abi_sizeof(context.get_data_type(signature.return_type.dtype))
    strides = [context.get_constant(types.intp, size)]
    for count in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], count))
    data = builder.inttoptr(address, view.data.type)
    _arrays.populate_array(view, data=data, shape=shape, strides=strides, itemsize=strides[-1], meminfo=None)
    return view._getvalue()


def _view(number: Any) -> Any:
    """Return an intrinsic of an address and a count that views the memory as a one-dimensional array.

    The array has the shape (count,). `number`: numba's type of an entry.
    """

    def viewing(_typing: Any, _address: Any, _count: Any) -> Any:
        return types.Array(number, 1, "C")(types.int64, types.int64), _generate_view

    return intrinsic(viewing)


def _viewing_sides(_typing: Any, _address: Any, _sides: Any, _count: Any) -> Any:
    """Declare an intrinsic that views memory as a float32 matrix; return numba's signature and the code generator.

    The parameters stand for numba's types of the address, of the number of rows and of the number of columns.
    """
    return types.Array(types.float32, 2, "C")(types.int64, types.int64, types.int64), _generate_view


singles, doubles, indices, integers = (_view(n) for n in (types.float32, types.float64, types.int32, types.int64))
singles_by_side: Any = intrinsic(_viewing_sides)


def _prefetching(_typing: Any, array: Any, _place: Any) -> Any:
    """Declare an intrinsic that prefetches an array element; return numba's signature and the code generator.

    `array`: numba's type of the array; `_place`: numba's type of the index.
    """

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole = _arrays.make_array(array)(context, builder, arguments[0])
        place = _numba.get_item_pointer(context, builder, array, whole, [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [_ADDRESS, _BITS, _BITS, _BITS])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", (_ADDRESS,), kind)
        builder.call(fetch, [builder.bitcast(place, _ADDRESS), *map(_BITS, (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


prefetch: Any = intrinsic(_prefetching)
"""Function of an array and an index that loads the array's element into the cache, for irregular access."""


def _controlling(_typing: Any, _value: Any) -> Any:
    """Declare an intrinsic that exchanges the x86 control register; return numba's signature and the code generator.

    The intrinsic takes the new value and returns the old one; on other processors it only returns its argument.
    """

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
    """Flush subnormal numbers to zero in kernels of this thread; return the previous value of the x86 control register.

    On other processors, which handle subnormal numbers at full speed, nothing changes.
    """
    return np.uint32(_control(_FLUSHED))


@inner
def restore_subnormals(before: np.uint32) -> None:
    """Restore the treatment of subnormal numbers; `before`: the register value that `flush_subnormals` returned."""
    _control(before)


_LEFT, _DONE, KIND, LEVEL, VISIT, _OVER = 0, 8, 16, 17, 18, 24
"""Indices into the int64 array that threads share: unclaimed slabs, finished slabs, kind, level and visit, end flag.

A slab is a part of a grid that one thread sweeps over. A job is one sweep over a multigrid level: `KIND` of the sweep
(a constant of `multigrid.sweeps`), index of the `LEVEL`, and `VISIT`, the number of times that the cycle has returned
to this level from the next one.
"""

PLACES = 32
"""Number of entries of the int64 array that threads share; its atomic counters lie in separate cache lines."""

_SPINS = 32
"""Number of reads of the shared array after which a waiting thread yields its core."""

_PATIENCE = 50_000
"""Number of yields after which a helper thread without work ends; the thread that assigns work may have been
interrupted.
"""


def _atomic(operation: str) -> Any:
    """Return an intrinsic of array, index and value that changes the element atomically and returns its old value.

    `operation`: LLVM's name of the change, "add" (add the value) or "xchg" (replace the element by the value).
    """

    def changing(_typing: Any, array: Any, _place: Any, _value: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            whole = _arrays.make_array(array)(context, builder, arguments[0])
            place = _numba.get_item_pointer(context, builder, array, whole, [arguments[1]])
            return builder.atomic_rmw(operation, place, arguments[2], "seq_cst")

        return types.int64(array, types.intp, types.int64), generate

    return intrinsic(changing)


def _yielding(_typing: Any) -> Any:
    """Declare an intrinsic that yields the core to other threads; return numba's signature and the code generator."""

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
    """Publish a job to the helper threads: a sweep over a multigrid level in ``parts`` slabs, claimed one at a time.

    The previous job must be finished.  `state` (PLACES,): array that the threads share; `kind, level, visit`: kind of
    the sweep, index of its level, and number of times that the cycle has returned to this level from the next one.
    """
    state[KIND], state[LEVEL], state[VISIT] = kind, level, visit
    _put(state, _DONE, 0)
    _put(state, _LEFT, parts)


@inner
def claim(state: Integers) -> int:
    """Claim a slab of the present sweep.

    A slab is a part of a grid. Return the number of the slab; numbers are claimed downwards to 0. The result is
    negative if no slab is left.

    `state` (PLACES,): array that the threads share.
    """
    return int(_add(state, _LEFT, -1) - 1) if _add(state, _LEFT, 0) > 0 else -1


@inner
def finish(state: Integers) -> None:
    """Atomically increment the number of finished slabs of the present sweep in ``state``, the shared array."""
    _add(state, _DONE, 1)


@inner
def wait_for(state: Integers, parts: int) -> None:
    """Wait until ``parts`` slabs of the present sweep are finished; `state` (PLACES,): array that the threads share."""
    spins = 0
    while _add(state, _DONE, 0) < parts:
        spins += 1
        if spins % _SPINS == 0:
            _offer_core()


@inner
def end_jobs(state: Integers) -> None:
    """Signal to the helper threads, through the shared array ``state``, that no further sweep follows."""
    _put(state, _OVER, 1)


@inner
def await_part(state: Integers) -> int:
    """Wait for a slab of the present or a later sweep, claim it, and return its number; -1 if no further sweep follows.

    `state` (PLACES,): array that the threads share. After `_PATIENCE` yields without work the result is also -1.
    """
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
    """Clear the end flag in ``state``, the array that threads share, before the first sweep."""
    state[_OVER] = 0
