"""The public interface of `resgrid`: typical tasks of users, names, and short representations."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.cli import ROOM

import resgrid as rg

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a turned ROS map, a deck of another program, a scene with a hidden obstacle, and a chip."""
    from PIL import Image

    monkeypatch.chdir(tmp_path)
    rows = np.full((24, 30), 254, np.uint8)
    rows[6:16, 13:16] = 0
    Image.fromarray(rows).save("map.pgm")
    keys = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    Path("map.yaml").write_text(f"image: map.pgm\nresolution: 0.5\norigin: [-6.0, -7.0, 0.3]\n{keys}")
    Path("theirs.sp").write_text("divider\nv1 a 0 1.8\nr1 a b 1k\nr2 b 0 2k\n.tran 1u 1m\n.end\n")
    hidden = '[[hidden]]\nshape = "rectangle"\nlower = [1.5, 2.5]\nupper = [2.5, 3.5]\n'
    Path("room.toml").write_text(ROOM.replace(", [5.5, 4.5]", "") + hidden)
    Path("chip.toml").write_text(Path("room.toml").read_text() + "[chip]\ncapacitance = 1e-12\nmismatch = 0.02\n")
    return tmp_path


def test_a_path_is_planned_on_a_ros_map_and_saved(desk: Path) -> None:
    scene = rg.read_scene("map.yaml", goal=(5, 0))
    path = rg.plan(scene).path((-5, -4))
    rg.save(path, "path.yaml")
    rg.draw(path)
    assert path.outcome is rg.Outcome.REACHED and path.field.space.frame.yaw == 0.3
    assert rg.maps.to_ros_path(path) == Path("path.yaml").read_text()
    np.testing.assert_allclose(path.points[0], (-5, -4))


def test_a_chip_is_written_as_a_deck_and_checked(desk: Path) -> None:
    space = rg.build_space(rg.read_scene("map.yaml", goal=(5, 0)))
    netlist = rg.compile_space(space, boundary="neumann")
    op = rg.solve(netlist)
    rg.write_spice(op, "chip.cir")
    agreement = rg.check_deck("chip.cir")
    assert agreement.agrees
    assert netlist.cells.space is space


def test_a_deck_of_another_program_is_read_checked_and_solved(desk: Path) -> None:
    deck = rg.read_spice("theirs.sp")
    assert deck.notes[0].severity == "info"
    assert {violation.severity for violation in rg.check_erc(deck)} <= {"info", "warning"}
    assert {verdict.simulator for verdict in rg.spice.check_portability(deck)} >= {"ngspice"}
    op = rg.solve(deck)
    drop, balance = rg.spice.ir_drop(op), rg.spice.power_balance(op)
    assert drop.drop.max() == pytest.approx(0.6) and balance.delivered == pytest.approx(1.8**2 / 3000)


def test_a_study_evaluates_a_chip(desk: Path) -> None:
    study = rg.study(rg.read_scene("chip.toml"))
    found = study.settling(), study.noise(), study.sensitivity(), study.yields(trials=64)
    for result in found:
        assert all(figure.definition for figure in result.figures.values())
    assert 0 <= found[-1].overall.low <= found[-1].overall.value <= found[-1].overall.high <= 1
    assert study.faults(seconds=1.0).examined > 0


def test_a_simulated_robot_arrives_after_learning(desk: Path) -> None:
    scene = rg.read_scene("room.toml")
    sim = rg.simulation(scene, k=0.98)
    run = sim.run()
    rg.draw(run)
    assert run.ending is rg.control.TerminationReason.ARRIVED and rg.control.ControlMode.LEARNING in run.mode
    front = rg.control.wavefront(rg.simulation(scene, k=0.98, announce=True, settle="sor"), np.linspace(0.0, 2.0, 3))
    assert len(front.potential) == 3
    turned = rg.control.equipotential_velocity((1.0, 0.0), (0.0, 1.0))
    assert np.hypot(*turned) == pytest.approx(1.0)


