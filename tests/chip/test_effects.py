"""Effects of a chip, each against its formula evaluated by hand, and properties that all effects have.

Tests internals: `resgrid.chip`, `resgrid.chip.effects.base`, `resgrid.chip.effects.values`, `resgrid.core.netlist`.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import dense_solution
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.chip import effects
from resgrid.chip.effects.base import to_node
from resgrid.chip.effects.values import preferred_values
from resgrid.core.netlist import add_elements


def small_netlist(boundary: str = "dirichlet", **options: object) -> rg.Netlist:
    cell = np.zeros((8, 10), dtype=np.uint8)
    cell[2:5, 6], cell[6, 1], cell[0, 9] = rg.Cell.OBSTACLE, rg.Cell.GOAL, rg.Cell.GOAL
    return rg.compile_space(space_of(cell), boundary=boundary, rails="cells", **options)


ALL = (
    effects.PreferredValues("E24"),
    effects.SheetResistors(200.0, 1e-6),
    effects.ResistanceGradient((0.1, -0.2)),
    effects.Mismatch(0.1, seed=3),
    effects.TemperatureCoefficients(1e-3, 1e-6),
    effects.Temperature(85.0),
    effects.InternodalSwitches(100.0, 1e9),
    effects.Saturation(0.3),
    effects.Faults(0.02, 0.02, 1.0, (5, 1), ((3, 2, 1),)),
    effects.RailSwitches(100.0, 1e9, 50.0, 1e9),
    effects.RailResistance(0.1),
    effects.Capacitance(1e-12),
    effects.ReadoutLoad(1e8),
)


def equal_arrays(a: rg.Netlist, b: rg.Netlist) -> bool:
    return all(
        np.array_equal(getattr(a, item.name), getattr(b, item.name))
        for item in dataclasses.fields(rg.Netlist)
        if isinstance(getattr(a, item.name), np.ndarray)
    )


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: type(effect).__name__)
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_every_effect_is_pure_and_keeps_a_field_that_reaches_the_goal(effect: effects.Effect, boundary: str) -> None:
    netlist = small_netlist(boundary)
    before = dataclasses.replace(netlist)
    once, again = effect.apply(netlist), effect.apply(netlist)
    assert equal_arrays(once, again)
    assert equal_arrays(netlist, before)
    cell_map = once.cells
    assert len(cell_map.resistor_face) == len(cell_map.resistor_upward) == len(once.conductance)
    assert len(cell_map.nonlinear_face) == len(cell_map.nonlinear_upward) == len(once.nonlinear_current)
    field = rg.field(rg.solve(once))
    for cell in np.argwhere(field.space.goal_connected):
        path = rg.streamline(field, cell=cell)
        rg.certify(path)
        assert path.outcome == "reached"


def test_a_list_of_effects_survives_a_json_round_trip() -> None:
    assert {type(effect) for effect in ALL} == set(effects.EFFECTS.values())
    text = json.dumps(effects.to_json(ALL), allow_nan=False)
    assert effects.from_json(json.loads(text)) == ALL
    assert equal_arrays(
        rg.chip.build_chip(small_netlist(), effects.from_json(json.loads(text))),
        rg.chip.build_chip(small_netlist(), ALL),
    )


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"pass": "mismach", "sigma": 0.1}, "effect 0: 'mismach' is unknown; did you mean 'mismatch'"),
        ({"sigma": 0.1}, "effect 0: None is unknown; there are"),
        ("mismatch", "effect 0 = 'mismatch' must be a table, such as"),
        ({"pass": "mismatch", "sigmaa": 0.1}, "'sigmaa' is unknown; did you mean 'sigma'"),
        ({"pass": "mismatch", "sigma": "x"}, "sigma: 'x' is not a number"),
        ({"pass": "mismatch", "sigma": 3.0}, "sigma: must be below 1, got 3"),
        ({"pass": "mismatch", "sigma": 0.1, "pelgrom": 1.0}, "either sigma or pelgrom"),
        ({"pass": "mismatch", "pelgrom": 1.0}, "pelgrom needs width"),
        ({"pass": "mismatch", "sigma": 0.1, "seed": -3}, "seed = -3 must be a whole number"),
        ({"pass": "temperature"}, "celsius: this key is missing"),
        ({"pass": "gradient", "shares": [0.1, float("nan")]}, r"shares\[1\]: nan is not a number"),
        ({"pass": "faults", "open_density": 0.7, "short_density": 0.7}, "with a sum of at most 1"),
        ({"pass": "faults", "short_resistance": 0.0}, "short_resistance: must be greater than 0"),
    ],
)
def test_invalid_effect_entries_raise_input_error(entry: object, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        effects.from_json([entry])


def test_effects_on_cells_require_rails_cells_and_a_compiled_space() -> None:
    merged = rg.compile_space(small_netlist().cells.space)
    for effect in (
        effects.RailSwitches(1.0),
        effects.RailResistance(1.0),
        effects.InternodalSwitches(1.0),
        effects.Capacitance(1.0),
        effects.ReadoutLoad(1.0),
    ):
        with pytest.raises(rg.InputError, match="compile with rails = 'cells'"):
            effect.apply(merged)
    bare = rg.Netlist(2, [[1, 0]], [1.0])
    with pytest.raises(rg.InputError, match="was not compiled from a space"):
        effects.ResistanceGradient((0.1,)).apply(bare)
    assert effects.Mismatch(0.1).apply(bare).conductance[0] != 1.0


def test_series_of_preferred_values_equal_the_standard() -> None:
    assert preferred_values("E6").tolist() == [1.0, 1.5, 2.2, 3.3, 4.7, 6.8]
    assert preferred_values("E12").tolist() == [1.0, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2]
    assert preferred_values("E48")[[1, 20, 47]].tolist() == [1.05, 2.61, 9.53]
    assert preferred_values("E96")[[1, 50, 95]].tolist() == [1.02, 3.32, 9.76]
    e192 = preferred_values("E192")
    assert (len(e192), e192[1], e192[185], e192[191]) == (192, 1.01, 9.2, 9.88)


@given(exponent=st.floats(-3, 9), series=st.sampled_from(["E6", "E12", "E24", "E48", "E96", "E192"]))
@settings(max_examples=60)
def test_preferred_values_are_the_nearest_by_ratio(exponent: float, series: str) -> None:
    wanted = 10.0**exponent
    drawn = 1 / effects.PreferredValues(series).apply(rg.Netlist(2, [[1, 0]], [1 / wanted])).conductance[0]
    every = np.concatenate([preferred_values(series) * 10.0**k for k in range(-5, 12)])
    assert np.isclose(drawn, every, rtol=1e-12).any()
    assert abs(np.log(drawn / wanted)) <= np.abs(np.log(every / wanted)).min() + 1e-12


def test_sheet_resistor_lengths_are_multiples_of_the_drawing_grid() -> None:
    strip = effects.SheetResistors(sheet_resistance=300.0, width=2e-6, drawing_grid=1e-7)
    netlist = strip.apply(small_netlist(resistance=1234.0))
    length = 1234.0 * 2e-6 / 300.0
    steps = round(length / 1e-7)
    np.testing.assert_allclose(1 / netlist.conductance, 300.0 * steps * 1e-7 / 2e-6, rtol=1e-12)
    assert strip.area(netlist) == pytest.approx(len(netlist.conductance) * 2e-6 * steps * 1e-7)
    with pytest.raises(rg.InputError, match="shorter than the drawing step"):
        effects.SheetResistors(1e6, 1e-6, 1e-6).apply(small_netlist(resistance=1.0))


def test_a_gradient_is_linear_and_zero_at_the_centre() -> None:
    netlist, graded = small_netlist(), effects.ResistanceGradient((0.1, -0.2)).apply(small_netlist())
    cell = netlist.cell_of_node()
    both = (cell[netlist.resistor_nodes] >= 0).all(axis=1)
    x, y = np.unravel_index(cell[netlist.resistor_nodes[both]], (8, 10))
    place = np.array([(x.mean(axis=1) + 0.5) / 8, (y.mean(axis=1) + 0.5) / 10])
    ratio = netlist.conductance[both] / graded.conductance[both]
    np.testing.assert_allclose(ratio, 1 + 0.1 * (place[0] - 0.5) - 0.2 * (place[1] - 0.5), rtol=1e-12)
    for shares, message in (((0.1,) * 3, "3 entries, but the space has 2 axes"), ((1.5, 0.6), "negative in a corner")):
        with pytest.raises(rg.InputError, match=message):
            effects.ResistanceGradient(shares).apply(small_netlist())


def test_mismatch_has_mean_one_and_the_requested_standard_deviation() -> None:
    netlist = rg.compile_space(space_of(np.pad([[2]], 90)))
    for sigma in (0.02, 0.5):
        ratio = netlist.conductance / effects.Mismatch(sigma, seed=1).apply(netlist).conductance
        error = sigma / np.sqrt(len(ratio))
        assert abs(ratio.mean() - 1) < 4 * error
        assert ratio.std() == pytest.approx(sigma, rel=0.05)
        assert ratio.min() > 0


def test_pelgrom_mismatch_falls_with_the_square_root_of_the_area() -> None:
    netlist = small_netlist()
    assert effects.Mismatch(pelgrom=3.0, width=1e-6, length=9e-6).deviation(netlist) == pytest.approx(0.01)
    drawn = effects.Mismatch(pelgrom=3.0, width=1e-6, sheet_resistance=10e3 / 9).deviation(netlist)
    assert drawn[netlist.cells.resistor_face] == pytest.approx(0.01)


def test_a_seed_draws_the_same_chip_in_every_order_of_effects_and_for_every_scene() -> None:
    chain = [
        effects.Mismatch(0.1, seed=9),
        effects.Faults(0.1, 0.1, 1.0, 9),
        effects.RailSwitches(10.0, 1e9, 10.0, 1e9),
        effects.RailResistance(1.0),
    ]

    def at_faces(netlist: rg.Netlist) -> dict[int, float]:
        face = netlist.cells.resistor_face
        return dict(zip(face[face >= 0].tolist(), netlist.conductance[face >= 0].round(18).tolist(), strict=True))

    forward = at_faces(rg.chip.build_chip(small_netlist(), chain))
    late = at_faces(rg.chip.build_chip(small_netlist(), [chain[2], chain[3], chain[0], chain[1]]))
    assert forward == late
    elsewhere = np.zeros((8, 10), dtype=np.uint8)
    elsewhere[5, 5] = rg.Cell.GOAL
    other = at_faces(rg.chip.build_chip(rg.compile_space(space_of(elsewhere), rails="cells"), chain))
    common = forward.keys() & other.keys()
    assert len(common) > 100
    assert {face: forward[face] for face in common} == {face: other[face] for face in common}
    assert forward != at_faces(rg.chip.build_chip(small_netlist(), [effects.Mismatch(0.1, seed=10), *chain[1:]]))


def test_saturating_resistors_have_the_mismatch_of_linear_ones() -> None:
    linear = effects.Mismatch(0.1, seed=4).apply(small_netlist())
    saturating = effects.Mismatch(0.1, seed=4).apply(effects.Saturation(0.2).apply(small_netlist()))
    np.testing.assert_allclose(saturating.nonlinear_current / 0.2, linear.conductance, rtol=1e-13)


def test_temperature_applies_the_linear_and_quadratic_coefficients() -> None:
    hot = effects.Temperature(77.0).apply(effects.TemperatureCoefficients(2e-3, 1e-5).apply(small_netlist()))
    np.testing.assert_allclose(1 / hot.conductance, 10e3 * (1 + 0.1 + 0.025), rtol=1e-12)
    assert hot.tc1 is None
    with pytest.raises(rg.InputError, match="multiply a resistance by -1"):
        effects.Temperature(127.0).apply(effects.TemperatureCoefficients(-0.02).apply(small_netlist()))


def test_internodal_switches_do_not_change_the_heating_of_their_resistors() -> None:
    warm = [effects.TemperatureCoefficients(2e-3, 1e-5), effects.Temperature(77.0)]
    before = rg.chip.build_chip(small_netlist(), [*warm, effects.InternodalSwitches(500.0)])
    after = rg.chip.build_chip(small_netlist(), [warm[0], effects.InternodalSwitches(500.0), warm[1]])
    np.testing.assert_allclose(before.conductance, after.conductance, rtol=1e-13)
    inner = (small_netlist().cell_of_node()[small_netlist().resistor_nodes] >= 0).all(axis=1)
    np.testing.assert_allclose(1 / before.conductance[inner], 11250 + 500)
    np.testing.assert_allclose(1 / before.conductance[~inner], 11250)


def test_open_internodal_switches_leak_into_obstacles() -> None:
    ideal = small_netlist("neumann")
    leaky = effects.InternodalSwitches(None, 1e7).apply(ideal)
    assert np.all(leaky.cells.node >= 0)
    inside = rg.solve(leaky).voltage[leaky.cells.node[3, 6]]
    around = rg.solve(leaky).voltage[leaky.cells.node[[3, 3], [5, 7]]]
    assert around.min() < inside < around.max()
    worse = effects.InternodalSwitches(None, 1e4).apply(ideal)
    apart = [np.abs(rg.solve(n).voltage[: ideal.node_count] - rg.solve(ideal).voltage).max() for n in (leaky, worse)]
    assert 0 < 100 * apart[0] < apart[1]


def test_rail_switches_are_closed_at_cells_of_their_kind_and_open_elsewhere() -> None:
    netlist = effects.RailSwitches(100.0, 1e9, 50.0, 1e8).apply(small_netlist())
    cell_map, extra = netlist.cell_map, netlist.cell_map.resistor_face < 0
    pin = {cell_map.obstacle_node: (rg.Cell.OBSTACLE, 100.0, 1e9), cell_map.goal_nodes[0]: (rg.Cell.GOAL, 50.0, 1e8)}
    cell = netlist.cell_of_node()
    seen = set()
    for (a, b), g in zip(netlist.resistor_nodes[extra].tolist(), netlist.conductance[extra].tolist(), strict=True):
        kind, on, off = pin[b]
        assert 1 / g == pytest.approx(on if cell_map.space.cell.flat[cell[a]] == kind else off)
        seen.add((a, b))
    assert len(seen) == 2 * 80
    assert len(netlist.source_volts) == 2
    only_on = effects.RailSwitches(100.0).apply(small_netlist())
    assert (only_on.cells.resistor_face < 0).sum() == 3


@pytest.mark.parametrize("options", [{}, {"drive": "start", "start": (0, 0)}])
def test_insulating_obstacles_keep_the_rail_switches_of_their_cells(options: dict[str, object]) -> None:
    netlist = effects.RailSwitches(100.0, 1e8, 50.0, 1e8).apply(small_netlist("neumann", **options))
    driven = "start" in options
    cell_map, extra = netlist.cells, netlist.cells.resistor_face < 0
    assert np.bincount(np.rint(1 / netlist.conductance[extra]).astype(int) // 10).nonzero()[0].size == 2 + driven
    volts = dict(zip(netlist.source_nodes[:, 0].tolist(), netlist.source_volts.tolist(), strict=True))
    assert sorted(volts.values()) == ([0.0, 1.0] if driven else [0.0, 0.0])
    sources = netlist.source_nodes[:, 0]
    assert not np.isin(sources, cell_map.node).any()
    point = rg.solve(netlist)
    if driven:
        assert 0.9 < point.voltage[cell_map.node[0, 0]] < 1
    assert rg.streamline(rg.field(point), cell=(0, 0)).outcome == "reached"


@given(space=spaces(max_cells=5), boundary=st.sampled_from(["dirichlet", "neumann", "wall"]), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_chips_on_random_spaces_agree_with_a_dense_solution(
    space: rg.ConfigurationSpace, boundary: str, seed: int
) -> None:
    chip = rg.Chip(
        mismatch=0.2, gradient=(0.2,), temperature=60.0, tc1=1e-3, internodal_switch_on=200.0,
        internodal_switch_off=1e7,
        obstacle_switch_on=100.0, obstacle_switch_off=1e8, goal_switch_on=50.0, goal_switch_off=1e8,
        rail_resistance=2.0, readout=rg.chip.Readout(input_resistance=1e8), wall_resistance=1e3, seed=seed,
    )  # fmt: skip
    edge = ["periodic" if ring else "obstacle" for ring in space.periodic]
    try:
        netlist = rg.study(space, chip, boundary=boundary, edge=edge).netlist
        point = rg.solve(netlist)
    except rg.CircuitError:
        return
    assert not point.floating.size
    exact = dense_solution(netlist)
    span = max(np.abs(exact.voltage).max(), 1e-6)
    np.testing.assert_allclose(point.voltage, exact.voltage, atol=1e-8 * span)


def test_switches_and_rails_with_vanishing_resistance_equal_the_ideal_chip() -> None:
    for boundary in ("dirichlet", "neumann", "wall"):
        options = {"wall_resistance": 3e3} if boundary == "wall" else {}
        ideal = small_netlist(boundary, **options)
        real = rg.chip.build_chip(
            ideal,
            [
                effects.InternodalSwitches(1e-4, 1e16),
                effects.RailSwitches(1e-4, 1e16, 1e-4, 1e16),
                effects.RailResistance(1e-5),
            ],
        )
        there = rg.solve(real).voltage[: ideal.node_count]
        np.testing.assert_allclose(there, rg.solve(ideal).voltage, atol=1e-6)


def test_rail_resistance_lowers_the_voltages_in_the_middle_of_the_die() -> None:
    cell = np.ones((9, 9), dtype=np.uint8)
    cell[1:-1:2, :-1], cell[4, 4] = rg.Cell.FREE, rg.Cell.GOAL
    ideal = rg.compile_space(space_of(cell), rails="cells", resistance=100.0)
    netlist = effects.RailResistance(1.0).apply(ideal)
    volts = rg.solve(netlist).voltage[netlist.cells.node]
    assert volts[4, 2] < 0.999
    assert volts[cell == rg.Cell.OBSTACLE].max() < 1
    assert volts[4, 4] > 0.01
    assert effects.RailResistance(0.0).apply(ideal) is ideal


def test_a_field_that_leads_into_drooping_obstacles_raises_accuracy_error() -> None:
    cell = np.zeros((9, 9), dtype=np.uint8)
    cell[4, :8], cell[3, 0] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    ideal = rg.compile_space(space_of(cell), rails="cells", edge="open")
    for axes in ((0, 1), (1, 0)):
        turned = rg.compile_space(space_of(cell.transpose(axes)), rails="cells", edge="open")
        sagging = effects.RailSwitches(obstacle_on=1e4).apply(turned)
        with pytest.raises(rg.AccuracyError, match=r"such as \((5, 0|0, 5)\)\), so that streamlines would") as caught:
            rg.field(rg.solve(sagging))
        assert isinstance(caught.value.best, rg.Field)
    good = rg.field(rg.solve(effects.RailSwitches(obstacle_on=1e-3).apply(ideal)))
    assert rg.streamline(good, cell=(5, 0)).outcome == "reached"


def test_every_cell_has_a_capacitor_and_a_readout_load() -> None:
    netlist = effects.ReadoutLoad(1e6).apply(effects.Capacitance(2e-12).apply(small_netlist()))
    assert len(netlist.capacitance) == 80
    assert netlist.capacitance.sum() == pytest.approx(160e-12)
    loads = netlist.resistor_nodes[netlist.cells.resistor_face < 0]
    assert sorted(loads[:, 0]) == sorted(netlist.cells.node.ravel())
    assert np.all(loads[:, 1] == 0)


@given(space=spaces(max_cells=6), boundary=st.sampled_from(["dirichlet", "neumann"]), seed=st.integers(0, 99))
@settings(max_examples=25)
def test_streamlines_on_random_mismatched_spaces_are_certified_and_keep_outcomes(
    space: rg.ConfigurationSpace, boundary: str, seed: int
) -> None:
    chip = rg.Chip(mismatch=0.4, gradient=(0.5,), seed=seed)
    edge = ["periodic" if ring else "open" for ring in space.periodic]
    try:
        netlist = rg.study(space, chip, boundary=boundary, edge=edge).netlist
        ideal = rg.field(rg.solve(rg.compile_space(space, boundary=boundary, edge=edge)))
    except rg.CircuitError:
        return
    field = rg.field(rg.solve(netlist))
    for cell in np.argwhere(space.goal_connected):
        path = rg.streamline(field, cell=cell)
        rg.certify(path)
        assert path.outcome == rg.streamline(ideal, cell=cell).outcome


NO_NUMBERS = (float("nan"), float("inf"), "x", 1j, True)


@pytest.mark.parametrize(
    ("kind", "key", "values", "others"),
    [
        (effects.SheetResistors, "sheet_resistance", (0.0, -1.0, None), {"width": 1e-6}),
        (effects.SheetResistors, "width", (0.0, -1.0, None), {"sheet_resistance": 250.0}),
        (effects.SheetResistors, "drawing_grid", (0.0, -1.0, None), {"sheet_resistance": 250.0, "width": 1e-6}),
        (effects.Mismatch, "sigma", (-0.1, 1.0), {}),
        (effects.Mismatch, "pelgrom", (-5.0,), {"width": 1e-6, "length": 1e-6}),
        (effects.Mismatch, "width", (0.0, -1e-6), {"pelgrom": 1.0, "length": 1e-6}),
        (effects.Mismatch, "length", (0.0, -1e-6), {"pelgrom": 1.0, "width": 1e-6}),
        (effects.Mismatch, "sheet_resistance", (0.0, -1.0), {"pelgrom": 1.0, "width": 1e-6}),
        (effects.Mismatch, "seed", (-1, 2.5, None), {"sigma": 0.1}),
        (effects.TemperatureCoefficients, "tc1", (None,), {}),
        (effects.TemperatureCoefficients, "tc2", (None,), {}),
        (effects.Temperature, "celsius", (-273.15, -500.0, None), {}),
        (effects.Saturation, "volts", (0.0, -1.0, None), {}),
        (effects.Faults, "open_density", (-0.1, None), {}),
        (effects.Faults, "short_density", (-0.1, None), {}),
        (effects.Faults, "short_resistance", (0.0, -1.0, None), {}),
        (effects.Faults, "seed", (-1, 2.5, None), {}),
        (effects.InternodalSwitches, "on", (-9e3,), {}),
        (effects.InternodalSwitches, "off", (0.0, -1.0), {}),
        (effects.RailSwitches, "obstacle_on", (0.0, -1.0), {}),
        (effects.RailSwitches, "goal_off", (0.0, -1.0), {}),
        (effects.RailResistance, "ohms", (-1.0, None), {}),
        (effects.Capacitance, "farads", (-1.0, None), {}),
        (effects.ReadoutLoad, "ohms", (0.0, -1.0, None), {}),
        (effects.PreferredValues, "series", ("E7", 5, ["E6"]), {}),
        (effects.ResistanceGradient, "shares", (None, ("x",), (True,), (1.0, -1.0)), {}),
    ],
)
def test_invalid_effect_parameters_raise_input_error_at_construction(
    kind: type, key: str, values: tuple[object, ...], others: dict[str, object]
) -> None:
    for value in (*values, *NO_NUMBERS):
        with pytest.raises(rg.InputError, match=f"^({key}|gradient)[:= [0-9]*") as caught:
            kind(**{key: value}, **others)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("entries", [5, None, {"pass": "mismatch"}, [{"pass": ["x"]}], [{"pass": None}]], ids=str)
def test_from_json_rejects_values_that_are_not_lists_of_effects(entries: object) -> None:
    with pytest.raises(rg.InputError, match=r"effect|entries"):
        effects.from_json(entries)


def test_json_temperatures_at_or_below_absolute_zero_raise_input_error() -> None:
    with pytest.raises(rg.InputError, match=r"effect 0 \(temperature\): celsius: must be greater than -273"):
        effects.from_json([{"pass": "temperature", "celsius": -500}])


@dataclasses.dataclass(frozen=True)
class Leak(effects.Effect):
    """A user-defined effect: a leak from every cell to the substrate."""

    ohms: float

    def apply(self, netlist: rg.Netlist) -> rg.Netlist:
        nodes = netlist.cells.node[netlist.cells.node >= 0]
        return add_elements(netlist, "resistor", to_node(nodes, 0), 1 / self.ohms)


def test_a_user_defined_effect_works_in_json_netlists_decks_and_power(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(effects.EFFECTS, "leak", Leak)
    chain = [*rg.chip.effects.of_chip(rg.Chip(mismatch=0.1)), Leak(1e7)]
    again = rg.chip.effects.from_json(json.loads(json.dumps(rg.chip.effects.to_json(chain))))
    assert list(again) == chain
    netlist = rg.chip.build_chip(small_netlist(), again)
    assert (netlist.conductance == 1e-7).sum() == 80
    op = rg.solve(netlist)
    assert rg.check_deck(rg.write_spice(op, tmp_path / "leaky.cir").path).agrees
    assert op.voltage.max() <= 1.0
    assert rg.study(op).power().total == pytest.approx(op.power)
