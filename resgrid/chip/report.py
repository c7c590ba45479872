"""The page about a chip, as Markdown: what every analysis says, its figures with definitions, pictures, decks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from resgrid.chip import sections
from resgrid.chip.exploration import Sweep
from resgrid.chip.figures import Figure
from resgrid.chip.sections import USUAL, Effort, Section
from resgrid.chip.studies import Study

_DECKS = (
    "Every deck has its expected answer in the sidecar of the same name and `.json`; the file ending in `.ngspice` (or "
    "the dialect's name) runs it, and says in its first lines how. Node `n_3_7` is that of cell (3, 7), counted from 0."
)


def report_section(name: str, chip: Study, effort: Effort = USUAL) -> Section:
    """What one of the analyses says of a chip, without maps of spaces that have not two axes."""
    section: Section = getattr(sections, f"{name}_section")(chip, effort)
    is_plane = chip.ideal.cells.space.ndim == 2
    return replace(section, pictures=tuple(item for item in section.pictures if is_plane or not item.is_map))


def seconds_needed(name: str, chip: Study, effort: Effort) -> float:
    """Roughly how long an analysis takes."""
    nodes = chip.netlist.node_count
    known = {"settling": 1 + 2e-5 * nodes, "noise": 1 + 2e-4 * nodes, "sensitivity": 1 + 1e-4 * nodes, "yield": 2.0}
    return known.get(name, {"exploration": 5.0, "defects": effort.seconds}.get(name, 0.0))


def checkpoints_beside(folder: Path, chip: Study, sweep: Sequence[Sweep]) -> dict[str, Path]:
    """Where the results of trials are kept until their folder is whole, by the analysis."""
    cells = chip.ideal.cells
    mark = hashlib.sha256(f"{chip.chip} {cells.wiring} {sweep}".encode() + cells.space.cell.tobytes()).hexdigest()[:12]
    return {name: folder.parent / f".{folder.name}-{mark}.{name}.jsonl" for name in ("yield", "exploration")}


def report_markdown(chip: Study, parts: Sequence[Section], decks: Mapping[str, str], verdict: str) -> str:
    """The report: `decks` are files and what they are, `verdict` is what a simulator said of them."""
    lines = [f"# {chip.title}", "", *(f"- **{section.title}.** {section.text[0]}" for section in parts), ""]
    for section in parts:
        lines += [f"## {section.title}", "", " ".join(section.text), ""]
        if section.figures:
            lines += [*_table(("figure", "value", "definition"), _rows(section.figures)), ""]
        lines += [f"![{picture.caption}]({picture.name}.png)\n\n*{picture.caption}*\n" for picture in section.pictures]
    lines += ["## Decks", "", _DECKS, "", verdict, "", *(f"- `{name}`: {what}" for name, what in decks.items()), ""]
    rows = ((f"`{key}`", value, meaning) for key, value, meaning in chip.parameters)
    return "\n".join([*lines, "## The chip", "", *_table(("key", "value", "meaning"), rows)]) + "\n"


def _rows(figures: Mapping[str, Figure]) -> Iterator[tuple[str, str, str]]:
    for name, figure in figures.items():
        yield name.replace("_", " "), str(figure), figure.definition.replace("|", "\\|")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
