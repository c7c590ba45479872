"""Tables of elements and nodes while a deck is read: lists first, arrays when the deck or a subcircuit is complete."""

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
"""Number of nodes and number of values of an element, by kind.

Values of a resistor: ohms, tc1 (1/K) and tc2 (1/K^2) at the deck's nominal temperature.  Values of a voltage source:
volts, and 1 if the source replaces an inductor, else 0.  Values of a nonlinear resistor: I0 in amperes and V0 in volts
of the current ``I0 tanh(V / V0)``.  Values of a switch: on and off resistance in ohms, the control voltages in volts
beyond which the switch is on and off, and the state between these voltages (1 on, 0 off, NaN neither).
"""

RESISTIVE = {"resistor": 1, "switch": 2}
"""Number of leading values of an element that are divided by the multiplier ``m=`` (number of parallel elements).

The keys are kinds of element; the values are resistances.  In other kinds, the first value is multiplied by the
multiplier, except in voltage sources, which ignore the multiplier.
"""


@dataclass(eq=False)
class NodeTable:
    """Node numbers of a block (the deck or a subcircuit) by name, regardless of case.

    A node keeps the spelling of its first use in the deck.  `grounds`: names of ground in lower case; `exact`: whether
    the dialect is case-sensitive; `clashes`: names that differ from earlier ones only by case, collected if `exact`;
    `names`: names of the nodes by number; `aliases`: names of ground, other than ``0``, that the block uses.
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
        """Node number by name in lower case, including the names of ground."""
        count = len(self.names)
        if self._entered < count:
            later = self.names[self._entered :]
            self._number.update(zip(map(str.lower, later), range(self._entered, count), strict=True))
            self._number.update(dict.fromkeys(self.aliases, self._number.get("0", 0)))
            self._entered = count
        return self._number

    def number_of(self, name: str, order: int) -> int:
        """Return the number of the node `name`, which is added to the table if it is new.

        `order`: position of this use in the deck (file index times ``2**40`` plus line number); the node's name gets
        the spelling of the use with the smallest position.
        """
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
        """Add the node `name`, or an alias of ground, to the table; return the node's number.

        `folded`: the name in lower case; `order`: position of the first use in the deck (file index times ``2**40``
        plus line number).
        """
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

    def numbers_in_instances(self, names: list[str], orders: list[int]) -> NDArray[np.int64]:
        """Return the numbers of nodes inside instances of subcircuits, shape (n,), and add new nodes to the table.

        `names`: n full names of the nodes, such as ``x1.mid``; `orders`: position of each use in the deck (file index
        times ``2**40`` plus line number).  All nodes are new unless the deck itself uses names with a dot.
        """
        if self._dotted:
            return np.fromiter(map(self.number_of, names, orders), np.int64, len(names))
        first = len(self.names)
        self.names.extend(names)
        return np.arange(first, first + len(names))

    def numbers_of(self, names: list[str], orders: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers (n,) of nodes, and add new nodes to the table.

        `names`: n names of nodes, no two of which are equal regardless of case; `orders` (n,): position of each node's
        first use in the deck (file index times ``2**40`` plus line number).
        """
        if len(self.names) > 1:
            return np.fromiter(map(self.number_of, names, orders.tolist()), np.int64, len(names))
        is_ground = np.fromiter(map(self.grounds.__contains__, map(str.lower, names)), np.bool_, len(names))
        self.aliases.update(name.lower() for name in compress(names, is_ground.tobytes()))
        self.aliases.discard("0")
        self.names.extend(compress(names, (~is_ground).tobytes()))
        self._bulk_spelt_at = np.concatenate([np.zeros(1, dtype=np.int64), orders[~is_ground]])
        return np.where(is_ground, 0, np.cumsum(~is_ground))


