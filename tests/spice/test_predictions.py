"""Predictions of `check_portability`, compared with runs of ngspice: errors of the predicted size, failures.

Tests internals: `resgrid.spice.run.ngspice`, `resgrid.spice.write.flat`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import random_grid

import resgrid as rg
from resgrid.spice.run.ngspice import ngspice_version, simulate
from resgrid.spice.write.flat import flatten


def deck_of(folder: Path, text: str) -> rg.spice.Circuit:
    path = folder / "deck.sp"
    path.write_text(text)
    return rg.read_spice(path)


def verdict_of(circuit: object, simulator: str = "ngspice") -> rg.spice.Prediction:
    return next(v for v in rg.spice.check_portability(circuit) if v.simulator == simulator)  # type: ignore[arg-type]


def measured_error(text: str, deck: rg.spice.Circuit) -> float:
    """Largest difference in volts between ngspice and resgrid's solution of a deck."""
    from resgrid.circuit.solve import solve

    simulation = simulate(text.encode(), direct=True)
    voltage = solve(deck.netlist()).voltage
    right = {name.lower(): value for name, value in zip(deck.node_names, voltage.tolist(), strict=True)}
    return max(abs(simulation.voltage[n] - v) for n, v in right.items() if np.isfinite(v) and n in simulation.voltage)


GRID = "".join(f"r{i} n{i} n{i + 1} 1e8\n" for i in range(20)) + "rl n20 0 1e8\n"


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("island", f"* t\nv1 n0 0 1\n{GRID}rx a b 1k\n.op\n.end\n", "2 floating nodes"),
        ("behind a capacitor", f"* t\nv1 n0 0 1\n{GRID}cx a 0 1u\n.op\n.end\n", "1 floating nodes"),
        ("more gmin", f"* t\nv1 n0 0 1\n{GRID}rx a b 1k\n.option gmin=1e-11\n.op\n.end\n", "1e-11 S"),
        (
            "gshunt counts before gmin",
            f"* t\nv1 n0 0 1\n{GRID}rx a b 1k\n.option gshunt=1n gmin=1e-10\n.op\n.end\n",
            "1e-09 S",
        ),
        ("shunt", f"* t\nv1 n0 0 1\n{GRID}.option rshunt=1e12\n.op\n.end\n", "rshunt=1e+12"),
        ("shunt with a suffix", f"* t\nv1 n0 0 1\n{GRID}.option rshunt=1t\n.op\n.end\n", "rshunt=1e+12"),
        ("short", "* t\nv1 a 0 1\nr1 a b 1\nr2 b c 0\nr3 c 0 1\n.op\n.end\n", "become 0.001 ohm"),
        ("no title", "r1 a b 1k\nv1 a 0 1\nr2 b 0 1k\nr3 a b 3k\n.op\n.end\n", "r1 is lost"),
    ],
)
def test_predicted_errors_equal_measured_errors_of_ngspice(tmp_path: Path, name: str, text: str, reason: str) -> None:
    if name == "short" and ngspice_version() != "39":
        pytest.skip("newer versions make 1e-12 ohm of it, and are wrong by rounding")
    deck = deck_of(tmp_path, text)
    verdict = verdict_of(deck)
    assert verdict.outcome == "wrong" and verdict.basis == "measured", name
    assert any(reason in why for why in verdict.reasons), verdict.reasons
    error = measured_error(text, deck)
    assert error > 1e-5
    assert verdict.max_error == pytest.approx(error, rel=1e-3)


def test_an_island_has_a_large_predicted_error_at_100_megohm(tmp_path: Path) -> None:
    chain = "".join(f"r{i} n{i} n{i + 1} 1e8\n" for i in range(60)) + "rl n60 0 1e8\n"
    text = f"* t\nv1 n0 0 1\n{chain}rx a b 1k\n.op\n.end\n"
    verdict = verdict_of(deck_of(tmp_path, text))
    assert verdict.max_error is not None and verdict.max_error > 0.01
    assert "wrong by 0.0" in str(verdict)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("* t\nv1 a 0 1\nv2 a 0 2\nr1 a 0 1k\n.op\n.end\n", "loop"),
        ("* t\nv1 a 0 1\nv2 a 0 1\nr1 a 0 1k\n.op\n.end\n", "loop"),
        ("* t\nv1 a 0 1\nv2 a b 1\nv3 a b 1\nr1 b 0 1k\n.op\n.end\n", "loop"),
        ("* t\nv1 a 0 1\nv2 b b 0\nr1 a b 1k\nr2 b 0 1k\n.op\n.end\n", "loop"),
    ],
)
def test_decks_predicted_to_fail_have_no_results_in_ngspice(tmp_path: Path, text: str, reason: str) -> None:
    verdict = verdict_of(deck_of(tmp_path, text))
    assert verdict.outcome == "fails" and reason in verdict.reasons[0]
    assert not simulate(text.encode(), direct=True).voltage


DIVIDER = "* t\nv1 in 0 10\nr0 in a 1k\n"


