from __future__ import annotations

import pytest
from support.circuits import ladder, random_grid

from resgrid.netlist import Netlist
from resgrid.spice.check.rules import check_rules

BASE = ladder(3)  # nodes 0 to 4


def with_more(**changes: object) -> Netlist:
    return BASE.replace(node_count=7, **changes)


def test_sound_circuits_pass() -> None:
    assert check_rules(ladder()) == ()
    assert check_rules(random_grid(0)) == ()


@pytest.mark.parametrize(
    ("netlist", "rule", "severity", "place"),
    [
        (with_more(), "floating", "warning", "node_5, node_6"),
        (
            with_more(current_nodes=[[0, 5]], current_amps=[1e-6]),
            "trapped current",
            "error",
            "0, node_5",
        ),
        (BASE.replace(source_nodes=[[1, 0], [0, 1]], source_volts=[1.0, -1.0]), "voltage loop", "warning", "0, node_1"),
        (BASE.replace(source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]), "voltage loop", "error", "0, node_1"),
        (BASE.replace(conductance=[1e-9, 1e-3, 1e-3, 1e9]), "value range", "warning", "node_1, node_2"),
        (BASE.replace(conductance=[1e-310, 1e-3, 1e-3, 1e-3]), "value", "error", "node_1, node_2"),
        (
            BASE.replace(resistor_nodes=[[1, 2], [2, 3], [3, 4], [4, 0], [2, 2]], conductance=[1e-3] * 5),
            "shorted resistor",
            "warning",
            "node_2",
        ),
        (BASE.replace(node_names=("0", "a", "A", "b", "c")), "names", "warning", "a"),
        (Netlist(3, [[1, 2]], [1.0], source_nodes=[[1, 2]], source_volts=[1.0]), "ground", "error", "0"),
    ],
)
def test_each_rule_finds_its_fault(netlist: Netlist, rule: str, severity: str, place: str) -> None:
    found = {finding.rule: finding for finding in check_rules(netlist)}
    assert rule in found
    assert (found[rule].severity, found[rule].place) == (severity, place)
    assert found[rule].message
    assert found[rule].remedy


def test_errors_come_first() -> None:
    severities = [finding.severity for finding in check_rules(with_more(current_nodes=[[0, 5]], current_amps=[1e-6]))]
    assert severities == ["error", "warning"]
