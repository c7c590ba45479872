"""Subnormal numbers counted as zero while cycles run.

Behind a rail a potential falls by any number of decades, and single precision ends at 1e-38.  Down to 1e-45 follow
subnormal numbers, which x86 processors work on many times as slowly: bands of them across a maze tripled the time of
its field.  What lies so far below the largest residual is left to later passes anyway.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

_FLUSH = 1 << 15 | 1 << 6
"""Bits of the control and status register (MXCSR): results are flushed to zero, and operands are taken for zero."""

_BITS = ir.IntType(32)
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


@contextmanager
def subnormals_as_zero() -> Iterator[None]:
    """Let this thread's compiled loops take subnormal numbers for zero; others and what follows are not touched.

    Does nothing on other processors, which work on subnormal numbers at full speed.
    """
    if not _IS_X86:
        yield
        return
    before = _control()
    _set_control(before | _FLUSH)
    try:
        yield
    finally:
        _set_control(before)


def _reading(_typing: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        slot = builder.alloca(_BITS)
        _call(builder, "llvm.x86.sse.stmxcsr", slot)
        return builder.load(slot)

    return types.uint32(), generate


def _writing(_typing: Any, _value: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        slot = builder.alloca(_BITS)
        builder.store(arguments[0], slot)
        _call(builder, "llvm.x86.sse.ldmxcsr", slot)
        return context.get_dummy_value()

    return types.void(types.uint32), generate


def _call(builder: Any, name: str, slot: Any) -> None:
    pointer = ir.IntType(8).as_pointer()
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [pointer]))
    builder.call(function, [builder.bitcast(slot, pointer)])


_read: Any = intrinsic(_reading)
_write: Any = intrinsic(_writing)


@njit(cache=True)
def _control() -> int:
    return int(_read())


@njit(cache=True)
def _set_control(value: int) -> None:
    _write(np.uint32(value))
