"""Compilation settings of the numba kernels, and the check that drops cached kernels whose sources have changed.

A kernel is a compiled function that Python calls; its machine code is cached on disk.  A device function is called
from kernels only.  This module uses only public names of numba.
"""

from __future__ import annotations

import contextlib
import hashlib
import warnings
from collections.abc import Callable
from functools import cache, wraps
from inspect import unwrap
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Permitted floating-point optimizations, as names of LLVM flags: sums may be reordered and vectorized.

Infinities and NaN are preserved.
"""

ZERO = cast(int, np.int64(0))
"""Zero of type int64, for kernels; numba would compile a function again for a literal argument 0."""

_STAMP = "resgrid-kernels.sha256"
"""Name of the file next to cached kernels that holds the hash of the sources from which they were compiled."""

_njit: Any = njit
_COMMON: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_KERNEL: dict[str, Any] = {**_COMMON, "cache": True, "nogil": True}
_DEVICE: dict[str, Any] = {**_COMMON, "no_cpython_wrapper": True}
"""Options of `numba.njit`: `_KERNEL` for kernels (called from Python), `_DEVICE` for device functions.

Device functions are called from compiled code only. The options omit the entry point for C and, in device functions,
that for Python. Compilation of these unused entry points takes an eighth of the time until the first solution.
Division by zero gives inf or NaN, as in numpy. A division that can raise an exception keeps numba from removing counts
of references to arrays: with such divisions, the tracing of streamlines takes a third longer.
"""

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function) -> _Function:
    """Return `function` compiled for calls from Python, cached on disk; the kernel releases the GIL while it runs.

    A device function is accepted, too, and is compiled again as a kernel.  A kernel must not return a named tuple:
    Python crashes if a signal arrives while numba creates the named tuple.
    """
    return _cached(function)


def kernel_fast(function: _Function) -> _Function:
    """Return `function` compiled as a `kernel` in which the compiler may reorder sums."""
    return _cached(function, fastmath=FAST)


def inner(function: _Function) -> _Function:
    """Return a compiled device function, which only compiled code can call; the calling kernels cache its code."""
    return cast(_Function, _njit(**_DEVICE)(function))


def inner_fast(function: _Function) -> _Function:
    """Return a compiled device function (for calls from compiled code only) in which the compiler may reorder sums."""
    return cast(_Function, _njit(**_DEVICE, fastmath=FAST)(function))


def inlined(function: _Function) -> _Function:
    """Return a compiled device function that is always inlined into the functions that call it, for short functions."""
    return cast(_Function, _njit(**_DEVICE, forceinline=True)(function))


def interruptible(function: _Function) -> _Function:
    """Return a wrapper of the kernel `function`, in which Ctrl-C raises KeyboardInterrupt.

    The wrapper is for kernels that take or return tuples of arrays.  If a signal arrives while numba creates the
    arrays, the kernel raises SystemError, and the wrapper raises KeyboardInterrupt in its place.  The wrapped kernel
    can be called from Python only.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except SystemError as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, KeyboardInterrupt):  # one SystemError for every array
                cause = cause.__cause__ or cause.__context__
            raise cause or error from None

    return cast(_Function, call)


def _cached(function: _Function, **options: Any) -> _Function:
    """Return a compiled kernel with a cache on disk, after stale files were removed from the cache folder.

    The kernel has no cache, and a warning is issued, if the user can write no folder that numba uses.

    `options`: further options of `numba.njit`.
    """
    source = getattr(function, "py_func", function)
    try:
        compiled = _njit(**_KERNEL, **options)(source)
    except RuntimeError:  # numba has no folder for the machine code that it can write
        _warn_without_cache()
        return cast(_Function, _njit(**{**_KERNEL, "cache": False}, **options)(source))
    folder = cache_folder(compiled)
    if folder is not None:
        _remove_stale_kernels(folder)
    return cast(_Function, compiled)


@cache
def _warn_without_cache() -> None:
    """Warn once that compiled kernels are lost at the end of the process."""
    warnings.warn(
        "compiled kernels cannot be stored, because neither the folder of resgrid nor the home folder can be written; "
        "every process compiles them again, which takes 10 to 60 s; set the variable NUMBA_CACHE_DIR to a folder that "
        "you can write",
        stacklevel=2,
    )


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """Return the folder in which numba caches a kernel; None if the kernel is not cached (``NUMBA_DISABLE_JIT``)."""
    stats = getattr(unwrap(function, stop=lambda one: hasattr(one, "stats")), "stats", None)
    return None if stats is None or stats.cache_path is None else Path(stats.cache_path)


@cache
def _remove_stale_kernels(folder: Path) -> None:
    """Delete the cached kernels in a folder if any kernel source has changed since their compilation.

    Numba compares a cached kernel only with the source file of the kernel, not with the files of the functions that the
    kernel calls.  Loading a cached kernel also fails after a class of its arguments has been renamed.
    """
    stamp, current = folder / _STAMP, _source_hash()
    with contextlib.suppress(OSError):
        if stamp.read_text(encoding="ascii") == current:
            return
    with contextlib.suppress(OSError):  # another process deletes the same files
        for pattern in ("*.nbi", "*.nbc"):
            for file in folder.glob(pattern):
                file.unlink(missing_ok=True)
        stamp.write_text(current, encoding="ascii")


@cache
def _source_hash() -> str:
    """Return the SHA-256 digest of the sources of all kernels and device functions."""
    package = Path(__file__).parents[1]
    files = {*package.rglob("*kernels.py"), *(package / "solvers").rglob("*.py"), Path(__file__)}
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()
