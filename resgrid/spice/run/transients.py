"""Runs of the transient analysis of a deck in ngspice, with the simulated waveforms as result."""

from __future__ import annotations

from resgrid._internal.files import temporary_folder
from resgrid.errors import InputError
from resgrid.spice.run.ngspice import (
    EXECUTABLE_VARIABLE,
    INSTALL,
    RAW,
    complaints_in,
    find_program,
    plot_in,
    refuse_commands,
    run_quietly,
    version_of,
)
from resgrid.spice.run.rawfile import RawFile

_PLOT = "Transient Analysis"


def simulate_transient(
    deck: tuple[str, bytes], commands: bytes, *, source: str, timeout: float
) -> tuple[RawFile | None, str, tuple[str, ...]]:
    """Run the transient of a deck in ngspice; return the waveforms, the version of ngspice, and its messages.

    `deck`: file name and content of the deck; `commands`: content of the file that includes the deck and requests the
    transient; `source`: name of the deck in messages; `timeout`: longest run, in seconds.  The waveforms are None if
    ngspice wrote no transient.  Raise ToolMissingError if ngspice is not installed, InputError for a deck with
    commands, and BudgetError after the timeout.
    """
    program = find_program(EXECUTABLE_VARIABLE, "ngspice", INSTALL)
    name, data = deck
    refuse_commands(data, source)
    refuse_commands(commands, f"{source}.ngspice", includes=True)
    with temporary_folder() as folder:
        version = version_of(program, folder)
        (folder / name).write_bytes(data)
        (folder / "run.cir").write_bytes(commands)
        status = run_quietly([program, "-n", "-b", "-r", str(folder / RAW), "run.cir"], folder, timeout, source)
        messages = complaints_in(folder, "ngspice")
        try:
            raw = plot_in(folder, _PLOT, "a transient")
        except InputError as error:
            return None, version, (f"{error} (exit status {status})", *messages)
        return raw, version, messages
