"""Pictures of circuits with memristors."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from support.memristors import LAW, loop
from support.spaces import space_of

import resgrid as rg


def grid_run(frame: rg.Frame | None = None) -> rg.circuit.MemristiveTransient:
    """Return the transient of a grid of 4 x 3 cells with antiparallel memristors."""
    cell = np.zeros((4, 3), dtype=np.uint8)
    cell[1, 1], cell[3, 2] = 1, 2
    space = rg.ConfigurationSpace(space_of(cell).axes, cell, frame=frame)
    netlist = rg.compile_space(space, boundary="neumann", drive="start", start=(0, 0))
    circuit = rg.circuit.MemristiveCircuit.antiparallel(netlist, rg.circuit.Memristor(1e3, 1e5, 1e6))
    return rg.circuit.memristive_transient(circuit, [0.0, 0.2, 3.0], tolerance=1e-3)


def test_a_map_shows_the_resistance_of_every_link() -> None:
    run = grid_run()
    links = len(run.circuit.netlist.conductance) // 2
    for at, ohms in ((0, 5e4), (2, 1 / (1e-3 + 1e-5))):
        axes = rg.draw(run, at=at)
        lines = next(item for item in axes.collections if isinstance(item, LineCollection))
        values = np.asarray(lines.get_array())
        assert len(values) == len(lines.get_segments()) == links
        assert values.min() == pytest.approx(ohms, rel=1e-9)
        assert axes.get_title() == ("after 0.0 s", "after 200.0 ms", "after 3.0 s")[at]
        segments = np.array(lines.get_segments())
        assert segments.min() >= 0 and (segments.max(axis=(0, 1)) <= (4, 3)).all()


def test_a_map_shows_links_and_start_in_world_coordinates() -> None:
    ends, starts = [], []
    frame = rg.Frame(10.0, -5.0, np.pi / 6)
    for run in (grid_run(), grid_run(frame)):
        axes = rg.draw(run)
        lines = next(item for item in axes.collections if isinstance(item, LineCollection))
        ends.append(np.array(lines.get_segments()))
        starts.append(next(item for item in axes.collections if item.get_label() == "start").get_offsets())
    np.testing.assert_allclose(ends[1], frame.to_world(ends[0]), atol=1e-12)
    np.testing.assert_allclose(starts[1], frame.to_world(starts[0]), atol=1e-12)


def test_states_are_drawn_over_time_where_there_is_no_grid() -> None:
    run = rg.circuit.memristive_transient(rg.circuit.MemristiveCircuit(loop(), LAW), [0.0, 0.5, 1.0])
    axes = rg.draw(run)
    assert np.array_equal(axes.lines[0].get_ydata(), run.state[:, 0])
    assert len(rg.draw(grid_run(), quantity="states").lines) == len(grid_run().circuit.memristors)
    with pytest.raises(rg.InputError, match="needs a netlist compiled from a space with two axes"):
        rg.draw(run, quantity="map")
    with pytest.raises(rg.InputError, match="at = 3 is not the index of one of the 3 output times"):
        rg.draw(grid_run(), at=3)


def test_a_picture_of_states_rejects_an_output_time() -> None:
    run = rg.circuit.memristive_transient(rg.circuit.MemristiveCircuit(loop(), LAW), [0.0, 0.5, 1.0])
    for options in ({}, {"quantity": "states"}):
        with pytest.raises(rg.InputError, match="at = 1 chooses the output time of a map"):
            rg.draw(run, at=1, **options)
