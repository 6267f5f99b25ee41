"""A real ball before two real cameras has a distance in pictures of one time, and none 4 frames apart.

A pair cannot see an offset by which the ball has moved along the epipolar line only: it then takes the
displacement for another distance. So every instant is judged by how far, measured, the ball has moved across.
"""

import json
from pathlib import Path

import pytest

from reconstruction.cli import run
from tests.system.reconstruction.methods.stereo.test_ball import (
    ACROSS_PX,
    Throw,
    throw,  # noqa: F401 - a fixture
)
from tests.unit.reconstruction.found import values


@pytest.mark.shared
@pytest.mark.timeout(1800)
def test_so_it_is_in_every_instant_with_the_ball_in_both_views(throw: Throw) -> None:
    assert len(throw.in_both) >= 27
    # Only at the top of its flight the ball moves along the rows.
    assert sum(throw.across_px(k) < ACROSS_PX for k in throw.in_both) <= 3
    throw.judge(throw.in_both)


@pytest.mark.shared
@pytest.mark.timeout(1800)
def test_the_tolerance_curve_on_it_falls(throw: Throw, tmp_path: Path) -> None:
    options = ("--pair", "L,R", "--max-instants", "8", "--out", str(tmp_path / "out"))
    assert run(["tolerance", str(throw.session.folder), *options]) == 0
    found = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert found["decreasing"]
    shares = {
        point["facts"]["offset_frames"]: values(point, "offset")["mover_coverage"]
        for point in found["points"]
    }
    assert shares.pop(0) > 0.6
    assert max(shares.values()) < 0.3
    assert found["timing"]["synchronized"]
