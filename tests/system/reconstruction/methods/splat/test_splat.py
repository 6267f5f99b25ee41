"""`reconstruct splat`: Gaussians made of depth maps and optimized, on a moment that is known exactly."""

import json
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.common.geometry import View
from reconstruction.method.moments import see_moments
from reconstruction.method.picture_quality import psnr
from reconstruction.methods.splat.gaussians import (
    make_gaussians,
    read_splats,
    render_gaussians,
)
from reconstruction.methods.splat.optimization import optimize
from reconstruction.methods.splat.splat_run import _with_learned
from reconstruction.scene.scene import Scene
from tests.project import JUMPER
from tests.unit.reconstruction.conftest import Reconstruct
from tests.unit.reconstruction.depth.moments import moment, seen, view_at
from tests.unit.reconstruction.methods.splat.test_splat import drawn


def test_surfaces_stay_opaque_however_long_noisy_pictures_are_optimized() -> None:
    cameras, view, noise = moment(), view_at(-0.1, 0.02), np.random.default_rng(0)
    for one in cameras.values():
        one.colours[:] = np.clip(one.colours + noise.normal(0, 12, one.colours.shape), 0, 255)
    gaussians, truth = make_gaussians(cameras), seen(view).colours
    gaussians = gaussians.chosen(np.argsort(gaussians.pixels, kind="stable"))
    first, kept = optimize(gaussians, cameras, 8)
    again = first
    for _ in range(4):  # the same moment again and again, each time with what was learned
        again, kept = optimize(_with_learned(gaussians, gaussians.chosen(kept), again), cameras, 8)
    for last in (again, optimize(gaussians, cameras, 33)[0]):
        assert drawn(last)[2].mean() < 0.1
        assert psnr(render_gaussians(last, view), truth) > psnr(render_gaussians(first, view), truth) - 0.2


def test_splats_of_two_instants(boards: Session) -> None:
    made = open_session(boards.folder).splat(instants=(0, 1), iterations=4, quick=True)
    assert [one.instant for one in made.result.instants] == [0, 1]
    assert made.result.held_out == ""
    assert min(one.psnr for one in made.result.instants) > 25
    lens = open_session(boards.folder).calibration().cameras["left"]
    own = open_session(boards.folder).frame("left", 1).bgr()
    assert psnr(made.render(lens, 1), own) > psnr(made.render(lens, 0), own)
    with pytest.raises(BadInputError, match="instant 2 has no splat"):
        made.gaussians(2)


def test_the_number_that_is_printed_is_that_of_a_camera_left_out(
    reconstruct: Reconstruct, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = reconstruct("splat", JUMPER, "--instant", "3", "--quick", "--iterations", "1", "--out", out)
    result = json.loads((out / "splat.json").read_text())
    assert result["held_out"] == "cam00"
    assert "cam00" not in result["cameras"]
    (made,) = result["instants"]
    scene = open_session(JUMPER)
    lens = scene.calibration().cameras["cam00"]
    view = View.from_calibration(lens, lens.width, lens.height).undistorted
    drawn = render_gaussians(read_splats(out / made["file"]), view)
    assert made["held_out_psnr"] == pytest.approx(psnr(drawn, scene.frame("cam00", 3).bgr()), abs=0.02)
    assert f"at least {made['held_out_psnr']:.1f} dB to the picture of cam00" in done.out


def test_depth_of_low_confidence_gives_no_gaussians(boards: Session) -> None:
    scene = Scene.open(boards.folder)
    (every,), (sure,) = (see_moments(scene, [0], min_evidence=least) for least in (None, 1.7))
    for camera, one in every.moment.items():
        kept = sure.moment[camera].depth > 0
        assert 0.5 < kept.sum() / (one.depth > 0).sum() < 1
        assert (sure.moment[camera].depth[kept] == one.depth[kept]).all()
