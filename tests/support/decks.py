"""Random decks that use many variants of SPICE syntax; ngspice finds the operating point of each deck."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

import resgrid as rg
from resgrid.spice.circuit import KINDS
from resgrid.spice.read.deck import read_with

SUFFIXES = (("", 1.0), ("k", 1e3), ("K", 1e3), ("kOhm", 1e3), ("meg", 1e6), ("Meg", 1e6), ("m", 1e-3), ("u", 1e-6))


class _Tree:
    """Union-find structure, so that sources never close a loop."""

    def __init__(self) -> None:
        self.up: dict[str, str] = {}

    def root(self, node: str) -> str:
        while self.up.get(node, node) != node:
            node = self.up[node]
        return node

    def join(self, a: str, b: str) -> bool:
        a, b = self.root(a), self.root(b)
        self.up[a] = b
        return a != b


class DeckMaker:
    """Writer of one random deck."""

    def __init__(self, pick: random.Random) -> None:
        self.pick = pick
        self.lines: list[str] = []
        self.count = 0
        self.inside = False

    def name(self, letter: str) -> str:
        self.count += 1
        return self.flip(f"{letter}{self.count}")

    def flip(self, text: str) -> str:
        return text.upper() if self.pick.random() < 0.2 else text

    def value(self, ohms: float, names: tuple[str, ...] = ()) -> str:
        """Return a number near the given one: plain, with a suffix, or as an expression."""
        form = self.pick.randrange(6)
        if form == 0 and names:
            name = self.pick.choice(names)
            wrap = self.pick.choice(("{%s}", "'%s'"))
            body = self.pick.choice(
                (f"{ohms!r}*(1+{name})", f"sqrt({ohms!r}**2 + {name})", f"max({ohms!r}, {name})", f"{ohms!r}+{name}/2")
            )
            return wrap % body
        if form == 1:
            suffix, factor = self.pick.choice(SUFFIXES)
            return f"{ohms / factor:.6g}{suffix}"
        if form == 2:
            return f"{ohms:.5e}"
        return repr(ohms)

    def ohms(self) -> float:
        return float(10.0 ** self.pick.uniform(0, 5))

    def resistor(self, a: str, b: str, names: tuple[str, ...] = ()) -> str:
        value = self.value(self.ohms(), names)
        tail = self.pick.choice(
            (
                "",
                "",
                "",
                " tc1=1e-3",
                " tc1=2m tc2=1u",
                " tc=1e-3",
                " m=2",
                " dtemp=5 tc1=1m",
                " ac=5",
                " ; load",
                " $ load",
            )
        )
        head = self.pick.choice(
            (f"{self.name('r')} {a} {b} ", f"{self.name('R')}  {a},{b}\t", f"{self.name('r')} ({a} {b}) ")
        )
        forms = [value, value, f"R={value}", f"r = {value}"]
        if "," not in head:  # ngspice 39 finds no model after a comma or an expression
            forms += [f"load r={value}"] + ([] if value[0] in "{'" else [f"{value} load"])
        if self.inside and "m=2" in tail:
            tail = ""
        return self.broken(head + self.pick.choice(forms) + tail)

    def broken(self, line: str) -> str:
        """Continue a card on another line at random."""
        if self.pick.random() > 0.15 or ";" in line or "$" in line or " " not in line:
            return line
        head, tail = line.rsplit(" ", 1)
        if any(mark in tail for mark in "{}'") or any(mark in head for mark in "{}'"):
            return line
        return f"{head}\n{self.pick.choice(('', '* between', ''))}\n{self.pick.choice(('+', '+ ', '  +  '))}{tail}"

    def body(self, nodes: list[str], names: tuple[str, ...], fixed: int) -> list[str]:
        """Return a random connected network of resistors on nodes, with shorts, capacitors and current sources."""
        lines = [self.resistor(nodes[i], self.pick.choice(nodes[:i]), names) for i in range(1, len(nodes))]
        for _ in range(self.pick.randrange(4)):
            a, b = self.pick.sample(nodes, 2)
            lines.append(self.resistor(a, b, names))
        tied = _Tree()
        for node in ("0", *nodes[:fixed]):
            tied.join(node, "given")
        for _ in range(self.pick.randrange(3)):
            a, b = self.pick.sample(nodes, 2)
            if tied.join(a, b):
                lines.append(
                    self.pick.choice(
                        (
                            f"{self.name('v')} {a} {b} 0",
                            f"{self.name('l')} {a} {b} 1u",
                            f"{self.name('V')} {a} {b} dc 0.5",
                        )
                    )
                )
        for _ in range(self.pick.randrange(3)):
            a, b = self.pick.sample(nodes, 2)
            amps = self.pick.uniform(-1e-3, 1e-3)
            lines.append(
                self.pick.choice(
                    (
                        f"{self.name('i')} {a} {b} {amps!r}",
                        f"{self.name('i')} {a} {b} DC {amps * 1e3:.6f}m",
                        f"{self.name('i')} {a} {b} pulse({amps!r} 0 1n 1n)",
                        f"{self.name('c')} {a} {b} 10pF",
                        f"{self.name('i')} {a} {b} dc={amps!r} sin(0 1 1k)",
                    )
                )
            )
        return lines

    def call(self, block: tuple[str, int, tuple[str, ...], bool], nodes: list[str], names: tuple[str, ...]) -> str:
        name, ports, parameters, simple = block
        given = ""
        if parameters and self.pick.random() < 0.6:
            value = self.pick.choice((repr(self.pick.uniform(0, 3)), *(f"{{{own}*2}}" for own in names)))
            given = self.pick.choice((" ", " PARAMS: ")) + f"{parameters[0]}={value}"
        # ngspice 39 passes m neither to calls within a subcircuit nor to elements that have an m
        times = " m=2" if simple and self.pick.random() < 0.15 else ""
        return f"{self.name('x')} {' '.join(self.pick.choices(nodes, k=ports))} {self.flip(name)}{given}{times}"

    def deck(self) -> str:
        blocks: list[tuple[str, int, tuple[str, ...], bool]] = []
        lines = [f"random deck {self.pick.randrange(1000)}", "* a comment", f".param p0={self.pick.uniform(0, 2)!r}"]
        lines.append(self.pick.choice((".param p1='p0*2+1'", ".PARAM p1 = {max(p0, 1)}", ".param p1=1k")))
        if self.pick.random() < 0.3:
            lines.append(f".temp {self.pick.choice((27, 50, -10))}")
        lines.append(
            self.pick.choice((".model load r(tc1=1e-3)", ".model LOAD R tnom=20 tc1=1m", ".model load res(tc2=1u)"))
        )
        self.inside = True
        for level in range(self.pick.randrange(4)):
            ports = self.pick.randrange(2, 4)
            own = self.pick.choice(((), (f"q{level}",), (f"q{level}", f"s{level}")))
            inner = [f"t{k}" for k in range(ports)] + [f"n{k}" for k in range(self.pick.randrange(3))]
            local = (*own, "p0")
            defaults = " ".join(f"{name}={self.pick.uniform(0, 2):.4f}" for name in own)
            lines.append(f".subckt blk{level} {' '.join(inner[:ports])} {defaults}")
            lines += self.body([*inner, "0"], local, ports)
            nested = bool(blocks) and self.pick.random() < 0.7
            if nested:
                lines.append(self.call(self.pick.choice(blocks), [*inner, "0"], local))
            lines.append(self.pick.choice((".ends", f".ends blk{level}")))
            blocks.append((f"blk{level}", ports, own, not nested))
        self.inside = False
        nodes = ["0", *(f"a{k}" for k in range(self.pick.randrange(2, 6)))]
        lines += self.body(nodes, ("p0", "p1"), 1)
        lines += [self.call(self.pick.choice(blocks), nodes, ("p0",)) for _ in range(self.pick.randrange(4)) if blocks]
        volts = self.pick.uniform(0.5, 5)
        ground = self.pick.choice(("0", "gnd", "GND"))
        form = self.pick.choice((f"{volts!r}", f"DC {volts!r}", f"dc={volts!r} ac 1"))
        lines += [
            f"vdd vdd {ground} {form}",
            self.resistor("vdd", nodes[1], ("p0",)),
        ]
        if self.pick.random() < 0.4:
            threshold = self.pick.choice((0.1, 10.0))
            lines += [f"s1 vdd {nodes[-1]} vdd 0 swm", f".model swm sw(ron=10 roff=1meg vt={threshold})"]
        return "\n".join([*lines, ".op", ".end"]) + "\n"


def random_deck(seed: int) -> str:
    """Write a random deck: nested subcircuits, parameters, suffixes, floating sources, shorts, switches."""
    return DeckMaker(random.Random(seed)).deck()


def decks() -> st.SearchStrategy[str]:
    """Return a hypothesis strategy of random decks that shrink."""
    return st.randoms(use_true_random=False).map(lambda pick: DeckMaker(pick).deck())


def outcome(path: Path, least_bytes: int) -> rg.spice.Circuit | str:
    """Read a deck and build its netlist; return the deck or the error message."""
    try:
        deck = read_with(path, least_bytes=least_bytes)
    except rg.ResgridError as error:
        return str(error)
    try:
        deck.netlist()
    except rg.ResgridError as error:
        assert str(error)
    return deck


def same(a: rg.spice.Circuit | str, b: rg.spice.Circuit | str) -> bool:
    """Return whether two decks are equal except for the order of their notes."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    arrays = (
        "resistor_nodes", "resistance", "source_nodes", "source_volts", "current_nodes", "current_amps",
        "nonlinear_nodes", "nonlinear_current", "nonlinear_voltage",
    )  # fmt: skip
    return (
        (a.title, a.node_names, dict(a.element_names), set(a.notes))
        == (b.title, b.node_names, dict(b.element_names), set(b.notes))
        and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in arrays)
        and all(np.array_equal(a.place[kind], b.place[kind]) for kind in KINDS)
    )
