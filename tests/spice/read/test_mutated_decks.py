from pathlib import Path

from fuzz_decks import SECRET, furnish, fuzz, opened_files

from resgrid import read_spice


def test_mutated_decks_are_read_or_refused(tmp_path: Path) -> None:
    assert 100 < fuzz(0, 2000, tmp_path) < 1900


def test_the_watch_sees_files_that_are_opened(tmp_path: Path) -> None:
    root = furnish(tmp_path)
    (root / "deck.cir").write_text("t\n.include ../outside/secret.inc\nV1 leaked 0 1\n")
    with opened_files() as opened:
        deck = read_spice(root / "deck.cir", root=tmp_path)
    assert SECRET.split()[0] in deck.element_names["resistor"]
    assert str((tmp_path / "outside" / "secret.inc").resolve()) in opened