def test_a_loop_of_sources_away_from_ground_is_predicted_as_unsure(tmp_path: Path) -> None:
    text = f"{DIVIDER}v2 a b 1\nv3 a b 1\nr1 b 0 1k\n.op\n.end\n"
    deck = deck_of(tmp_path, text)
    assert verdict_of(deck).outcome == "unsure" and verdict_of(deck, "xyce").outcome == "fails"
    assert simulate(text.encode(), direct=True).voltage


@pytest.mark.filterwarnings("ignore:.* form loops")
@pytest.mark.parametrize("henries", ["1", "1u"])
def test_a_loop_of_inductors_is_predicted_as_unsure(tmp_path: Path, henries: str) -> None:
    text = f"{DIVIDER}l1 a b {henries}\nl2 a b {henries}\nr1 b 0 1k\n.op\n.end\n"
    deck = deck_of(tmp_path, text)
    verdict = verdict_of(deck)
    assert verdict.outcome == "unsure" and "loop of inductors" in verdict.reasons[0]
    assert verdict_of(deck, "spectre").outcome == "unsure"
    assert measured_error(text, deck) > 1e-6
    apart = deck_of(tmp_path, f"{DIVIDER}l1 a b 1\nl2 b c 1\nr1 c 0 1k\n.op\n.end\n")
    assert verdict_of(apart).outcome == "right"


@pytest.mark.parametrize(
    ("wires", "drowned"),
    [
        ("r1 a b 1e-9\nr2 b 0 5\n", True),
        ("r1 a b 1e-9\nr2 b c 1e-9\nr3 c d 1e-9\nr4 d 0 5\n", True),
        ("r1 a b 1e-2\nr2 b 0 5\n", False),
        ("r1 in b 1e-9\nr2 b 0 5\nr3 a 0 1\n", False),  # held by a source
        ("r1 a b 1e10\nr2 a 0 5\nr3 b 0 1k\n", False),  # a weak resistor without effect
    ],
)
def test_a_resistor_that_dominates_by_rounding_is_predicted_as_unsure(
    tmp_path: Path, wires: str, drowned: bool
) -> None:
    text = f"{DIVIDER}{wires}.op\n.end\n"
    deck = deck_of(tmp_path, text)
    assert (verdict_of(deck).outcome == "unsure") == drowned, verdict_of(deck)
    assert (measured_error(text, deck) > 1e-8) == drowned


