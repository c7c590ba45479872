"""Subnormal numbers counted as zero while a cycle runs.

Behind a rail a potential falls by any number of decades, and single precision ends at 1e-38.  Down to 1e-45 follow
subnormal numbers, which x86 processors work on many times as slowly: bands of them across a maze tripled the time of
its field.  What lies so far below the largest residual is left to later passes anyway.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from resgrid.jit import inner

_FLUSH = np.uint32(1 << 15 | 1 << 6)
"""Bits of the control and status register (MXCSR): results are flushed to zero, and operands are taken for zero."""

_BITS = ir.IntType(32)
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


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
    pointer = ir.IntType(8).as_pointer()
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [pointer]))
    builder.call(function, [builder.bitcast(slot, pointer)])


_read: Any = intrinsic(_reading)
_write: Any = intrinsic(_writing)


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
