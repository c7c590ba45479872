"""What a field shows, against the verdict of connectivity."""

import numpy as np

import resgrid as rg


def check_verdicts(field: rg.Field) -> None:
    """Where no chain of free cells leads to a goal nothing arrives and nothing flows; elsewhere something does."""
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
