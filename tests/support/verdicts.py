"""Comparison of a field with the connectivity of its space."""

import numpy as np

import resgrid as rg


def check_verdicts(field: rg.Field) -> None:
    """Check that only free cells connected to a goal carry current, and that the field has values in all of these."""
    space = field.space
    free = space.cell == rg.Cell.FREE
    if field.log_drop is not None:
        arrives = ~(np.isneginf(field.log_drop) | np.isnan(field.log_drop))
        wrong = free & (arrives != space.goal_connected)
    elif field.boundary == "neumann":
        wrong = free & (np.isfinite(field.potential) != space.goal_connected)
    else:
        wrong = np.zeros(space.shape, dtype=np.bool_)
    cells = np.argwhere(free)
    flows = (field.faces_of(cells)[0] != 0).any(axis=(0, 2))
    wrong[tuple(cells.T)] |= flows & ~space.goal_connected[tuple(cells.T)]
    for cell in map(tuple, np.argwhere(wrong).tolist()):
        verdict = "a path" if space.goal_connected[cell] else "no path"
        raise AssertionError(f"connectivity finds {verdict} from cell {cell}, but the field says otherwise")
