"""The page about a chip, as Markdown and as HTML: figures with units and definitions, pictures, decks."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from resgrid.chip.figures import Reading

_PREFIXES = dict(zip(range(-24, 13, 3), ("y", "z", "a", "f", "p", "n", "µ", "m", "", "k", "M", "G", "T"), strict=True))
_UNITS = {"ohm": "Ω", "V/sqrt(Hz)": "V/√Hz"}
_DECKS = (
    "Every deck has its expected answer in the sidecar of the same name and `.json`; the file ending in `.ngspice` (or "
    "the dialect's name) runs it, and says in its first lines how. Node `n_3_7` is that of cell (3, 7), counted from 0."
)


@dataclass(frozen=True, eq=False)
class Section:
    """What one analysis has to say.

    `text`: sentences; the first one is the answer; `pictures`: file, and what it shows; `data`: for JSON.
    """

    name: str
    title: str
    text: tuple[str, ...]
    readings: Mapping[str, Reading] = field(default_factory=dict)
    pictures: tuple[tuple[str, str], ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


def shown(value: float | int | str | None, unit: str) -> str:
    """A figure for people: engineering prefixes, or per cent."""
    if value is None:
        return "undefined"
    if isinstance(value, str):
        return value
    if unit in ("", "bit", "°C", "%"):
        return f"{value:,}" if isinstance(value, int) else f"{value:.4g}" + (f" {unit}" if unit else "")
    unit = _UNITS.get(unit, unit)
    if value == 0:
        return f"0 {unit}"
    power = min(max(3 * math.floor(math.log10(abs(float(f"{value:.4g}"))) / 3), -24), 12)
    return f"{value / 10.0**power:.4g} {_PREFIXES[power]}{unit}"


def format_markdown(
    title: str,
    parameters: Sequence[tuple[str, str, str]],
    sections: Sequence[Section],
    decks: Mapping[str, str],
    verdict: str,
) -> str:
    """The report as Markdown."""
    lines = [f"# {title}", "", *(f"- **{section.title}.** {section.text[0]}" for section in sections), ""]
    for section in sections:
        lines += [f"## {section.title}", "", " ".join(section.text), ""]
        if section.readings:
            lines += ["| figure | value | definition |", "|---|---|---|", *_markdown_rows(section.readings), ""]
        lines += [f"![{what}]({name})\n\n*{what}*\n" for name, what in section.pictures]
    lines += ["## Decks", "", _DECKS, "", verdict, "", *(f"- `{name}`: {what}" for name, what in decks.items()), ""]
    lines += ["## The chip", "", "| key | value | meaning |", "|---|---|---|"]
    lines += [f"| `{key}` | {value} | {meaning} |" for key, value, meaning in parameters]
    return "\n".join(lines) + "\n"


def _markdown_rows(readings: Mapping[str, Reading]) -> Iterator[str]:
    for name, reading in readings.items():
        definition = reading.definition.replace("|", "\\|")
        yield f"| {name.replace('_', ' ')} | {shown(reading.value, reading.unit)} | {definition} |"


def format_html(
    title: str,
    parameters: Sequence[tuple[str, str, str]],
    sections: Sequence[Section],
    decks: Mapping[str, str],
    verdict: str,
) -> str:
    """The report as a page for browsers; as `format_markdown` otherwise."""
    body = [f"<h1>{_safe(title)}</h1>", "<ul>"]
    body += [
        f"<li><b>{_safe(section.title)}.</b> {_safe(section.text[0].replace('`', ''))}</li>" for section in sections
    ]
    body.append("</ul>")
    for section in sections:
        body += [f"<h2>{_safe(section.title)}</h2>", f"<p>{_safe(' '.join(section.text).replace('`', ''))}</p>"]
        rows = [
            (name.replace("_", " "), shown(reading.value, reading.unit), reading.definition)
            for name, reading in section.readings.items()
        ]
        body += _html_table(("figure", "value", "definition"), rows) if rows else []
        for name, what in section.pictures:
            caption = f"<figcaption>{_safe(what)}</figcaption>"
            body.append(f'<figure><img src="{_safe(name)}" alt="{_safe(what)}">{caption}</figure>')
    body += ["<h2>Decks</h2>", f"<p>{_safe(_DECKS.replace('`', ''))}</p>", f"<p>{_safe(verdict)}</p>"]
    body += _html_table(("file", "what it is"), list(decks.items()))
    body += ["<h2>The chip</h2>", *_html_table(("key", "value", "meaning"), list(parameters))]
    return _PAGE.format(title=_safe(title), body="\n".join(body))


def _html_table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    lines = ["<table>", "<tr>" + "".join(f"<th>{word}</th>" for word in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{_safe(word)}</td>" for word in row) + "</tr>" for row in rows]
    return [*lines, "</table>"]


def _safe(text: str) -> str:
    return html.escape(text)


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 15px/1.45 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}
table {{ border-collapse: collapse; margin: 1em 0; }}
th, td {{ text-align: left; vertical-align: top; padding: 0.2em 0.8em 0.2em 0; border-bottom: 1px solid #ccc; }}
td:nth-child(2) {{ white-space: nowrap; }}
figure {{ margin: 1em 0; }}
img {{ max-width: 100%; max-height: 36em; }}
figcaption {{ font-style: italic; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
