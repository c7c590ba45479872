"""Frames of the replanning benchmark, and its contenders on small maps."""

import numpy as np
import pytest

from benchmarks.replanning import MAPS, ends_of, frames, measure, resgrid_fresh, resgrid_update


@pytest.mark.parametrize("make", MAPS.values(), ids=MAPS)
def test_frames_change_few_cells_and_keep_start_and_goal(make) -> None:
    free = make(256, np.random.default_rng(3))
    start, goal = ends_of(free)
    last = None
    for frame in frames(free, start, goal, 12, np.random.default_rng(4)):
        assert frame[start] and frame[goal]
        if last is not None:
            assert 0 < np.count_nonzero(frame != last) <= 0.01 * frame.size
        last = frame


@pytest.mark.parametrize("prepare", [resgrid_update, resgrid_fresh])
def test_contenders_find_free_paths(prepare) -> None:
    free = MAPS["pillars"](30, np.random.default_rng(5))
    start, goal = ends_of(free)
    seconds, figures = measure(prepare, frames(free, start, goal, 3, np.random.default_rng(6)), start, goal)
    assert len(seconds) == 3
    assert [found["success"] for found in figures] == [1.0]
    assert figures[0]["length"] >= 0.9
