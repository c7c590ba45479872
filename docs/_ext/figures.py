"""Pictures of gallery pages: the files that an example saves in `out`, moved into the folder of the page."""

import builtins
import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst

SECTIONS = ("first", "figures_1992", "space", "chip", "control", "learning")
FIRST = ("lesson.py", "report.py", "voxels.py")
"""Examples at the start of their section; the others follow by name."""
SUFFIXES = (".png", ".gif")


class ReadingOrder:
    """Sort key for the examples of a section."""

    def __init__(self, _folder):
        pass

    def __call__(self, name):
        """Return the sort key of a file name."""
        return (name not in FIRST, name)


def saved_pictures(_block, block_vars, gallery_conf):
    """Move the pictures saved by a block of an example, oldest first, and return the markup that shows them."""
    folder = Path(block_vars["src_file"]).parent / "out"
    saved = sorted((file for file in folder.rglob("*") if file.suffix in SUFFIXES), key=_age)
    shown = []
    for file, place in zip(saved, block_vars["image_path_iterator"], strict=False):
        shown.append(str(Path(place).with_suffix(file.suffix)))
        shutil.move(file, shown[-1])
    return "".join(figure_rst([file], gallery_conf["src_dir"]) for file in shown)


def forget_output(gallery_conf, fname, when):
    """Remove the output of the previous example, and set `__file__` for the next example, as Python does."""
    for section in SECTIONS:
        examples = Path(gallery_conf["src_dir"], gallery_conf["examples_dirs"][0])
        shutil.rmtree(examples / section / "out", ignore_errors=True)
    builtins.__file__ = fname


def _age(file):
    return file.stat().st_mtime_ns
