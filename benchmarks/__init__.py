"""Benchmarks: ratios measured in one run, alternating, as medians.  ``make bench`` runs them.

A section is a function from `Scale` to a list of `Row`.  It creates problems (`problems`), runs contenders in turn
(`contest`; each one is a process, `worker`; external solvers are in `peers`, resgrid in `ours`), and returns rows.
`__main__` lists the sections, prints the rows (`table`), saves them in results.json and draws results.png (`picture`).
"""
