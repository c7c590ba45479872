"""Configuration of the site: `make docs`.  The build works offline, and every warning is an error."""

import os
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS / "_ext"))

from figures import SECTIONS  # noqa: E402

import resgrid  # noqa: E402

# Pages run the command `resgrid` of this environment.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["PROJECT"] = str(DOCS.parent)
os.environ["SCENES"] = str(DOCS.parent / "examples" / "scenes")
os.environ["NO_COLOR"] = "1"
os.environ["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"

project = "resgrid"
author = "the resgrid maintainers"
project_copyright = author
release = version = resgrid.__version__

extensions = [
    "cells",
    "links",
    "mathml",
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.doctest",
    "subcommands",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "_build",
    "_ext",
    "jupyter_execute",
    "gallery/**/*.ipynb",
    "**sg_execution_times.rst",
    "**.ipynb_checkpoints",
]
nitpicky = False

smartquotes_action = "qe"

html_theme = "pydata_sphinx_theme"
html_title = "resgrid"
html_context = {"default_mode": "auto"}
templates_path = ["_templates"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "resgrid"},
    "show_prev_next": False,
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": {"**": ["page-toc"], "gallery/index": [], "explanation/planners": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
}
html_sidebars = {"start": [], "index": []}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_update_mathjax = False
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 600
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_markdown_format = "myst"

autodoc_typehints = "none"
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_filename_map = {f"resgrid.{name}": f"resgrid.{name}_" for name in resgrid.__all__ if not name.islower()}
numpydoc_show_class_members = False
copybutton_exclude = ".linenos, .gp, .go"

sphinx_gallery_conf = {
    "examples_dirs": ["../examples"],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__\.py",
    "subsection_order": [f"../examples/{name}" for name in SECTIONS],
    "within_subsection_order": "figures.ReadingOrder",
    "image_scrapers": ("figures.saved_pictures",),
    "reset_modules": ("figures.forget_output",),
    "reset_modules_order": "both",
    "copyfile_regex": r".*\.toml",
    "doc_module": ("resgrid",),
    "reference_url": {"resgrid": None},
    "backreferences_dir": "gallery/uses",
    "download_all_examples": False,
    "capture_repr": (),
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "thumbnail_size": (420, 300),
    "plot_gallery": "True",
    "abort_on_example_error": True,
    "remove_config_comments": True,
}
