"""What compiled loops ask of the processor that numba has no word for.

Arrays that stand at an address: whoever made a table of addresses keeps the arrays.

Elements that are asked for ahead of their turn.

Subnormal numbers counted as zero: behind a rail a potential falls by any number of decades, and single precision ends
at 1e-38.  Down to 1e-45 follow subnormal numbers, which x86 processors work on many times as slowly: bands of them
across a maze tripled the time of its field.  What lies so far below the largest residual is left to later passes.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np import arrayobj

from resgrid.jit import inlined, inner

_arrays: Any = arrayobj

_FLUSH = np.uint32(1 << 15 | 1 << 6)
"""Bits of the control and status register (MXCSR): results are flushed to zero, and operands are taken for zero."""

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


def _prefetching(_typing: Any, _address: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        of = ir.FunctionType(ir.VoidType(), [_ADDRESS, _BITS, _BITS, _BITS])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", (_ADDRESS,), of)
        builder.call(fetch, [builder.inttoptr(arguments[0], _ADDRESS), _BITS(0), _BITS(3), _BITS(1)])
        return context.get_dummy_value()

    return types.void(types.int64), generate


def _reading(_typing: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if not _IS_X86:
            return ir.Constant(_BITS, 0)
        slot = builder.alloca(_BITS)
        _call(builder, "llvm.x86.sse.stmxcsr", slot)
        return builder.load(slot)

    return types.uint32(), generate


def _writing(_typing: Any, _value: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        if _IS_X86:
            slot = builder.alloca(_BITS)
            builder.store(arguments[0], slot)
            _call(builder, "llvm.x86.sse.ldmxcsr", slot)
        return context.get_dummy_value()

    return types.void(types.uint32), generate


def _call(builder: Any, name: str, slot: Any) -> None:
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [_ADDRESS]))
    builder.call(function, [builder.bitcast(slot, _ADDRESS)])


_prefetch: Any = intrinsic(_prefetching)
_read: Any = intrinsic(_reading)
_write: Any = intrinsic(_writing)


@inlined
def prefetch(array: Any, place: int) -> None:
    """Have an element and those beside it brought into the cache, for a loop that does not run along the array."""
    _prefetch(array.ctypes.data + place * array.itemsize)


@inner
def flush_subnormals() -> np.uint32:
    """Let this thread's compiled loops take subnormal numbers for zero; returns what restores them.

    Does nothing on other processors, which work on subnormal numbers at full speed.
    """
    before = _read()
    _write(before | _FLUSH)
    return np.uint32(before)


@inner
def restore_subnormals(before: np.uint32) -> None:
    """Undo `flush_subnormals`."""
    _write(before)
