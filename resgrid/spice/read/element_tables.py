"""Elements and nodes as they are read: lists first, arrays when a block is complete."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.read.cards import Card

WIDTHS = {
    "resistor": (2, 3),
    "voltage source": (2, 2),
    "current source": (2, 1),
    "capacitor": (2, 1),
    "nonlinear resistor": (2, 2),
    "switch": (4, 5),
}
"""Per kind the number of nodes and of values.

A resistor's values: ohms, tc1, tc2 at the deck's nominal temperature.  A voltage source's: volts, and 1 if it stands
for an inductor.  A nonlinear resistor's: amperes and volts.  A switch's: ohms when on, ohms when off, the voltages
above (or below) which it is on and off, and the state between (1, 0).
"""

RESISTIVE = {"resistor": 1, "switch": 2}
"""How many values, the first ones, ``m=`` divides; of other kinds it multiplies the first, of voltage sources none."""


@dataclass(eq=False)
class NodeTable:
    """Numbers of a block's nodes: names are folded, ground has its aliases, the spelling is that of the first use.

    `grounds`: names of ground, in lower case; `exact`: whether names that differ by case mean different nodes, which is
    not borne here; `clashes`: such names.
    """

    grounds: frozenset[str]
    exact: bool = False
    clashes: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    aliases: set[str] = field(default_factory=set)
    _number: dict[str, int] = field(default_factory=dict)
    _entered: int = 0
    _dotted: bool = False
    _spelt_at: dict[int, int] = field(default_factory=dict)
    _bulk_spelt_at: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def number(self) -> dict[str, int]:
        """Number of every name in lower case."""
        count = len(self.names)
        if self._entered < count:
            later = self.names[self._entered :]
            self._number.update(zip(map(str.lower, later), range(self._entered, count), strict=True))
            self._number.update(dict.fromkeys(self.aliases, self._number.get("0", 0)))
            self._entered = count
        return self._number

    def of(self, name: str, order: int) -> int:
        """Number of a node, a new one where there is none yet."""
        folded = name.lower()
        number = self._number.get(folded)
        if number is None:
            self._dotted |= "." in folded
            number = self.number.get(folded)
        if number is None:
            return self._new(name, folded, order)
        if self.exact and name != self.names[number] and folded not in self.grounds:
            self.clashes.append(name)
        in_bulk = int(self._bulk_spelt_at[number]) if number < len(self._bulk_spelt_at) else 0
        if order < self._spelt_at.get(number, in_bulk) and folded not in self.grounds:
            self.names[number] = name
            self._spelt_at[number] = order
        return number

    def _new(self, name: str, folded: str, order: int) -> int:
        ground = folded in self.grounds
        number = self._number["0"] if ground and "0" in self._number else len(self.names)
        if number == len(self.names):
            self.names.append("0" if ground else name)
            self._spelt_at[number] = order
            self._entered += 1
        self._number[folded] = number
        if ground:
            self._number["0"] = number
            self.aliases |= {folded} - {"0"}
        return number

    def of_instances(self, names: list[str], orders: list[int]) -> NDArray[np.int64]:
        """Numbers of nodes within instances: new ones, unless names with a dot were used before; shape (n,)."""
        if self._dotted:
            return np.fromiter(map(self.of, names, orders), np.int64, len(names))
        first = len(self.names)
        self.names.extend(names)
        return np.arange(first, first + len(names))

    def of_all(self, names: list[str], orders: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers of nodes whose names differ from each other regardless of case; shape (n,)."""
        if len(self.names) > 1:
            return np.fromiter(map(self.of, names, orders.tolist()), np.int64, len(names))
        is_ground = np.fromiter(map(self.grounds.__contains__, map(str.lower, names)), np.bool_, len(names))
        self.aliases.update(name.lower() for name in compress(names, is_ground.tobytes()))
        self.aliases.discard("0")
        self.names.extend(compress(names, (~is_ground).tobytes()))
        self._bulk_spelt_at = np.concatenate([np.zeros(1, dtype=np.int64), orders[~is_ground]])
        return np.where(is_ground, 0, np.cumsum(~is_ground))


