"""Open every page of the built site in Chromium, with a narrow and a wide window: `make look`.

The script reports pages wider than the window, messages on the console, pictures that do not load or have no
alternative text, and requests to other sites.  `python docs/look.py FOLDER` saves a screenshot of every page, light and
dark.
"""

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

SITE = Path(__file__).resolve().parent / "_build" / "html"
WIDTHS = (390, 1280)
FAULTS = """() => {
  const faults = [], page = document.documentElement;
  if (page.scrollWidth > page.clientWidth) faults.push(`${page.scrollWidth - page.clientWidth} pixels too wide`);
  for (const image of document.querySelectorAll('main img')) {
    image.loading = 'eager';
    const file = image.src.split('/').pop().slice(-60);
    if (image.complete && !image.naturalWidth) faults.push(`${file} does not load`);
    if (image.getAttribute('alt') === null || /[.](png|gif|svg)$/.test(image.alt)) faults.push(`${file} has no name`);
  }
  return faults;
}"""


def look(browser, width, scheme, folder):
    """Open all pages, print their faults, and return the number of faults."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    said, count = [], 0
    page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith(("file:", "data:")) else said.append(request.url))
    for file in sorted(SITE.rglob("*.html")):
        name = str(file.relative_to(SITE))
        if name.startswith("_"):
            continue
        said.clear()
        page.goto(file.as_uri())
        for fault in [*page.evaluate(FAULTS), *said]:
            print(f"{name}, {width} wide: {fault}", file=sys.stderr)
            count += 1
        if folder:
            page.screenshot(path=folder / f"{name.replace('/', '-')}-{width}-{scheme}.png", full_page=True)
    page.close()
    return count


def main():
    """Check the site, and exit with 1 if a page has faults."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    with sync_playwright() as playwright:
        options = {"executable_path": "/usr/bin/chromium"} if Path("/usr/bin/chromium").exists() else {}
        browser = playwright.chromium.launch(args=["--no-sandbox", "--disable-gpu"], **options)
        schemes = ("light", "dark") if folder else ("light",)
        sys.exit(sum(look(browser, width, scheme, folder) for width in WIDTHS for scheme in schemes) > 0)


if __name__ == "__main__":
    main()
