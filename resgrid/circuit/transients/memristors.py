"""The types `Memristor` (a charge-controlled resistance) and `MemristiveCircuit` (a netlist with memristors).

The law is the linear ion drift of Strukov, Snider, Stewart & Williams (2008).  The state ``x`` in [0, 1] is the doped
fraction of a film; the resistance is ``M(x) = x R_on + (1 - x) R_off``, and a current ``i`` moves the state by
``dx/dt = k i f(x)``.  For a film of thickness ``D`` and ion mobility ``mu`` the rate is ``k = mu R_on / D**2``.  The
window ``f`` keeps the state between its limits: it is 1 inside of them and 0 where the current drives the state out
(rectangular window), or ``1 - (2 x - 1)**(2 p)`` (Joglekar & Wolf 2009).

Along a motion of the state without a stop at a limit, ``dx/dq = k f(x)`` with the charge ``q``.  The state, and with it
the resistance, is then a function of the charge alone, whatever the waveform of the current.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Positive, check_number, real_numbers
from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.core.netlist import Netlist, add_elements, crossed_by
from resgrid.errors import InputError

Window = Literal["rectangular", "joglekar"]


@checked
@dataclass(frozen=True)
class Memristor:
    """Law of a charge-controlled resistor with linear ion drift (Strukov et al. 2008).

    The resistance is ``M(x) = x on_resistance + (1 - x) off_resistance``, and the state ``x`` in [0, 1] follows
    ``dx/dt = rate i f(x)`` with the current ``i`` and the window ``f``.

    Parameters
    ----------
    on_resistance, off_resistance : float
        Resistances in the states 1 and 0, in ohms; the first is the smaller.
    rate : float
        Change of the state by one coulomb far from the limits, in 1/C.
    window : {"rectangular", "joglekar"}
        Factor of the drift: 1 until the state reaches a limit and stops there, or ``1 - (2 x - 1)**(2 exponent)``
        (Joglekar & Wolf 2009), with which the state approaches its limits and never leaves them.
    exponent : int
        Exponent ``p`` of the Joglekar window; ignored by the rectangular one.
    initial : float
        State at time 0, from 0 to 1; between 0 and 1 with the Joglekar window.

    Raises
    ------
    InputError
        If ``on_resistance`` is not below ``off_resistance``, or a number is not admissible.

    Examples
    --------
    >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)
    >>> law.resistance([0.0, 0.5, 1.0])
    array([16000.,  8050.,   100.])
    """

    on_resistance: Positive
    off_resistance: Positive
    rate: Positive
    window: Window = "rectangular"
    exponent: Annotated[int, Ge(1), Le(100)] = 1
    initial: Annotated[float, Ge(0), Le(1)] = 0.0

    def __post_init__(self) -> None:
        if not self.on_resistance < self.off_resistance:
            raise InputError(
                f"on_resistance = {self.on_resistance:g} ohm must be below off_resistance = {self.off_resistance:g} "
                "ohm: the state 1 is the conducting one; exchange them"
            )
        _check_state(self, np.array([self.initial]), "initial")

    @classmethod
    def thin_film(
        cls,
        on_resistance: Positive,
        off_resistance: Positive,
        *,
        mobility: Positive,
        thickness: Positive,
        window: Window = "rectangular",
        exponent: int = 1,
        initial: float = 0.0,
    ) -> Memristor:
        """Return the law of a film, with the rate ``mobility on_resistance / thickness**2`` (Strukov et al. 2008).

        Parameters
        ----------
        on_resistance, off_resistance : float
            Resistances of the doped and of the undoped film, in ohms.
        mobility : float
            Mobility of the ions, in m^2/(V s).
        thickness : float
            Thickness of the film, in metres.
        window, exponent, initial
            Window of the drift, exponent of the Joglekar window, and state at time 0, as for the class.

        Returns
        -------
        Memristor
            The law of the film.

        Raises
        ------
        InputError
            If a number is not admissible.

        Examples
        --------
        >>> film = rg.circuit.Memristor.thin_film(100.0, 16e3, mobility=1e-14, thickness=1e-8)
        >>> round(film.rate)
        10000
        """
        for name, value in (("on_resistance", on_resistance), ("mobility", mobility), ("thickness", thickness)):
            check_number(name, value, "a finite number above 0", above=0)
        rate = mobility * on_resistance / thickness / thickness
        return cls(on_resistance, off_resistance, rate, window=window, exponent=exponent, initial=initial)

    def resistance(self, state: ArrayLike) -> NDArray[np.float64]:
        """Return the resistance in ohms, in the shape of `state`; raise InputError for a state outside [0, 1]."""
        x = np.array(real_numbers("state", state), dtype=np.float64)
        if not np.all((x >= 0) & (x <= 1)):
            raise InputError("state must hold numbers from 0 (off_resistance) to 1 (on_resistance)")
        return np.asarray(self.off_resistance - (self.off_resistance - self.on_resistance) * x)


@frozen
@checked
@dataclass(frozen=True, eq=False)
class MemristiveCircuit:
    """Circuit in which resistors of a netlist are memristors.

    Parameters
    ----------
    netlist : Netlist
        Circuit without nonlinear resistors and cost map; the conductances of the memristors are replaced.
    law : Memristor
        Law of all memristors.
    memristors : array_like of int, shape (m,), optional
        Indices of the resistors that are memristors; by default all resistors.
    polarity : array_like of int, shape (m,) or ()
        1 if a current from the first to the second node of the resistor increases the state (and so lowers the
        resistance), -1 if such a current decreases it.  One number applies to all memristors.
    state : array_like of float, shape (m,) or (), optional
        States at time 0; by default ``law.initial``.

    Attributes
    ----------
    netlist : Netlist
        The circuit in the states at time 0, for analyses of circuits of resistors.
    memristors : ndarray of int64, shape (m,)
        Indices of the resistors that are memristors.
    polarity : ndarray of float64, shape (m,)
        Polarity of every memristor, 1 or -1.
    state : ndarray of float64, shape (m,)
        State of every memristor at time 0, from 0 to 1.

    Raises
    ------
    InputError
        If the netlist has nonlinear resistors or a cost map, a resistor does not exist or is named twice, or a polarity
        or a state is not admissible.

    Examples
    --------
    >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)
    >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> rg.circuit.MemristiveCircuit(loop, law)
    <MemristiveCircuit of 1 memristor and 0 resistors>
    """

    netlist: Netlist
    law: Memristor
    memristors: NDArray[np.int64] = field(default=None)  # type: ignore[arg-type]
    polarity: NDArray[np.float64] = field(default=1)  # type: ignore[arg-type]
    state: NDArray[np.float64] = field(default=None)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        count = len(self.netlist.conductance)
        if self.netlist.nonlinear_current.size:
            raise InputError(
                f"the netlist has {len(self.netlist.nonlinear_current)} nonlinear resistors, which cannot be combined "
                "with memristors; replace them with resistors"
            )
        _check_cost_map(self.netlist)
        chosen = _chosen_resistors(self.memristors, count)
        polarity = _per_memristor("polarity", self.polarity, len(chosen))
        if not np.all(np.abs(polarity) == 1):
            raise InputError("polarity must hold only 1 and -1")
        state = _per_memristor("state", self.law.initial if self.state is None else self.state, len(chosen))
        _check_state(self.law, state, "state")
        object.__setattr__(self, "memristors", chosen)
        object.__setattr__(self, "polarity", polarity)
        object.__setattr__(self, "state", state)
        object.__setattr__(self, "netlist", self.netlist_at(state))

    def __repr__(self) -> str:
        own, rest = len(self.memristors), len(self.netlist.conductance) - len(self.memristors)
        return f"<MemristiveCircuit of {own:,} memristor{'s' * (own != 1)} and {rest:,} resistor{'s' * (rest != 1)}>"

    @classmethod
    def antiparallel(cls, netlist: Netlist, law: Memristor, memristors: ArrayLike | None = None) -> MemristiveCircuit:
        """Return a circuit with two memristors of opposite polarity in parallel for every chosen resistor.

        Such a pair lowers its resistance for either direction of the current: one of its memristors conducts better,
        and the other stays in the state 0.

        Parameters
        ----------
        netlist : Netlist
            Circuit without nonlinear resistors.
        law : Memristor
            Law of all memristors.
        memristors : array_like of int, shape (m,), optional
            Indices of the resistors to replace; by default all resistors.

        Returns
        -------
        MemristiveCircuit
            Circuit with ``2 m`` memristors: those of polarity 1 in place of the resistors, and then those of polarity
            -1, in the same order.

        Examples
        --------
        >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)
        >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
        >>> rg.circuit.MemristiveCircuit.antiparallel(loop, law).polarity
        array([ 1., -1.])
        """
        single = cls(netlist, law)  # checks the types
        count = len(single.memristors)
        chosen = _chosen_resistors(memristors, count)
        crossed = {key: value[chosen] for key, value in crossed_by(netlist, "resistor").items()}
        siemens = netlist.conductance[chosen]
        doubled = add_elements(netlist, "resistor", netlist.resistor_nodes[chosen], siemens, **crossed)
        both = np.concatenate([chosen, count + np.arange(len(chosen))])
        return cls(doubled, law, both, np.repeat([1.0, -1.0], len(chosen)))

    def netlist_at(self, state: ArrayLike) -> Netlist:
        """Return the circuit with a resistor in place of every memristor, for given states of the memristors.

        Parameters
        ----------
        state : array_like of float, shape (m,) or ()
            States of the memristors, from 0 to 1; one number applies to all.

        Returns
        -------
        Netlist
            The netlist with the conductances of the memristors in these states, in siemens.

        Raises
        ------
        InputError
            If a state lies outside [0, 1], or the number of states is wrong.

        Examples
        --------
        >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)
        >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
        >>> rg.circuit.MemristiveCircuit(loop, law).netlist_at(1.0).conductance
        array([0.01])
        """
        siemens = self.netlist.conductance.copy()
        siemens[self.memristors] = 1 / self.law.resistance(_per_memristor("state", state, len(self.memristors)))
        return self.netlist.replace(conductance=siemens)


def _check_state(law: Memristor, state: NDArray[np.float64], name: str) -> None:
    """Raise InputError unless all states can occur with a law; `state` (m,); `name`: name of the states in messages."""
    bad = np.flatnonzero(~((state >= 0) & (state <= 1)))
    if bad.size:
        raise InputError(
            f"{name} = {state[bad[0]]} of memristor {bad[0]} must lie between 0 (off_resistance) and 1 (on_resistance)"
        )
    stuck = np.flatnonzero((state == 0) | (state == 1))
    if law.window == "joglekar" and stuck.size:
        raise InputError(
            f"{name} = {state[stuck[0]]} of memristor {stuck[0]} would never change, because the Joglekar window is 0 "
            "there; choose a state between 0 and 1, such as 0.01"
        )


def _check_cost_map(netlist: Netlist) -> None:
    """Raise InputError for a netlist of a space with a cost map, because the law replaces the conductances."""
    cost_map = None if netlist.cell_map is None else netlist.cell_map.space.conductivity
    if cost_map is not None and np.ptp(cost_map) > 0:
        raise InputError(
            "the netlist has a cost map (conductivity), which the law of the memristors would replace; compile the "
            "space without conductivity"
        )


def _chosen_resistors(memristors: ArrayLike | None, count: int) -> NDArray[np.int64]:
    """Return the indices (m,) of the resistors that are memristors; raise InputError for wrong indices.

    `memristors` (m,): indices, None for all; `count`: number of resistors.
    """
    if not count:
        raise InputError("the netlist has no resistors that could be memristors; add resistors")
    if memristors is None:
        return np.arange(count)
    given = real_numbers("memristors", memristors)
    if given.ndim != 1 or not given.size or given.dtype.kind not in "iu":
        raise InputError("memristors must be a list of resistor indices (whole numbers), with at least one entry")
    chosen = given.astype(np.int64)
    if chosen.min() < 0 or chosen.max() >= count:
        bad = chosen[(chosen < 0) | (chosen >= count)][0]
        raise InputError(f"memristors names resistor {bad}, but the resistors have the numbers 0 to {count - 1}")
    if len(np.unique(chosen)) < len(chosen):
        raise InputError("memristors names a resistor twice; name each one once (antiparallel makes two of each)")
    return chosen


def _per_memristor(name: str, value: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return one number per memristor, (count,); raise InputError if `value` is neither a number nor (count,).

    A single number is repeated for all memristors.  `name`: name in messages.
    """
    given = np.array(real_numbers(name, value), dtype=np.float64)
    if given.shape not in ((), (count,)):
        raise InputError(f"{name} has shape {given.shape}; give one number, or one for each of the {count} memristors")
    return np.array(np.broadcast_to(given, (count,)))