@dataclass(frozen=True, eq=False)
class ElementArrays:
    """Arrays of n elements of one kind.

    `names`: function that returns the names of the elements; `nodes` (n, nodes per element): node numbers; `values` (n,
    values per element), such as ohms, tc1 and tc2 of resistors, or (n, 1) if all but the first are zero (`WIDTHS` lists
    the columns); `place` (n, 2): index of the file, and line of the element's card; `order` (n,): position in the deck
    (file index times ``2**40`` plus line number) of the outermost instance that contains the element, or of the element
    itself; None if all elements are outside instances and sorted.
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
        """Positions (n,) in the deck by which the elements are sorted: file index times ``2**40`` plus line number."""
        return order_of(self.place) if self.order is None else self.order


def order_of(place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the position of each element as one number, file index times ``2**40`` plus line number; shape (n,).

    The numbers sort by file and then by line.  `place` (n, 2): index of the file, and line.
    """
    return np.asarray((place[:, 0] << 40) | place[:, 1])


Row = tuple[str, tuple[int, ...], tuple[float, ...], tuple[int, int]]
"""Name, node numbers, values, and place (index of the file, line) of one element."""


@dataclass(eq=False)
class Elements:
    """The elements of a block (the deck or a subcircuit), as rows and as arrays, both by kind of element.

    `rows`: for every kind, one tuple per element that was read from its card; `parts`: for every kind, a list of
    `ElementArrays`, each with many elements: those of all plain cards (lines ``name node node value``) of a file, or
    the copies of all elements of this kind of one flattened subcircuit. An element is either in `rows` or in `parts`.
    `nodes`: node numbers of the block; `nominal`: nominal temperature, in degrees Celsius; `heating`: temperature of
    the deck minus nominal temperature, in kelvin.
    """

    nodes: NodeTable
    nominal: float
    heating: float = 0.0
    rows: dict[str, list[Row]] = field(default_factory=lambda: {kind: [] for kind in WIDTHS})
    parts: dict[str, list[ElementArrays]] = field(default_factory=lambda: {kind: [] for kind in WIDTHS})

    def add(self, kind: str, name: str, nodes: Iterable[str], values: tuple[float, ...], card: Card) -> None:
        """Add one element to `rows`, and its nodes to `nodes` if they are new.

        `kind`: kind of element, such as "resistor"; `name`: name of the element; `nodes`: names of the nodes; `values`:
        values of this kind, such as ohms, tc1 and tc2 (`WIDTHS` lists them); `card`: the element's card (statement).
        """
        number_of, order = self.nodes.number_of, card.file << 40 | card.line
        self.rows[kind].append(
            (name, tuple([number_of(node, order) for node in nodes]), values, (card.file, card.line))
        )

    def joined(self, kind: str) -> ElementArrays:
        """Return all elements of a kind, from `rows` and `parts`, in one `ElementArrays`, in the order of the deck."""
        if not self.rows[kind]:
            return joined_parts(kind, self.parts[kind])
        names, nodes, values, places = zip(*self.rows[kind], strict=True)
        place = np.array(places, dtype=np.int64)
        own = ElementArrays(lambda: list(names), np.array(nodes, np.int64), np.array(values), place, order_of(place))
        return joined_parts(kind, [own, *self.parts[kind]])


def joined_parts(kind: str, parts: list[ElementArrays]) -> ElementArrays:
    """Return several `ElementArrays` of one kind as one, sorted by position in the deck.

    `kind`: kind of element, a key of `WIDTHS`; `parts`: the elements, in a list that may be empty.
    """
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
    """Return element values with all columns of their kind, shape (n, columns); missing columns are filled with zeros.

    `kind`: kind of element, which has ``WIDTHS[kind][1]`` columns; `values`: shape (n, columns), or (n, 1) if only the
    first column is stored.
    """
    if values.shape[1] == WIDTHS[kind][1]:
        return values
    full = np.zeros((len(values), WIDTHS[kind][1]))
    full[:, :1] = values
    return full


def _sorted(part: ElementArrays) -> ElementArrays:
    """Return the elements `part`, sorted by position in the deck: index of the file, then line."""
    if part.order is None or np.all(part.order[1:] >= part.order[:-1]):
        return part
    order = np.argsort(part.order, kind="stable")

    def names() -> list[str]:
        unsorted = part.names()
        return [unsorted[i] for i in order.tolist()]

    return ElementArrays(names, part.nodes[order], part.values[order], part.place[order], part.order[order])


class LazyNames(Mapping[str, tuple[str, ...]]):
    """Names of elements by kind of element, created at the first access of each kind.

    `makers`: for every kind, a function that returns the names.
    """

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
