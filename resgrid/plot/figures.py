"""Figures without a screen: making them, and writing them whole, the same bytes every time."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from resgrid._internal.files import write_bytes
from resgrid.errors import InputError
from resgrid.plot.style import DPI, TEXT

FORMATS = ("png", "pdf", "svg")
PAGE = 7.4
"""Width in inches of a figure that a page of two columns bears unscaled."""

NOTEBOOK_DPI = 100

# What would otherwise hold the date or the version of matplotlib.
_NO_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}
_SETTINGS: Any = {"svg.hashsalt": "resgrid", "pdf.fonttype": 42}


class NotebookFigure(Figure):
    """A figure that a notebook shows, though no window knows of it."""

    def add_subplot(self, *place: Any, **options: Any) -> Any:
        """Add axes that a notebook shows, too."""
        return super().add_subplot(*place, **{"axes_class": NotebookAxes} | options)

    def _repr_png_(self) -> bytes:
        return render_figure(self, "png", dpi=NOTEBOOK_DPI)


class NotebookAxes(Axes):
    """Axes that a notebook shows, with their whole figure."""

    def _repr_png_(self) -> bytes:
        return render_figure(self, "png", dpi=NOTEBOOK_DPI)


def new_figure(width: float, height: float) -> Figure:
    """Make a figure that no window knows of."""
    figure = NotebookFigure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_or_new(axes: Axes | None, aspect: float = 1.0) -> Axes:
    """Return the axes given, or those of a new figure for a drawing of the given height over width."""
    return new_figure(4.8, panel_height(3.6, aspect)).add_subplot() if axes is None else axes


def add_title(figure: Figure, title: str, caption: str = "") -> None:
    """Write a title above a figure, and a caption right below the title, if there are any; axes move up to them."""
    for axes in figure.axes:
        axes.set_anchor("N")
    if caption:
        figure.suptitle("\n".join(part for part in (title, caption) if part), fontsize=TEXT + 1, linespacing=1.5)
    elif title:
        figure.suptitle(title, fontsize=TEXT + 2)


def caption_height(caption: str) -> float:
    """Height in inches of a caption."""
    return 0.2 + 0.19 * (caption.count("\n") + 1) if caption else 0.0


def panel_height(width: float, aspect: float) -> float:
    """Height in inches of a figure whose drawing is so wide, with labels and a legend below."""
    return min(max(width * aspect, 1.0), 2.2 * width) + 1.1


def render_figure(picture: Axes | Figure, file_format: str, *, dpi: float = DPI) -> bytes:
    """Render a picture as a file's content."""
    if file_format not in FORMATS:
        raise InputError(f"the picture format {file_format!r} is unknown; it may be one of {', '.join(FORMATS)}")
    if not 10 <= dpi <= 2400:
        raise InputError(f"dpi = {dpi}, but a picture has 10 to 2400 dots per inch")
    buffer = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure_of(picture).savefig(buffer, format=file_format, dpi=dpi, metadata=_NO_METADATA[file_format])
    return buffer.getvalue()


def figure_of(picture: Axes | Figure) -> Figure:
    """The figure that a picture, one or several axes, is drawn on."""
    figure = picture.get_figure(root=True)
    assert figure is not None
    return figure


def save_figure(picture: Axes | Figure, file: str | os.PathLike[str], *, dpi: float = DPI) -> Path:
    """Write a picture, whole or not at all.

    Parameters
    ----------
    picture : matplotlib.axes.Axes or matplotlib.figure.Figure
        What `draw` returned.
    file : path-like
        Its suffix, ``.png``, ``.pdf`` or ``.svg``, says the format.
    dpi : float
        Dots per inch of PNG, and of images inside the others.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, the resolution absurd, or the path cannot be written.

    Examples
    --------
    >>> ax = rg.draw(rg.read_scene("examples/scenes/lesson.toml"))
    >>> rg.plot.save_figure(ax, "scene.svg").name
    'scene.svg'
    """
    return write_bytes(file, render_figure(picture, picture_format(file), dpi=dpi))


def picture_format(file: str | os.PathLike[str]) -> str:
    """The format that a file's name says; refused where there is none."""
    suffix = Path(file).suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        allowed = ", ".join("." + name for name in FORMATS)
        raise InputError(f"cannot save a picture as {str(file)!r}: its suffix must be one of {allowed}")
    return suffix