def test_streamlines_basins_and_random_walks_use_one_field(desk: Path) -> None:
    field = rg.plan(rg.read_scene("room.toml")).field
    path = rg.streamline(field, (0.5, 0.5))
    short = rg.shortcut(path)
    timed = rg.time_parameterize(short, velocity_limits=1.0)
    assert short.length <= path.length and timed.times[-1] > 0
    ends = rg.streamlines(field, [(0.5, 0.5), (2.5, 4.5)])
    assert set(ends.goal) == {0}
    assert rg.basins(field)[0, 0] == 0
    netlist = rg.compile_space(field.space)
    walk = rg.planning.random_walk(netlist)
    chances = rg.planning.hitting_probability(walk), rg.planning.collision_probability(walk)
    assert all(chance is not None for chance in chances)


def test_a_transient_of_an_rc_circuit_has_its_closed_form(desk: Path) -> None:
    netlist = rg.Netlist(
        2, [[0, 1]], [1e-3], current_nodes=[[0, 1]], current_amps=[1e-3], capacitor_nodes=[[1, 0]], capacitance=[1e-9]
    )
    motion = rg.circuit.transient(netlist, np.linspace(0.0, 1e-5, 11), initial=np.zeros(2))
    assert motion.voltage[-1, 1] == pytest.approx(1 - np.exp(-10), rel=1e-4)
    assert rg.circuit.transient_stepper(netlist, 1e-7).start(np.zeros(2))[1] == 0.0
    assert rg.factorize(netlist).solve([1e-3]) == pytest.approx(1.0)


def test_scenario_files_and_engineering_notation_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.scen").write_text("version 1\n0\ta.map\t4\t2\t0\t0\t1\t1\t1.4\n")
    (query,) = rg.maps.read_movingai_scenarios(tmp_path / "a.scen")
    assert query.goal == (1, 0)
    assert rg.Chip(resistance="4k7").resistance == 4700.0
    assert issubclass(rg.CertificateError, rg.ResgridError) and issubclass(rg.ToolMissingError, rg.ResgridError)


def test_every_public_name_is_used_in_an_example_a_page_or_a_test() -> None:
    patterns = ("examples/**/*.py", "README.md", "docs/**/*.md", "docs/**/*.rst", "tests/**/*.py")
    text = "\n".join(file.read_text() for pattern in patterns for file in sorted(PROJECT.glob(pattern)))
    used = set(re.findall(r"\brg\.(\w+)", text))
    assert set(rg.__all__) - {"__version__"} - used == set()
    assert len(rg.__all__) <= 90
    assert re.fullmatch(r"\d+\.\d+.*", rg.__version__)


def test_an_unknown_name_raises_attribute_error_with_a_suggestion() -> None:
    with pytest.raises(AttributeError) as caught:
        rg.write_spic  # noqa: B018
    assert "did you mean 'write_spice'" in str(caught.value) and len(str(caught.value)) < 200
    with pytest.raises(AttributeError, match=r"dir\(resgrid\) lists its names"):
        rg.xyzzy  # noqa: B018


def test_representations_are_one_short_line() -> None:
    """Only values that differ from the defaults appear; long lists are replaced by their length."""
    assert (
        repr(rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))) == "Chip(mismatch=0.02, readout=Readout(bits=8))"
    )
    assert repr(rg.control.Control()) == "Control()"
    assert repr(rg.chip.Defects(open_at=((4, 2, 0),))) == "Defects(open_at=((4, 2, 0),))"
    round_ = tuple((float(np.cos(turn)), float(np.sin(turn))) for turn in np.linspace(0, 6, 300))
    assert repr(rg.Polygon(round_)) == "Polygon(vertices=<300 entries>)"
    ladder = rg.Netlist(
        3, [[1, 0], [1, 2], [2, 0]], [1e-3] * 3, capacitor_nodes=[[1, 0]], capacitance=[1e-9],
        current_nodes=[[0, 1]], current_amps=[1e-3],
    )  # fmt: skip
    assert repr(rg.factorize(ladder)) == f"<CircuitFactor of {ladder!r}: 2 rows, direct>"
    assert repr(rg.circuit.transient_stepper(ladder, 1e-6)).endswith(": steps of 1e-06 s, tr-bdf2>")
    assert repr(rg.PolygonRobot(round_[:3])).startswith("PolygonRobot(vertices=((1.0, 0.0), ")
