"""Cells of a factored circuit that become obstacles or goals: what changes is patched, what need not is kept."""
