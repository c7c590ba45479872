"""Decks cut, flipped and stuffed at random: each is read or refused, soon, and nothing outside its root is opened.

``python tests/fuzz_decks.py 100000`` does as many (`make fuzz`); the tests do some thousands.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from resgrid.errors import ResgridError
from resgrid.spice.circuit import KINDS, Circuit
from resgrid.spice.read.deck import read_with

sys.path.insert(0, str(Path(__file__).parent))
from support.decks import random_deck

LONGEST = 1.0
"""Seconds that a deck of a few kilobytes may take."""

SECRET = "rsecret leaked 0 1234.5\n"

_WORDS = (
    *("0", "gnd", "1k", "1M", "1e400", "-1e-400", "nan", "inf", "0x10", "1e", "4k7", "r", "R1", "V1", "X1", "S1", "D1"),
    *("{", "}", "'", '"', "(", ")", "=", ",", ";", "$ ", "//", "*", "+", "\\\\", ".", "..", "\t", "\r", "\f", "\x0b"),
    *(
        "\u00b5",
        "\u2126",
        "\xff",
        "{1/0}",
        "{1e308*10}",
        "{a}",
        "{sqrt(-1)}",
        "{2**2**2}",
        "{((((1))))}",
        "m=0",
        "m=-1",
    ),
    *("tc=1,2,3", "r=", "r=1", "ac", "dc", "pulse(", "pwl(0 1", "sin", "params:", "on", "off", "99999999999999999999"),
    *(
        "\n.end\n",
        "\n.subckt s a b\n",
        "\n.ends\n",
        "\n.control\n",
        "\n.endc\n",
        "\n.if 1\n",
        "\n.lib x\n",
        "\n.endl\n",
    ),
    *("\n.include a.inc\n", "\n.include ../outside/secret.inc\n", "\n.include link.inc\n", "\n.inc '/etc/passwd'\n"),
    *(
        "\n.include b.inc\n",
        "\n.lib sections.lib tt\n",
        "\n.lib sections.lib none\n",
        "\n.include folder\n",
        "\n.include .\n",
    ),
    *("\n.include /dev/zero\n", "\n.include link_folder/secret.inc\n", "\n.include ~/x\n", "\n.include pipe.inc\n"),
    *(
        "\n.param a=1\n",
        "\n.param a={b} b={a}\n",
        "\n.func f(x) {f(x)}\n",
        "\n.global g\n",
        "\n.temp 1e9\n",
        "\n.alter\n",
    ),
    *(
        "\n.model m r(tc1=1)\n",
        "\n.model m sw\n",
        "\n.option temp=x\n",
        "\n.data d\n",
        "\nX1 a b s\n",
        "\nx s\n",
        "\n+\n",
    ),
)


def seeds() -> list[str]:
    """Decks to begin from, nasty ones among them."""
    nested = "".join(f".subckt n{i} a b\nx1 a m n{i + 1}\nx2 m b n{i + 1}\n.ends\n" for i in range(40))
    chain = "".join(f".param c{i}={{c{i + 1}+1}}\n" for i in range(300))
    return [
        *(random_deck(seed) for seed in range(30)),
        "t\n.include a.inc\n.lib sections.lib tt\nR1 a 0 1\nV1 a 0 1\n",
        f"t\n{nested}.subckt n40 a b\nR1 a b 1\n.ends\nx1 1 0 n0\nV1 1 0 1\n",
        f"t\n{chain}.param c300=1\nR1 a 0 {{c0}}\nV1 a 0 1\n",
        "t\n.subckt s a b\nx1 a b s\n.ends\nx1 1 0 s\n",
        "t\nR1 a 0 {" + "(" * 3000 + "1" + ")" * 3000 + "}\n",
        "t\nR1 a 0 {" + "-" * 5000 + "1}\n",
        "t\nR1 a 0 {" + "1+" * 4000 + "1}\nV1 a 0 1\n",
        "t\nR1 a 0 1" + "0" * 5000 + "\nV1 a 0 1e" + "9" * 500 + "\n",
        "R1 a b 1\nR2 b 0 1\nV1 a 0 1\n.end",
        "t\nR1 " + "a" * 100_000 + " 0 1\n" + "+ tc1=1\n" * 1000,
        "t\n.subckt s a b params: r=1\nR1 a m {r}\nR2 m b {2*r}\n.ends\n" + "x1 1 0 s r={1+1}\n" * 200 + "V1 1 0 1\n",
    ]


def mutate(text: str, pick: random.Random) -> bytes:
    """Change a deck in a few places."""
    data = bytearray(text.encode())
    for _ in range(pick.randrange(1, 6)):
        at = pick.randrange(len(data) + 1)
        kind = pick.randrange(7)
        lines = bytes(data).split(b"\n")
        if kind == 0 and data:
            data[at % len(data)] = pick.randrange(256)
        elif kind == 1:
            data = data[:at]
        elif kind == 2:
            del lines[pick.randrange(len(lines))]
            data = bytearray(b"\n".join(lines))
        elif kind == 3:
            lines.insert(pick.randrange(len(lines)), pick.choice(lines))
            data = bytearray(b"\n".join(lines))
        elif kind == 4:
            data[at:at] = pick.choice(_WORDS).encode() * pick.choice((1, 1, 1, 2, 50))
        elif kind == 5:
            line = lines[pick.randrange(len(lines))].split(b" ")
            line[pick.randrange(len(line))] = pick.choice(_WORDS).encode()
            lines[pick.randrange(len(lines))] = b" ".join(line)
            data = bytearray(b"\n".join(lines))
        else:
            del data[at : at + pick.randrange(1, 30)]
    return bytes(data)


def furnish(folder: Path) -> Path:
    """Make a root to read below, with things to include in it, and secrets outside; returns the root."""
    root, outside = folder / "root", folder / "outside"
    root.mkdir()
    outside.mkdir()
    (root / "folder").mkdir()
    (outside / "secret.inc").write_text(SECRET)
    (root / "link.inc").symlink_to(outside / "secret.inc")
    (root / "link_folder").symlink_to(outside)
    os.mkfifo(root / "pipe.inc")
    (root / "a.inc").write_text("Rin a 0 10\n.include b.inc\n")
    (root / "b.inc").write_text(".param inner=3\n")
    (root / "sections.lib").write_text(".lib tt\n.param corner=1\n.endl tt\n.lib ff\n.include a.inc\n.endl\n")
    return root


_watched: list[str] | None = None


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if _watched is not None and event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        _watched.append(os.path.realpath(os.fsdecode(arguments[0])))


sys.addaudithook(_watch)


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """Files that are opened meanwhile."""
    global _watched  # noqa: PLW0603 - an audit hook cannot be taken away
    _watched = []
    try:
        yield _watched
    finally:
        _watched = None


def outcome(path: Path, least_bytes: int) -> Circuit | str:
    """What comes of reading a deck, and of making a netlist of it: the deck, or the error's message."""
    try:
        deck = read_with(path, least_bytes=least_bytes)
    except ResgridError as error:
        return str(error)
    try:
        deck.netlist()
    except ResgridError as error:
        assert str(error)
    return deck