@dataclass(frozen=True, eq=False)
class ElementArrays:
    """Elements of one kind as arrays.

    `names`: makes their names; `nodes` (n, nodes); `values` (n, values): or, if the others are zero, (n, 1): the first
    alone; `place` (n, 2): file and line of the card that describes the element; `order` (n,): file and line of the card
    of the deck that brings it, as one number; None if that is its own place, and the elements are in order.
    """

    names: Callable[[], list[str]]
    nodes: NDArray[np.int64]
    values: NDArray[np.float64]
    place: NDArray[np.int64]
    order: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def ordered(self) -> NDArray[np.int64]:
        """Its order, made where there is none yet."""
        return order_of(self.place) if self.order is None else self.order


def order_of(place: NDArray[np.int64]) -> NDArray[np.int64]:
    """File and line as one number."""
    return np.asarray((place[:, 0] << 40) | place[:, 1])


Row = tuple[str, tuple[int, ...], tuple[float, ...], tuple[int, int]]
"""An element: its name, nodes, values, and place."""


@dataclass(eq=False)
class Elements:
    """Everything that a block holds: elements that came one by one, and in bulk.

    `nominal`: the temperature at which resistors have their values, in degrees Celsius; `heating`: how far the deck's
    temperature lies above it, in kelvin.
    """

    nodes: NodeTable
    nominal: float
    heating: float = 0.0
    rows: dict[str, list[Row]] = field(default_factory=lambda: {kind: [] for kind in WIDTHS})
    parts: dict[str, list[ElementArrays]] = field(default_factory=lambda: {kind: [] for kind in WIDTHS})

    def add(self, kind: str, name: str, nodes: Iterable[str], values: tuple[float, ...], card: Card) -> None:
        """Add one element."""
        of, order = self.nodes.of, card.file << 40 | card.line
        self.rows[kind].append((name, tuple([of(node, order) for node in nodes]), values, (card.file, card.line)))

    def joined(self, kind: str) -> ElementArrays:
        """All elements of a kind, in the order of the deck."""
        if not self.rows[kind]:
            return joined_parts(kind, self.parts[kind])
        names, nodes, values, places = zip(*self.rows[kind], strict=True)
        place = np.array(places, dtype=np.int64)
        own = ElementArrays(lambda: list(names), np.array(nodes, np.int64), np.array(values), place, order_of(place))
        return joined_parts(kind, [own, *self.parts[kind]])


def joined_parts(kind: str, parts: list[ElementArrays]) -> ElementArrays:
    """Elements of one kind from several parts, in the order of the deck."""
    filled = [part for part in parts if len(part)]
    if not filled:
        width, count = WIDTHS[kind]
        return ElementArrays(
            list, np.empty((0, width), np.int64), np.empty((0, count)), np.empty((0, 2), np.int64), None
        )
    if len(filled) == 1:
        return _sorted(filled[0])
    return _sorted(
        ElementArrays(
            lambda: [name for part in filled for name in part.names()],
            np.concatenate([part.nodes for part in filled]),
            np.concatenate([widened(kind, part.values) for part in filled]),
            np.concatenate([part.place for part in filled]),
            np.concatenate([part.ordered for part in filled]),
        )
    )


def widened(kind: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """All values of elements, of those that were given by their first alone, too."""
    if values.shape[1] == WIDTHS[kind][1]:
        return values
    full = np.zeros((len(values), WIDTHS[kind][1]))
    full[:, :1] = values
    return full


def _sorted(part: ElementArrays) -> ElementArrays:
    if part.order is None or np.all(part.order[1:] >= part.order[:-1]):
        return part
    order = np.argsort(part.order, kind="stable")

    def names() -> list[str]:
        unsorted = part.names()
        return [unsorted[i] for i in order.tolist()]

    return ElementArrays(names, part.nodes[order], part.values[order], part.place[order], part.order[order])


class LateNames(Mapping[str, tuple[str, ...]]):
    """Names of elements per kind, made when they are first asked for."""

    def __init__(self, makers: Mapping[str, Callable[[], Sequence[str]]]) -> None:
        self._makers = makers
        self._made: dict[str, tuple[str, ...]] = {}

    def __getitem__(self, kind: str) -> tuple[str, ...]:
        if kind not in self._made:
            self._made[kind] = tuple(self._makers[kind]())
        return self._made[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)
