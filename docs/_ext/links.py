"""Check the internal links of every page after the build."""

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

from sphinx.util import logging

OUTSIDE = re.compile(r"(https?|mailto|data|javascript):")
log = logging.getLogger(__name__)


class Page(HTMLParser):
    """Links of a page, and its anchors."""

    def __init__(self, file):
        super().__init__()
        self.links, self.names = set(), set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        """Store anchors and links of a tag."""
        for key, value in attrs:
            if key in {"id", "name"}:
                self.names.add(value)
            elif key in {"src", "href"}:
                self.links.add((tag, unquote(value or "")))


def check_links(app, exception):
    """Warn of links to missing files or anchors, and of resources that are loaded from another site."""
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
                log.warning("%s: the target of the link %s does not exist", file, link)


def setup(app):
    """Check all pages at the end of the build."""
    app.connect("build-finished", check_links, priority=900)  # after handlers that still write files
    return {"parallel_read_safe": True, "parallel_write_safe": True}
