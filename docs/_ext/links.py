"""No link within the site leads nowhere: asked of every page when it has been written."""

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

from sphinx.util import logging

OUTSIDE = re.compile(r"(https?|mailto|data|javascript):")
log = logging.getLogger(__name__)


class Page(HTMLParser):
    """What a page links to, and what in it can be linked to."""

    def __init__(self, file):
        super().__init__()
        self.links, self.names = set(), set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        """Keep names and links of a tag; a page that loads anything from another site is told as well."""
        for key, value in attrs:
            if key in {"id", "name"}:
                self.names.add(value)
            elif key in {"src", "href"}:
                self.links.add((tag, unquote(value or "")))


def check_links(app, exception):
    """Warn of links to files or places that are not there, and of what would be fetched from elsewhere."""
    if exception or app.builder.name != "html":
        return
    files = (file.resolve() for file in Path(app.outdir).rglob("*.html") if "_static" not in file.parts)
    pages = {file: Page(file) for file in files}
    for file, page in pages.items():
        for tag, link in sorted(page.links):
            if OUTSIDE.match(link):
                if tag != "a" and not link.startswith("data:"):
                    log.warning("%s loads %s", file, link)
                continue
            path, _, name = link.partition("#")
            target = (file.parent / path.split("?")[0]).resolve() if path else file
            if not target.exists() or (name and target in pages and name not in pages[target].names):
                log.warning("%s: the link %s leads nowhere", file, link)


def setup(app):
    """Have every page checked in the end."""
    app.connect("build-finished", check_links, priority=900)  # after those who still write files
    return {"parallel_read_safe": True, "parallel_write_safe": True}
