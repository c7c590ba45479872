"""What the gallery shows of an example: the pictures that it saves in `out`, moved to where the page looks for them."""

import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst

SECTIONS = ("first", "figures_1992", "space", "chip", "control")
SUFFIXES = (".png", ".gif")


def saved_pictures(block, block_vars, gallery_conf):
    """Move the pictures saved by a block of an example, oldest first, and write the markup that shows them."""
    folder = Path(block_vars["src_file"]).parent / "out"
    saved = sorted(
        (file for file in folder.rglob("*") if file.suffix in SUFFIXES), key=lambda file: file.stat().st_mtime_ns
    )
    shown = []
    for file, place in zip(saved, block_vars["image_path_iterator"], strict=False):
        shown.append(str(Path(place).with_suffix(file.suffix)))
        shutil.move(file, shown[-1])
    return figure_rst(shown, gallery_conf["src_dir"])


def forget_output(gallery_conf, fname):
    """Remove what the example before wrote."""
    for section in SECTIONS:
        shutil.rmtree(Path(gallery_conf["examples_dirs"][0], section, "out"), ignore_errors=True)
