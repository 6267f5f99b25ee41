"""`reconstruct splat`: Gaussians made of depth maps and optimized, on a moment that is known exactly."""

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.method.picture_quality import psnr
from reconstruction.methods.splat.gaussians import (
    make_gaussians,
    render_gaussians,
)
from reconstruction.methods.splat.optimization import optimize
from reconstruction.methods.splat.splat_run import _with_learned
from tests.unit.reconstruction.depth.moments import moment, seen, view_at
from tests.unit.reconstruction.methods.splat.test_splat import drawn


def test_surfaces_stay_opaque_however_long_noisy_pictures_are_optimized() -> None:
    cameras, view, noise = moment(), view_at(-0.1, 0.02), np.random.default_rng(0)
    for one in cameras.values():
        one.colours[:] = np.clip(one.colours + noise.normal(0, 12, one.colours.shape), 0, 255)
    gaussians, truth = make_gaussians(cameras), seen(view).colours
    gaussians = gaussians.chosen(np.argsort(gaussians.pixels, kind="stable"))
    first, kept = optimize(gaussians, cameras, 25)
    again = first
    for _ in range(4):  # the same moment again and again, each time with what was learned
        again, kept = optimize(_with_learned(gaussians, gaussians.chosen(kept), again), cameras, 25)
    for last in (again, optimize(gaussians, cameras, 100)[0]):
        assert drawn(last)[2].mean() < 0.1
        assert psnr(render_gaussians(last, view), truth) > psnr(render_gaussians(first, view), truth) - 0.2


def test_splats_of_two_instants(boards: Session) -> None:
    made = open_session(boards.folder).splat(instants=(0, 1), iterations=8, quick=True)
    assert [one.instant for one in made.result.instants] == [0, 1]
    assert min(one.psnr for one in made.result.instants) > 25
    lens = open_session(boards.folder).calibration().cameras["left"]
    own = open_session(boards.folder).frame("left", 1).bgr()
    assert psnr(made.render(lens, 1), own) > psnr(made.render(lens, 0), own)
    with pytest.raises(BadInputError, match="instant 2 has no splat"):
        made.gaussians(2)
