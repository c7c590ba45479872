"""The report about a chip as a page for browsers."""

from __future__ import annotations

import html


def format_html(title: str, text: str) -> str:
    """The Markdown of a report as a page."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark").enable("table").render(text)
    return _PAGE.format(title=html.escape(title), body=body)


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
img {{ max-width: 100%; max-height: 36em; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
