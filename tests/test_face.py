"""The five tasks that the package is shown by, typed as anyone would type them."""

from __future__ import annotations

import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import yaml
from PIL import Image

import resgrid as rg

SCENES = Path(__file__).parent.parent / "examples" / "scenes"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def turned_map(here: Path) -> Path:
    """A ROS map of 12 x 12 m, turned by 0.5 rad around its origin, with a block in its middle."""
    grey = np.full((60, 60), 254, dtype=np.uint8)
    grey[22:38, 22:38] = 0
    Image.fromarray(grey).save(here / "map.pgm")
    words = {"image": "map.pgm", "resolution": 0.2, "origin": [-6.0, -6.0, 0.5], "negate": 0,
             "occupied_thresh": 0.65, "free_thresh": 0.196, "mode": "trinary"}  # fmt: skip
    (here / "map.yaml").write_text(yaml.safe_dump(words))
    return here / "map.yaml"


def test_a_path_on_my_map(turned_map: Path) -> None:
    scene = rg.read_scene("map.yaml", goal=(-5.2, 2.5))
    path = rg.plan(scene).path((-4.0, -3.0))
    rg.write_path(path, "path.yaml")
    picture = rg.draw(path)
    assert path.outcome == rg.Outcome.REACHED
    rg.certify(path)
    assert path.points[0] == pytest.approx((-4.0, -3.0))
    assert np.hypot(*(path.points[-1] - (-5.2, 2.5))) < 0.2
    written = yaml.safe_load(Path("path.yaml").read_text())
    last = written["poses"][-1]["pose"]["position"]
    assert (last["x"], last["y"]) == pytest.approx(tuple(path.points[-1]))
    assert picture.has_data()
    plt.close("all")


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
def test_a_chip_and_its_deck(here: Path) -> None:
    scene = rg.read_scene(SCENES / "lesson.toml")
    space = rg.sample(scene)
    netlist = rg.compile_space(space, boundary="neumann")
    op = rg.solve(netlist)
    rg.write_spice(op, "chip.cir")
    assert rg.check_deck("chip.cir").agrees


def test_somebody_elses_deck(here: Path) -> None:
    Path("theirs.sp").write_text("* a divider\nV1 in 0 3\nR1 in out 2k\nR2 out 0 1k\n.end\n")
    deck = rg.read_spice("theirs.sp")
    assert not rg.check_rules(deck)
    op = rg.solve(deck)
    assert op.voltage[op.netlist.node_names.index("out")] == pytest.approx(1.0)


def test_is_this_chip_good_enough() -> None:
    study = rg.study(rg.read_scene(SCENES / "chip.toml"))
    assert study.settling().settle_time > 0
    assert study.noise().voltage.max() > 0
    assert len(study.sensitivity().ranked) > 0
    assert 0 <= study.yields(trials=64).share.value <= 1


def test_the_robot_moving() -> None:
    scene = rg.read_scene(SCENES / "chair.toml")
    run = rg.simulation(scene, k=0.98).run()
    assert run.ending in {rg.Ending.ARRIVED, rg.Ending.ENTERED}
    assert rg.draw(run).has_data()
    plt.close("all")
