import subprocess
import sys
from pathlib import Path

import pytest

from resgrid.errors import InputError
from resgrid.plot import plot_potential, plot_scene_page, render_figure, save_figure


@pytest.mark.parametrize(("name", "first"), [("a.png", b"\x89PNG"), ("a.PDF", b"%PDF"), ("a.svg", b"<?xml")])
def test_the_suffix_says_the_format_and_the_bytes_repeat(field, tmp_path: Path, name: str, first: bytes) -> None:
    contents = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        path = save_figure(plot_potential(field).figure, tmp_path / folder / name)
        contents.append(path.read_bytes())
    assert contents[0].startswith(first)
    assert contents[0] == contents[1]
    assert [path.name for path in (tmp_path / "one").iterdir()] == [name]


@pytest.mark.parametrize("file_format", ["png", "pdf", "svg"])
def test_no_date_and_no_version_in_a_picture(field, file_format: str) -> None:
    content = render_figure(plot_scene_page(field), file_format)
    for word in (b"CreationDate", b"Creator", b"dc:date", b"Matplotlib v", b"Software"):
        assert word not in content


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt"])
def test_an_unknown_suffix_is_refused_and_nothing_written(field, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"suffix must be one of \.png, \.pdf, \.svg"):
        save_figure(plot_potential(field).figure, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_unknown_format_is_refused(field) -> None:
    with pytest.raises(InputError, match="'gif' is unknown"):
        render_figure(plot_potential(field).figure, "gif")


def test_a_missing_folder_is_an_input_error(field, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder"):
        save_figure(plot_potential(field).figure, tmp_path / "absent" / "a.png")


def test_computing_never_imports_matplotlib_and_drawing_never_pyplot() -> None:
    code = (
        "import sys, resgrid.planning.trace, resgrid.planning.blend, resgrid.nodal.solve, resgrid.compiler\n"
        "import resgrid.scene, resgrid.spice\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import resgrid.plot\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("dpi", [0, -5, 1e6, float("nan")])
def test_absurd_resolutions_are_refused(field, dpi: float) -> None:
    with pytest.raises(InputError, match="10 to 2400"):
        render_figure(plot_potential(field).figure, "png", dpi=dpi)