def same(a: Circuit | str, b: Circuit | str) -> bool:
    """Whether two readings are the same in everything but the order of notes."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    arrays = ("resistor_nodes", "resistance", "source_nodes", "source_volts", "current_nodes", "current_amps")
    return (
        (a.title, a.node_names, dict(a.element_names), set(a.notes))
        == (b.title, b.node_names, dict(b.element_names), set(b.notes))
        and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in arrays)
        and all(np.array_equal(a.place[kind], b.place[kind]) for kind in KINDS)
    )


def fuzz(first: int, count: int, folder: Path) -> int:
    """Read mutated decks; returns how many were accepted.

    Raises
    ------
    AssertionError
        With the number of the deck, if a promise is broken.
    """
    root = furnish(folder)
    path = root / "deck.cir"
    own = tuple(os.path.realpath(place) for place in (Path(np.__file__).parents[1], sys.prefix, sys.base_prefix))
    own += (str(Path(__file__).resolve().parents[1]),)
    begin = seeds()
    accepted = 0
    path.write_text(begin[0])
    outcome(path, 0)  # what is loaded and compiled once does not count
    for number in range(first, first + count):
        pick = random.Random(number)
        path.write_bytes(mutate(pick.choice(begin), pick))
        start = time.perf_counter()
        with opened_files() as opened:
            result = outcome(path, 10**9)
            took = time.perf_counter() - start
            short = outcome(path, 0)
        assert took < LONGEST or _takes_long_again(path), f"deck {number} took {took:.2f} s"
        assert same(result, short), f"deck {number} reads differently the short way: {result}\n{short}"
        strangers = [name for name in opened if not name.startswith((str(root.resolve()), *own))]
        assert not strangers, f"deck {number} opened {strangers}"
        accepted += not isinstance(result, str)
    return accepted


def _takes_long_again(path: Path) -> bool:
    """A slow moment of the machine is not the reader's: True if a second reading is quick."""
    start = time.process_time()
    outcome(path, 10**9)
    return time.process_time() - start < LONGEST


if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    with tempfile.TemporaryDirectory() as home:
        kept = fuzz(0, wanted, Path(home))
    sys.stdout.write(f"{wanted} mutated decks: {kept} read, {wanted - kept} refused, none broke a promise\n")
