"""Benchmarks: ratios measured in one run, alternating, as medians.  ``make bench`` runs them.

From the top: a section (a function from `Scale` to a list of `Row`) makes problems (`problems`), lets contenders solve
them in turn (`contest`: one process each, `worker`; the outside solvers are in `peers`, resgrid in `ours`), and returns
rows.  `__main__` lists the sections, prints the rows (`table`), keeps them in results.json and draws results.png
(`picture`).
"""
