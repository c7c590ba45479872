"""Creation, layout and reproducible saving of figures, independent of a screen."""

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
"""File formats of pictures; the names are also the suffixes of files, without the dot."""
PAGE = 7.4
"""Width of a figure that spans both columns of a page, in inches."""

FRAME_DPI = 100
"""Resolution of frames of animations, in dots per inch."""

NOTEBOOK_DPI = 100
"""Resolution of pictures in notebooks, in dots per inch."""

# These fields would hold the date or the version of matplotlib, so that files would differ between runs.
_NO_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}
_SETTINGS: Any = {"svg.hashsalt": "resgrid", "pdf.fonttype": 42}


class NotebookFigure(Figure):
    """A figure without a window, which a notebook displays as a PNG image."""

    def add_subplot(self, *place: Any, **options: Any) -> Any:
        """Return new axes, which a notebook displays, too; `place` and `options` are arguments of matplotlib."""
        return super().add_subplot(*place, **{"axes_class": NotebookAxes} | options)

    def _repr_png_(self) -> bytes:
        return render_figure(self, "png", dpi=NOTEBOOK_DPI)


class NotebookAxes(Axes):
    """Axes that a notebook displays as a PNG image of the whole figure."""

    def _repr_png_(self) -> bytes:
        return render_figure(self, "png", dpi=NOTEBOOK_DPI)


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure without a window; `width` and `height` in inches."""
    figure = NotebookFigure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_or_new(axes: Axes | None, aspect: float = 1.0) -> Axes:
    """Return the given axes, or the axes of a new figure if `axes` is None.

    `aspect`: height over width of the drawing in a new figure.
    """
    return new_figure(4.8, panel_height(3.6, aspect)).add_subplot() if axes is None else axes


def add_title(figure: Figure, title: str, caption: str = "") -> None:
    """Write a title above a figure and a caption below the title; empty texts are omitted.

    All axes are moved to the upper end of the space that the layout gives them.
    """
    for axes in figure.axes:
        axes.set_anchor("N")
    if caption:
        figure.suptitle("\n".join(part for part in (title, caption) if part), fontsize=TEXT + 1, linespacing=1.5)
    elif title:
        figure.suptitle(title, fontsize=TEXT + 2)


def caption_height(caption: str) -> float:
    """Return the height that a figure needs for a caption, in inches; 0 for an empty caption."""
    return 0.2 + 0.19 * (caption.count("\n") + 1) if caption else 0.0


def panel_height(width: float, aspect: float) -> float:
    """Return the height of a panel (axes with labels and a legend), in inches.

    `width`: width of the drawing, in inches; `aspect`: height over width of the drawing.
    """
    return min(max(width * aspect, 1.0), 2.2 * width) + 1.1


def render_figure(picture: Axes | Figure, file_format: str, *, dpi: float = DPI) -> bytes:
    """Return the bytes of a picture file; equal pictures give equal bytes.

    `file_format`: one of `FORMATS`; `dpi`: resolution in dots per inch, 10 to 2400.
    """
    if file_format not in FORMATS:
        raise InputError(f"the picture format {file_format!r} is unknown; choose one of {', '.join(FORMATS)}")
    if not 10 <= dpi <= 2400:
        raise InputError(f"dpi = {dpi} must lie between 10 and 2400 dots per inch")
    buffer = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure_of(picture).savefig(buffer, format=file_format, dpi=dpi, metadata=_NO_METADATA[file_format])
    return buffer.getvalue()


def figure_of(picture: Axes | Figure) -> Figure:
    """Return the matplotlib figure that contains the given axes, or the given figure unchanged."""
    figure = picture.get_figure(root=True)
    assert figure is not None
    return figure


def save_figure(picture: Axes | Figure, file: str | os.PathLike[str], *, dpi: float = DPI) -> Path:
    """Write a picture to a file.  The file is written atomically.

    Parameters
    ----------
    picture : matplotlib.axes.Axes or matplotlib.figure.Figure
        Result of `draw`.
    file : path-like
        The suffix ``.png``, ``.pdf`` or ``.svg`` selects the format.
    dpi : float
        Dots per inch of PNG, and of images inside the other formats.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, the resolution is out of range, or the file cannot be written.

    Examples
    --------
    >>> ax = rg.draw(rg.read_scene("examples/scenes/lesson.toml"))
    >>> rg.plot.save_figure(ax, "scene.svg").name
    'scene.svg'
    """
    return write_bytes(file, render_figure(picture, picture_format(file), dpi=dpi))


def picture_format(file: str | os.PathLike[str]) -> str:
    """Return the format ("png", "pdf" or "svg") of a file by its suffix; raise InputError for another suffix."""
    suffix = Path(file).suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        allowed = ", ".join("." + name for name in FORMATS)
        raise InputError(f"cannot save a picture as {str(file)!r}: its suffix must be one of {allowed}")
    return suffix


def settle_layout(figure: Figure) -> None:
    """Compute the layout of a figure once and fix it, so that axes do not move between frames."""
    figure.set_dpi(FRAME_DPI)
    for _ in range(2):  # the layout of axes with a fixed aspect converges in two passes
        figure.canvas.draw()
    figure.set_layout_engine("none")
