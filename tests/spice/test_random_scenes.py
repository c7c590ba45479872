"""ngspice agrees on random scenes: one to four dimensions, every boundary, rings, cost maps."""

from hypothesis import HealthCheck, assume, given, settings, strategies as st
from support.spaces import spaces

import resgrid as rg

BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 1e5}]


@settings(max_examples=30, suppress_health_check=[HealthCheck.filter_too_much])
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_ngspice_agrees(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    try:
        netlist = rg.compile_space(space, **options)
        point = rg.solve(netlist)
    except rg.CircuitError:
        assume(False)
    if options.get("boundary") == "neumann":
        netlist = rg.scale_drive(netlist, point)
        point = rg.solve(netlist)
    agreement = rg.check_deck(point)
    assert agreement.agrees, agreement.findings
    assert agreement.max_relative_error < 1e-9