LADDER = b"* t\nV1 in 0 1\nR1 in a 1k\nR2 a 0 1k\n%s.op\n.end\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (LADDER % b'R3 a "b c" 1k\nR4 "b c" 0 1k\n', "cuts the quoted name"),
        (LADDER % b"R3 a n\xe4 1k\nR4 n\xe4 0 1k\n", "not UTF-8"),
        (LADDER % b".backanno\n", "has no command .backanno"),
        (LADDER % b".step param x 1 2 1\n", "has no command .step"),
        (LADDER % b".param p=1, q=2\n", "a comma directly after a value"),
        ((LADDER % b"").decode().encode("utf-16"), "does not read UTF-16"),
        ((LADDER % b"").replace(b"\n", b"\r"), "carriage returns alone"),
        (LADDER % b"r1 a 0 1k\n", "a name is given twice"),
    ],
)
@pytest.mark.quick_cases(4)
def test_files_that_ngspice_does_not_run_are_predicted_to_fail(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "deck.cir"
    path.write_bytes(content)
    for dialect in ("ngspice", "ltspice"):  # the prediction depends on the file, not on the read circuit
        verdict = verdict_of(rg.read_spice(path, dialect=dialect))
        assert verdict.outcome == "fails" and reason in " ".join(verdict.reasons), verdict
    try:
        assert not simulate(content, direct=True, timeout=1.0 if "comma" in reason else 60.0).voltage
    except rg.BudgetError:
        assert "comma" in reason  # ngspice does not terminate


CALL = "* t\n.func f(x) {{x+1}}\n{}\nv1 a 0 1\nr1 a b {{{}}}\nr2 b 0 1\n.op\n.end\n"
CALLS = {
    "and": ("", "(2>1)&&f(1)", "&&"),
    "and, with a blank": ("", "(2>1) && F(1)", "&&"),
    "not": ("", "1+!f(1)", "!"),
    "choice": ("", "1?f(1):2", "?"),
    "remainder": ("", "3%f(1)", "%"),
    "an argument": ("", "f(1&&f(1))", "&&"),
    "a function": (".func g(x) {1&&f(x)}", "g(1)", "&&"),
    "an unused parameter": (".param p={1&&f(1)}", "2", "&&"),
    "a function of a subcircuit": (".subckt s p q\n.func g(x) {x}\nr1 p q {1&&g(1)}\n.ends\nx1 a b s", "2", "&&"),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.quick_cases(4)
def test_calls_that_ngspice_does_not_recognise_are_predicted_to_fail(tmp_path: Path, name: str) -> None:
    more, expression, operator = CALLS[name]
    text = CALL.format(more, expression)
    deck = deck_of(tmp_path, text)
    warnings = [note.text for note in deck.notes if note.severity == "warning"]
    assert any(f"directly after '{operator}', and stops: write (" in warning for warning in warnings), warnings
    assert verdict_of(deck).outcome == "fails" and verdict_of(deck, "ltspice").outcome == "right"
    assert not simulate(text.encode(), direct=True).voltage


@pytest.mark.parametrize(
    "extra", [b"* \xe4\n", b"R3 a 0 1k ; \xe4\n", b"R\xb53 a 0 1k\n", b'R3 "b" 0 1k\nR4 "b" a 1k\n']
)
def test_files_with_harmless_oddities_are_predicted_as_right(tmp_path: Path, extra: bytes) -> None:
    path = tmp_path / "deck.cir"
    path.write_bytes(LADDER % extra)
    assert verdict_of(rg.read_spice(path)).outcome == "right"
    assert simulate(LADDER % extra, direct=True).voltage


def test_predictions_follow_the_rules_of_every_simulator(tmp_path: Path) -> None:
    deck = deck_of(tmp_path, "* t\nv1 in 0 1\nr1 in a '20*temper'\nr2 a gnd 1k\n.op\n.end\n")
    assert verdict_of(deck).outcome == "right"
    assert verdict_of(deck, "hspice").outcome == "wrong"  # 25 degrees there
    assert verdict_of(deck, "ltspice").outcome == "unsure" and "temper" in verdict_of(deck, "ltspice").reasons[0]
    assert "is not ground" not in str(verdict_of(deck, "ltspice"))
    changed = deck_of(tmp_path, "* t\nv1 in 0 1\nr1 in a 1k\nr2 a 0 1k\n.control\nalter r2 3k\nop\n.endc\n.end\n")
    assert verdict_of(changed).outcome == "unsure" and "alter" in verdict_of(changed).reasons[0]


@pytest.mark.parametrize("simulator", ["ngspice", "hspice", "spectre", "ltspice", "xyce"])
def test_no_simulator_is_predicted_right_without_an_operating_point(tmp_path: Path, simulator: str) -> None:
    deck = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a 0 1k\ni1 0 b 1u\nr2 b c 1k\n.op\n.end\n")
    assert verdict_of(deck, simulator).outcome in ("wrong", "unsure")
    assert "no operating point exists" in str(verdict_of(deck, simulator))


@pytest.mark.parametrize(
    ("parts", "outcome"),
    [
        ("rx a b 1k\n", "wrong"),  # 1k times its reciprocal is 1
        ("rx a b 93\n", "right"),  # 93 times its reciprocal is not, and the last pivot is not zero
        ("rx a b 93\ncx c n1 1u\n", "wrong"),
        ("rx a b 93\nry b c 93\n", "unsure"),
    ],
)
def test_rounding_determines_the_error_of_floating_nodes(tmp_path: Path, parts: str, outcome: str) -> None:
    text = f"* t\nv1 n0 0 1\n{GRID}{parts}.op\n.end\n"
    deck = deck_of(tmp_path, text)
    assert verdict_of(deck).outcome == outcome
    if outcome != "unsure":
        assert (measured_error(text, deck) > 1e-9) == (outcome == "wrong")


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_decks_predicted_right_have_the_results_of_ngspice(seed: int) -> None:
    netlist = random_grid(seed, side=4)
    assert verdict_of(netlist).outcome == "right"
    import io

    text = flatten(netlist).text
    deck = rg.read_spice(io.StringIO(text))
    assert verdict_of(deck).outcome == "right"
    assert measured_error(text.replace(".end", ".op\n.end"), deck) < 1e-9


def test_predictions_for_other_simulators_follow_their_manuals(tmp_path: Path) -> None:
    deck = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a b 1e-6\nr2 b 0 1e-6\nr3 c d 1k\n.op\n.end\n")
    assert verdict_of(deck, "hspice").outcome == "right"  # both are raised alike, and the floating part is separate
    assert verdict_of(deck, "xyce").outcome == "unsure"
    assert verdict_of(deck, "spectre").outcome == "right"
    assert all(v.basis == "documented" for v in rg.spice.check_portability(deck) if v.simulator != "ngspice")
    raised = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a b 1e-6\nr2 b 0 1\n.op\n.end\n")
    assert verdict_of(raised, "hspice").max_error == pytest.approx(9e-6, rel=1e-3)
    assert verdict_of(raised).outcome == "right"


def test_unsolvable_decks_have_a_prediction(tmp_path: Path) -> None:
    deck = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a b -1k\nr2 b 0 3k\n.op\n.end\n")
    assert verdict_of(deck).outcome == "unsure"
    trapped = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a 0 1k\ni1 0 b 1u\nr2 b c 1k\n.op\n.end\n")
    assert verdict_of(trapped).outcome == "wrong" and verdict_of(trapped).max_error is None
    spread = deck_of(tmp_path, "* t\nv1 a 0 1\nr1 a b 1e-3\nr2 b 0 1e12\n.op\n.end\n")
    assert verdict_of(spread).outcome == "unsure" and "orders of magnitude" in verdict_of(spread).reasons[0]
