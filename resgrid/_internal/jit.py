"""How loops are compiled: those that Python calls, and those that only they call."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

import numba
import numpy as np
from numba import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Liberties with the order of sums, so that they fill the vector registers; infinities and NaN keep their meaning."""

ZERO = cast(int, np.int64(0))
"""A number that is no literal, for which functions would be compiled once more."""

_njit: Any = njit
_Loop = TypeVar("_Loop", bound=Callable[..., Any])


_KNOWN = (0, 68)
"""The numba whose insides `_compilers` knows; any other compiles in its slower, ordinary way."""


def _compilers() -> tuple[type[Any], type[Any]]:
    """Compilers of kernels, and of loops that are optimized and translated as parts of their callers alone.

    Numba looks for what a call means by the flags of the caller too, and hashes and compares some twenty of them for
    every candidate: here all callers have the same.
    """
    from numba._dynfunc import make_function
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
    from numba.core.compiler_machinery import register_pass
    from numba.core.targetconfig import ConfigStack
    from numba.core.typed_passes import NativeLowering, NopythonTypeInference

    class Common(Flags):
        """The flags of all callers, one object."""

        __hash__ = object.__hash__

        def __eq__(self, other: object) -> bool:
            return self is other

    counting, common = (cast(Any, Common()) for _ in range(2))
    counting.nrt, common.nrt = True, False

    @register_pass(mutates_CFG=True, analysis_only=False)
    class Inference(NopythonTypeInference):
        _name = "nopython_type_inference_by_common_flags"

        def run_pass(self, state: Any) -> bool:
            with ConfigStack().enter(counting if state.flags.nrt else common):
                return bool(super().run_pass(state))

    class Part(JITCodeLibrary):
        """Code that is not optimized and translated once more by itself."""

        def _optimize_final_module(self) -> None:
            """Left to the callers."""

        def _finalize_final_module(self) -> None:
            """Ready to be linked, not to be run."""
            self._finalize_dynamic_globals()
            self._finalized = True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class PartLowering(NativeLowering):
        _name = "part_lowering"

        def run_pass(self, state: Any) -> bool:
            """Lower to a `Part`; what stands for it among numba's functions has no address, for nothing calls it."""
            state.library = Part(state.targetctx.codegen(), state.func_id.func_qualname)
            state.flags.no_compile = True
            super().run_pass(state)
            of = state.cr.fndesc
            name = make_function(of.lookup_module(), of.qualname, "", 0, state.cr.env, (state.library,))
            state.targetctx.insert_user_function(name, of, [state.library])
            state.cr = state.cr._replace(cfunc=name)
            return True

    class KernelCompiler(CompilerBase):
        instead: ClassVar[dict[type, type]] = {NopythonTypeInference: Inference}

        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [(self.instead.get(one, one), why) for one, why in passes.passes]
            passes.finalize()
            return [passes]

        def compile_extra(self, function: Any) -> Any:
            """As ever, but what is made meanwhile is no garbage, and is not looked through for some."""
            if not gc.isenabled():
                return super().compile_extra(function)
            gc.disable()
            try:
                return super().compile_extra(function)
            finally:
                gc.enable()

    class PartCompiler(KernelCompiler):
        instead: ClassVar[dict[type, type]] = {NopythonTypeInference: Inference, NativeLowering: PartLowering}

    return KernelCompiler, PartCompiler


_KERNEL: dict[str, Any] = {"cache": True, "nogil": True, "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
if numba.version_info.short == _KNOWN:
    _KERNEL["pipeline_class"], _INNER["pipeline_class"] = _compilers()


def makes_arrays(function: _Loop) -> _Loop:
    """Let a loop make arrays, or return some: what others are given outlives them, and its references are not counted.

    Counting them is a fifth of all that is compiled, and takes as long as short loops.
    """
    function._makes_arrays = True  # type: ignore[attr-defined]
    return function


def _compiled(function: _Loop, options: dict[str, Any]) -> _Loop:
    return cast(_Loop, _njit(**options, _nrt=hasattr(function, "_makes_arrays"))(function))


@cache
def _stamp() -> tuple[float, int]:
    """When the loops of any file were last changed, and how long these files are."""
    here = Path(__file__).parents[1]
    files = [*here.rglob("*kernels.py"), *(here / "solvers").rglob("*.py"), Path(__file__)]
    found = [file.stat() for file in files]
    return max((of.st_mtime for of in found), default=0.0), sum(of.st_size for of in found)


def _kept(function: _Loop, options: dict[str, Any]) -> _Loop:
    """Compile a loop that is kept on disk until those it calls change, too: numba looks at its own file alone."""
    loop = _compiled(function, options)
    kept = getattr(getattr(loop, "_cache", None), "_cache_file", None)
    if kept is not None:
        kept._version = (kept._version, _stamp())  # which is read before names of classes, some of which may be gone
    return loop


def kernel(function: _Loop) -> _Loop:
    """Compile a loop, or an inner one once more, that Python calls, and keep it on disk; other threads may run.

    It returns no named tuple: where a signal comes while numba makes one, Python dies.
    """
    return _kept(getattr(function, "py_func", function), _KERNEL)


def interruptible(loop: _Loop) -> _Loop:
    """A loop, for Python alone, of tuples with arrays: an interrupt while numba makes them is no `SystemError`."""

    @wraps(loop)
    def called(*given: Any) -> Any:
        try:
            return loop(*given)
        except SystemError as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, KeyboardInterrupt):  # one for every array that is made
                cause = cause.__cause__ or cause.__context__
            raise cause or error from None

    return cast(_Loop, called)


def kernel_fast(function: _Loop) -> _Loop:
    """The same for one whose sums may be taken in any order."""
    return _kept(function, _KERNEL | {"fastmath": FAST})


def inner(function: _Loop) -> _Loop:
    """Compile a loop that only compiled ones call: sooner, for it has no way in from Python and no code of its own."""
    return _compiled(function, _INNER)


def inlined(function: _Loop) -> _Loop:
    """The same for one that takes hardly longer than its call: it becomes part of its callers."""
    return _compiled(function, _INNER | {"forceinline": True})


def inner_fast(function: _Loop) -> _Loop:
    """The same for one whose sums may be taken in any order."""
    return _compiled(function, _INNER | {"fastmath": FAST})
