"""Files of decks: includes, library sections, the root folder, dialects, and messages for unreadable files."""

import io
import os
from pathlib import Path

import pytest

import resgrid as rg


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "parts.inc").write_text("R1 a b {r}\n.include more.inc\n.end\n")
    (tmp_path / "lib" / "more.inc").write_text("R2 b 0 2\n")
    (tmp_path / "corners.lib").write_text(
        "* corners\nR7 stray 0 1\n"
        ".lib tt\n.param r=1\n.endl tt\n.LIB ff\n.param r=10\n.lib 'corners.lib' extra\n.endl\n"
        ".lib extra\nR3 b 0 3\n.endl\n"
    )
    return tmp_path


def write(root: Path, *lines: str) -> Path:
    path = root / "deck.cir"
    path.write_text("\n".join(["title", "V1 a 0 1", *lines]) + "\n")
    return path


def test_includes_and_library_sections_are_read(root: Path) -> None:
    deck = rg.read_spice(write(root, ".include 'lib/parts.inc'", ".lib corners.lib ff"))
    assert dict(zip(deck.element_names["resistor"], deck.resistance.tolist(), strict=True)) == {
        "R1": 10.0,
        "R2": 2.0,
        "R3": 3.0,
    }
    assert len(deck.files) == 4
    assert {Path(deck.place_of("resistor", i)).name for i in range(3)} == {
        "parts.inc:1",
        "more.inc:1",
        "corners.lib:11",
    }


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (".include nowhere.inc", "does not exist"),
        (".include ../outside.inc", "outside"),
        (".include /etc/passwd", "outside"),
        (".include " + "x" * 5000, "does not exist"),
        (".include lib", "directory"),
        (".include link.inc", "outside"),
        (".include deck.cir", "cycle"),
        (".lib corners.lib ss", "no section 'ss'"),
        (".include", "name of one file"),
        (".include lib/bad.inc", "bad.inc:2:1: D1 is a diode"),
        (".include lib/open.inc", "open.inc:1: .subckt s has no .ends"),
        (".include binary.inc", "zero byte"),
    ],
)
def test_invalid_includes_raise_input_error(root: Path, line: str, message: str) -> None:
    (root.parent / "outside.inc").write_text("R5 a 0 1\n")
    (root / "link.inc").symlink_to(root.parent / "outside.inc")
    (root / "lib" / "bad.inc").write_text("R5 a 0 1\nD1 a 0 m\n")
    (root / "lib" / "open.inc").write_text(".subckt s a\nR1 a 0 1\n")
    (root / "binary.inc").write_bytes(b"R1 a 0\x001\n")
    with pytest.raises(rg.InputError, match=r"deck\.cir|inc") as caught:
        rg.read_spice(write(root, line))
    assert message in str(caught.value)


def test_root_allows_includes_from_a_parent_folder(root: Path) -> None:
    sub = root / "sub"
    sub.mkdir()
    path = write(sub, ".include ../lib/more.inc", "R4 a b 1")
    with pytest.raises(rg.InputError, match="outside"):
        rg.read_spice(path)
    assert rg.read_spice(path, root=root).resistance.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("name", "says"), [("absent.cir", "no such file"), (".", "directory"), ("nul\0.cir", "null")])
def test_unreadable_decks_raise_input_error(root: Path, name: str, says: str) -> None:
    with pytest.raises(rg.InputError, match=says):
        rg.read_spice(os.fspath(root) + os.sep + name)


def test_unknown_dialects_and_roots_raise_input_error(root: Path) -> None:
    path = write(root, "R1 a 0 1")
    with pytest.raises(rg.InputError, match="hspice, ltspice, ngspice, spectre, xyce"):
        rg.read_spice(path, dialect="berkeley")
    with pytest.raises(rg.InputError, match="not a folder"):
        rg.read_spice(path, root=root / "absent")
    path.with_name("deck.cir.json").write_text('{"schema": 1, "dialect": "xyce"}')
    assert rg.read_spice(path).dialect == "xyce"


def test_messages_about_includes_name_the_option_and_the_keyword_of_the_root(root: Path) -> None:
    (root.parent / "out.inc").write_text("R1 a 0 1k\n")
    path = write(root, ".include ../out.inc\nV1 a 0 1")
    with pytest.raises(rg.InputError, match=r"name a folder that contains it by --root FOLDER \(in Python: root=\)"):
        rg.read_spice(path)
    assert len(rg.read_spice(path, root=root.parent).resistance) == 1
    piped = "title\n.include out.inc\nV1 a 0 1\n"
    with pytest.raises(rg.InputError, match=r"the folder of included files by --root FOLDER \(in Python: root=\)"):
        rg.read_spice(io.StringIO(piped))
    assert len(rg.read_spice(io.StringIO(piped), root=root.parent).resistance) == 1
