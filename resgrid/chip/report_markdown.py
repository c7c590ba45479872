"""Report on a chip as Markdown: its sections, SPICE decks and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from resgrid.chip.figures_of_merit import figure_lines, table_lines
from resgrid.chip.report import Section
from resgrid.chip.study_analyses import Study

_DECKS = (
    "The expected results of a deck are in its sidecar of the same name with `.json`. The file with `.ngspice` (or "
    "the dialect's name) runs it; its first lines give the command. Node `n_3_7` is the node of cell (3, 7), from 0."
)
"""Paragraph that introduces the SPICE decks in the report."""


def report_markdown(chip: Study, parts: Sequence[Section], decks: Mapping[str, str], verdict: str) -> str:
    """Return the report on a chip as Markdown text.

    `chip`: the chip under study; `parts`: sections; `decks`: descriptions of the deck files by file name; `verdict`:
    sentence on the simulator's check of the decks.
    """
    lines = [f"# {chip.title}", "", *(f"- **{section.title}.** {section.text[0]}" for section in parts), ""]
    for section in parts:
        lines += [f"## {section.title}", "", " ".join(section.text), ""]
        if section.table:
            lines += [*section.table, ""]
        if section.figures:
            lines += [*figure_lines(section.figures), ""]
        lines += [f"![{picture.caption}]({picture.name}.png)\n\n*{picture.caption}*\n" for picture in section.pictures]
    lines += ["## Decks", "", _DECKS, "", verdict, "", *(f"- `{name}`: {what}" for name, what in decks.items()), ""]
    rows = ((f"`{key}`", value, meaning) for key, value, meaning in chip.parameters)
    return "\n".join([*lines, "## The chip", "", *table_lines(("key", "value", "meaning"), rows)]) + "\n"
