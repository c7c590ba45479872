"""``python -m benchmarks [SECTION ...]``: run benchmark sections, print one table, save and plot the results.

``make bench`` installs the peers beforehand; the table lists missing peers.  `SECTIONS` lists the sections.
``--scale full`` adds large sizes, and ``--seed`` selects random problems that were not used for tuning.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

from benchmarks import (
    accuracy,
    chips,
    choice,
    decks,
    executors,
    grids,
    large,
    memory,
    pipeline,
    planners,
    replanning,
    simulator,
    start,
    table,
    updates,
)
from benchmarks.picture import write_picture
from benchmarks.rows import Row, Scale

FOLDER = Path(__file__).parent

SECTIONS: tuple[tuple[str, Callable[[Scale], list[Row]]], ...] = (
    ("start", start.start),
    ("pipeline", pipeline.pipeline),
    ("plane", grids.plane),
    ("volume", grids.volume),
    ("irregular", grids.irregular),
    ("mazes", grids.mazes),
    ("growth", grids.growth),
    ("direction", accuracy.direction),
    ("choice", choice.choice),
    ("update", updates.update),
    ("threads", updates.threads),
    ("chips", chips.chips),
    ("executors", executors.executors),
    ("memory", memory.memory),
    ("large", large.large),
    ("simulator", simulator.simulator),
    ("decks", decks.decks),
    ("planners", planners.planners),
    ("replanning", replanning.replanning),
)
"""Sections by name: the functions that measure them."""

SCALES = {"tiny": Scale("tiny", 2, 20.0), "quick": Scale("quick", 5, 60.0), "full": Scale("full", 7, 300.0)}


def arguments(words: list[str]) -> argparse.Namespace:
    """Return the parsed command line."""
    names = [name for name, _ in SECTIONS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"which to run (all): {', '.join(names)}")
    parser.add_argument("--scale", choices=SCALES, default="quick", help="how large (quick, some twenty minutes)")
    parser.add_argument("--seed", type=int, default=0, help="added to every problem's seed")
    parser.add_argument("--rounds", type=int, help="alternating runs of each comparison")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where results.json and results.png are kept")
    chosen = parser.parse_args(words)
    for name in chosen.sections:
        if name not in names:
            parser.error(f"there is no section {name!r}; there are {', '.join(names)}")
    if chosen.rounds is not None and chosen.rounds < 1:
        parser.error(f"--rounds {chosen.rounds} must be at least 1")
    return chosen


def main(words: list[str] | None = None) -> None:
    """Run sections one by one; print and save each section when it is complete."""
    chosen = arguments(sys.argv[1:] if words is None else words)
    plain = SCALES[chosen.scale]
    scale = replace(plain, seed=chosen.seed, rounds=chosen.rounds or plain.rounds)
    chosen.folder.mkdir(parents=True, exist_ok=True)
    kept = table.read_results(chosen.folder / "results.json")
    last = table.last_values(kept)
    with one_thread():
        for name, measure in SECTIONS:
            if chosen.sections and name not in chosen.sections:
                continue
            sys.stderr.write(f"{name} ...\n")
            begin = time.perf_counter()
            rows = measured(name, measure, scale)
            sys.stdout.write(f"\n{name} ({time.perf_counter() - begin:.0f} s)\n{table.format_rows(rows, last)}")
            sys.stdout.flush()
            kept[name] = table.section_record(rows, scale)
            table.write_results(chosen.folder / "results.json", kept)
    order = [name for name, _ in SECTIONS if name in kept]
    write_picture(chosen.folder / "results.png", {name: table.rows_of(kept[name]) for name in order})


def measured(name: str, measure: Callable[[Scale], list[Row]], scale: Scale) -> list[Row]:
    """Return the rows of a section; if the section fails, return one row with the error."""
    try:
        return measure(scale)
    except Exception as error:
        return [Row(name, None, None, "", note=f"failed: {type(error).__name__}: {error}")]


def one_thread() -> AbstractContextManager[object]:
    """Limit the libraries of this process to one thread, like those of the contenders."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    limits: AbstractContextManager[object] = threadpool_limits(1)
    return limits


if __name__ == "__main__":
    # On SIGTERM, still end the processes of the contenders.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    main()
