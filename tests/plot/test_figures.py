"""Picture files: complete, without dates, reproducible bytes; and the imports they need.

Tests internals: `resgrid.plot.figures`.
"""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.plot.figures import render_figure


@pytest.mark.slow
@pytest.mark.parametrize(("name", "first"), [("a.png", b"\x89PNG"), ("a.PDF", b"%PDF"), ("a.svg", b"<?xml")])
def test_the_suffix_determines_the_format_and_bytes_are_reproducible(
    field, tmp_path: Path, name: str, first: bytes
) -> None:
    contents = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        path = rg.plot.save_figure(rg.plot.draw_summary(field), tmp_path / folder / name)
        contents.append(path.read_bytes())
    assert contents[0].startswith(first)
    assert contents[0] == contents[1]
    assert [path.name for path in (tmp_path / "one").iterdir()] == [name]
    for word in (b"CreationDate", b"Creator", b"dc:date", b"Matplotlib v", b"Software"):
        assert word not in contents[0]


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt"])
def test_an_unknown_suffix_raises_input_error_and_writes_no_file(field, tmp_path: Path, name: str) -> None:
    with pytest.raises(rg.InputError, match=r"suffix must be one of \.png, \.pdf, \.svg"):
        rg.plot.save_figure(rg.draw(field), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_invalid_formats_folders_and_resolutions_raise_input_error(field, tmp_path: Path) -> None:
    axes = rg.draw(field)
    with pytest.raises(rg.InputError, match="'gif' is unknown"):
        render_figure(axes.figure, "gif")
    with pytest.raises(rg.InputError, match="no folder"):
        rg.plot.save_figure(axes, tmp_path / "absent" / "a.png")
    for dpi in (0, -5, 1e6, float("nan")):
        with pytest.raises(rg.InputError, match="between 10 and 2400"):
            render_figure(axes.figure, "png", dpi=dpi)


@pytest.mark.slow
def test_computations_import_no_matplotlib_and_pictures_no_pyplot() -> None:
    code = (
        "import sys, resgrid.planning.trace, resgrid.planning.blend, resgrid.circuit.solve, resgrid.core.compiler\n"
        "import resgrid.scene, resgrid.spice\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import resgrid.plot.pictures\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_pictures_in_docs_are_small_and_generated_by_the_script() -> None:
    docs = Path(__file__).parents[2] / "docs"
    script = runpy.run_path(str(docs / "pictures.py"))
    drawn = {"rooms.png", "blend_k.png", "motion.webp", *(f"live_{name}.webp" for name in script["PAGES"])}
    kept = {file.name for file in docs.iterdir() if file.suffix in {".png", ".webp"}}
    assert kept == drawn
    assert all((docs / name).stat().st_size < 1.5e6 for name in kept)
