"""Which exit code an error ends with, and what is said."""

from __future__ import annotations

from typing import NamedTuple

import click

from resgrid import errors

NEGATIVE, USAGE, TOOL_MISSING, OUT_OF_BUDGET, NOT_VERIFIED, UNEXPECTED = 1, 2, 3, 4, 5, 70
INTERRUPTED, LEFT, TERMINATED = 130, 141, 143  # 128 + the number of the signal: SIGINT, SIGPIPE, SIGTERM

_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (errors.AccuracyError, NEGATIVE),
    (errors.CertificateError, NEGATIVE),
    (errors.ToolMissingError, TOOL_MISSING),
    (errors.BudgetError, OUT_OF_BUDGET),
    (errors.WorkerError, OUT_OF_BUDGET),
    (errors.ResgridError, USAGE),
    (MemoryError, OUT_OF_BUDGET),
)


class Failure(NamedTuple):
    """How a command line ends that could not do its work."""

    code: int
    kind: str
    message: str


def failure_of(error: Exception) -> Failure:
    """What an error means to the person at the terminal."""
    kind = type(error).__name__
    if isinstance(error, click.Abort):
        return Failure(INTERRUPTED, kind, "interrupted")
    if isinstance(error, click.ClickException):
        message, context = error.format_message(), getattr(error, "ctx", None)
        if context and kind != "NoArgsIsHelpError":
            message = f"{message.rstrip('.')}; see '{context.command_path} --help'"
        return Failure(USAGE, kind, message)
    for class_, code in _CODES:
        if isinstance(error, class_):
            return Failure(code, kind, str(error) or "out of memory; use a coarser grid")
    if isinstance(error, OSError) and error.errno is not None:
        place = f"{error.filename}: " if error.filename else ""
        return Failure(USAGE, kind, f"{place}{error.strerror}; check the path, its permissions and the free space")
    fault = f"this is a fault of resgrid ({kind}: {error}); please report it with the output of the same command"
    return Failure(UNEXPECTED, kind, f"{fault} and --debug")
