"""Randomly mutated decks: each is read or rejected with InputError, and no file outside the root is opened.

``RESGRID_MUTATED_DECKS`` is the number of decks (`make fuzz`).
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.decks import outcome, random_deck, same

import resgrid as rg

COUNT = int(os.environ.get("RESGRID_MUTATED_DECKS", "600"))
SECRET = "rsecret leaked 0 1234.5\n"

_WORDS = (
    "0", "gnd", "1k", "1M", "1e400", "-1e-400", "nan", "inf", "0x10", "1e", "4k7", "r", "R1", "V1", "X1", "S1", "D1",
    "{", "}", "'", '"', "(", ")", "=", ",", ";", "$ ", "//", "*", "+", "\\\\", ".", "..", "\t", "\r", "\f", "\u000b",
    '\xb5', '\u2126', '\xff', "{1/0}", "{1e308*10}", "{a}", "{sqrt(-1)}", "{2**2**2}", "{((((1))))}", "m=0", "m=-1",
    "tc=1,2,3", "r=", "r=1", "ac", "dc", "pulse(", "pwl(0 1", "sin", "params:", "on", "off", "99999999999999999999",
    "\n.end\n", "\n.subckt s a b\n", "\n.ends\n", "\n.control\n", "\n.endc\n", "\n.if 1\n", "\n.lib x\n", "\n.endl\n",
    "\n.include a.inc\n", "\n.include ../outside/secret.inc\n", "\n.include link.inc\n", "\n.inc '/etc/passwd'\n",
    "\n.include b.inc\n", "\n.lib sections.lib tt\n", "\n.lib sections.lib none\n", "\n.include folder\n",
    "\n.include .\n", "\n.include /dev/zero\n", "\n.include link_folder/secret.inc\n", "\n.include ~/x\n",
    "\n.include pipe.inc\n", "\n.param a=1\n", "\n.param a={b} b={a}\n", "\n.func f(x) {f(x)}\n", "\n.global g\n",
    "\n.temp 1e9\n", "\n.alter\n", "\n.model m r(tc1=1)\n", "\n.model m sw\n", "\n.option temp=x\n", "\n.data d\n",
    "\nX1 a b s\n", "\nx s\n", "\n+\n",
)  # fmt: skip


def seeds() -> list[str]:
    """Decks before mutation, including pathological ones."""
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
        "// t\nsimulator lang=spectre\nglobal 0\nsubckt s (a b)\nparameters r=1k\nr1 (a m) resistor r=r*2\n"
        "b1 (m b) bsource i=1e-3*tanh(v(m,b)/0.5)\nends s\nv1 (x 0) vsource dc=1\nx1 (x 0) s r=2\n"
        "op dc\nstatistics {\n  vary r std=1\n}\nsimulator lang=spice\nR2 x 0 1meg\n",
        "t\nR1 " + "a" * 100_000 + " 0 1\n" + "+ tc1=1\n" * 1000,
        "t\n.subckt s a b params: r=1\nR1 a m {r}\nR2 m b {2*r}\n.ends\n" + "x1 1 0 s r={1+1}\n" * 200 + "V1 1 0 1\n",
    ]


def words(draw: st.DrawFn) -> bytes:
    return draw(st.sampled_from(_WORDS)).encode()


def place(draw: st.DrawFn, items: bytes | list[bytes]) -> int:
    return draw(st.integers(0, max(len(items) - 1, 0)))


def overwrite(draw: st.DrawFn, data: bytes) -> bytes:
    at = place(draw, data)
    return data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]


def cut(draw: st.DrawFn, data: bytes) -> bytes:
    return data[: place(draw, data)]


def remove(draw: st.DrawFn, data: bytes) -> bytes:
    at = place(draw, data)
    return data[:at] + data[at + draw(st.integers(1, 30)) :]


def insert_words(draw: st.DrawFn, data: bytes) -> bytes:
    at = place(draw, data)
    return data[:at] + words(draw) * draw(st.sampled_from((1, 1, 1, 2, 50))) + data[at:]


def drop_line(draw: st.DrawFn, data: bytes) -> bytes:
    lines = data.split(b"\n")
    del lines[place(draw, lines)]
    return b"\n".join(lines)


def repeat_line(draw: st.DrawFn, data: bytes) -> bytes:
    lines = data.split(b"\n")
    lines.insert(place(draw, lines), lines[place(draw, lines)])
    return b"\n".join(lines)


def change_word(draw: st.DrawFn, data: bytes) -> bytes:
    lines = data.split(b"\n")
    at = place(draw, lines)
    line = lines[at].split(b" ")
    line[place(draw, line)] = words(draw)
    lines[at] = b" ".join(line)
    return b"\n".join(lines)


MUTATIONS: tuple[Callable[[st.DrawFn, bytes], bytes], ...] = (
    overwrite, cut, remove, insert_words, drop_line, repeat_line, change_word,
)  # fmt: skip


@st.composite
def mutated_decks(draw: st.DrawFn) -> bytes:
    """Decks with one to five mutations."""
    data = draw(st.sampled_from(SEEDS)).encode()
    for change in draw(st.lists(st.sampled_from(MUTATIONS), min_size=1, max_size=5)):
        data = change(draw, data)
    return data


SEEDS = seeds()


def make_root(folder: Path) -> Path:
    """Create a root folder with files to include and secret files outside; return the root."""
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
    """Record the real paths of files opened within the context."""
    global _watched  # noqa: PLW0603 - an audit hook cannot be taken away
    _watched = []
    try:
        yield _watched
    finally:
        _watched = None


@pytest.mark.slow
def test_mutated_decks_are_read_or_rejected(tmp_path: Path) -> None:
    root = make_root(tmp_path)
    path = root / "deck.cir"
    path.write_text(SEEDS[0])
    outcome(path, 0)  # load and compile all modules before files are recorded
    places = (root, Path(__file__).parents[3], Path(np.__file__).parents[1], sys.prefix, sys.base_prefix)
    own = tuple(os.path.realpath(place) for place in places)
    kinds: Counter[bool] = Counter()

    @settings(max_examples=COUNT)
    @given(mutated_decks())
    def check(data: bytes) -> None:
        path.write_bytes(data)
        with opened_files() as opened:
            result = outcome(path, 10**9)
            short = outcome(path, 0)
        assert same(result, short), f"reads differently the short way: {result}\n{short}"
        assert [name for name in opened if not name.startswith(own)] == []
        kinds[isinstance(result, str)] += 1

    check()
    assert min(kinds[True], kinds[False]) > COUNT // 20


def test_opened_files_records_included_files(tmp_path: Path) -> None:
    root = make_root(tmp_path)
    (root / "deck.cir").write_text("t\n.include ../outside/secret.inc\nV1 leaked 0 1\n")
    with opened_files() as opened:
        deck = rg.read_spice(root / "deck.cir", root=tmp_path)
    assert SECRET.split(maxsplit=1)[0] in deck.element_names["resistor"]
    assert str((tmp_path / "outside" / "secret.inc").resolve()) in opened
