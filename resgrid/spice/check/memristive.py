"""Check of a deck with memristors: run its transient in ngspice, and compare voltages and states with its sidecar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from resgrid.errors import InputError
from resgrid.spice.check.agreement import Agreement
from resgrid.spice.circuit import SHOWN, some
from resgrid.spice.run import SIMULATED
from resgrid.spice.run.ngspice import bare_name
from resgrid.spice.run.rawfile import RawFile
from resgrid.spice.run.transients import simulate_transient
from resgrid.spice.write.memristive_sidecar import MemristiveSidecar
from resgrid.spice.write.sidecar import digest, sidecar_path


def check_memristive(path: Path, data: bytes, sidecar: MemristiveSidecar, timeout: float) -> Agreement:
    """Return the comparison of the transient of a deck in ngspice with the values in its sidecar.

    Compared are the node voltages, and the states of the memristors (0 to 1), at the times that the sidecar lists.
    `path`, `data`: path and content of the deck; `sidecar`: expected values, and the tolerance (of voltages relative to
    the supply, of states absolute); `timeout`: longest run, in seconds.  Raises InputError for a deck of a dialect
    other than ngspice, or without the file of commands that `write_memristive` writes next to the deck.
    """
    if sidecar.dialect != SIMULATED:
        raise InputError(
            f"{path} is written for {sidecar.dialect}, and only {SIMULATED} is run here; write a deck with "
            f"dialect = '{SIMULATED}' to check the circuit"
        )
    commands = path.with_name(f"{path.name}.{sidecar.dialect}")
    if not commands.is_file():
        raise InputError(f"{commands} is missing, which requests the transient of {path.name}; write the deck again")
    findings = _altered(path, data, commands, sidecar)
    raw, version, messages = simulate_transient(
        (path.name, data), commands.read_bytes(), source=str(path), timeout=timeout
    )
    findings += messages
    worst: list[tuple[str, float, float, float, float]] = []  # relative error, which is the first key of the order
    if raw is not None:
        found = _at_times(raw, np.array(sidecar.times))
        for kind, expected, scale in (("node", sidecar.nodes, sidecar.supply), ("state", sidecar.states, 1.0)):
            missing = [name for name in expected if name not in found]
            if missing:
                findings.append(f"{len(missing)} {kind}s absent from the simulation: {some(missing, len(missing))}")
            for name, waves in expected.items():
                if name in found:
                    error = np.abs(found[name] - waves.values)
                    at = int(np.argmax(error))
                    worst.append(
                        (name, sidecar.times[at], waves.values[at], float(found[name][at]), float(error[at]) / scale)
                    )
        worst.sort(key=lambda entry: -entry[4])
        findings += [
            f"{name} at {when:g} s: ngspice finds {got!r}, expected {value!r}"
            for name, when, value, got, error in worst[:SHOWN]
            if not error <= sidecar.tolerance
        ]
    volts = [entry[4] * sidecar.supply for entry in worst if entry[0] in sidecar.nodes]
    return Agreement(
        reference="sidecar",
        agrees=None if raw is None else not findings and bool(worst),
        max_abs_error=max(volts, default=None),
        max_relative_error=worst[0][4] if worst else None,
        nodes=len(volts),
        simulator=SIMULATED,
        version=version,
        tolerance=sidecar.tolerance,
        findings=tuple(findings),
        worst=tuple((name, value, got) for name, _, value, got, _ in worst[:SHOWN]),
        remark=f"transient of {len(sidecar.states)} memristors, compared at {len(sidecar.times)} times",
        verified=raw is not None,
    )


def _altered(path: Path, data: bytes, commands: Path, sidecar: MemristiveSidecar) -> list[str]:
    """Return a message for each file that was altered: the deck, the file of commands and the sidecar itself.

    A file was altered if its SHA-256 is not the one that `sidecar` states.  `path`, `data`: path and content of the
    deck; `commands`: path of the file of commands.
    """
    name = sidecar_path(path).name
    pairs = [(path.name, digest(data), sidecar.sha256)]
    pairs.append((commands.name, digest(commands.read_bytes()), sidecar.companions.get(commands.name, "")))
    messages = [f"{file} differs from what resgrid wrote (SHA-256 in {name})" for file, a, b in pairs if a != b]
    if not sidecar.intact:
        messages.append(f"{name} differs from what resgrid wrote (its own SHA-256)")
    return messages


def _at_times(raw: RawFile, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the voltages of a transient at `times`, by name of the node, as arrays (n,) in volts.

    The values between the simulator's times are interpolated by monotone cubic polynomials.  `raw`: the simulator's
    result file; `times` (n,): in seconds.
    """
    instant = np.asarray(raw.values[:, list(raw.kinds).index("time")], dtype=np.float64)
    keep = np.append(np.diff(instant) > 0, True)
    found = {}
    for name, kind, column in zip(raw.names, raw.kinds, raw.values.T, strict=True):
        if kind == "voltage":
            found[bare_name(name)] = np.asarray(
                PchipInterpolator(instant[keep], np.asarray(column, dtype=np.float64)[keep])(times)
            )
    return found
