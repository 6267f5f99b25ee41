"""`reconstruct splat`: Gaussians made of depth maps and optimized, on a moment that is known exactly."""

import gzip
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import read_image
from reconstruction.common.worker_pool import worker_pool
from reconstruction.depth.backdrop import find_backdrop
from reconstruction.depth.seen_moment import SeenInstant
from reconstruction.method.moments import read_mask
from reconstruction.method.picture_quality import psnr
from reconstruction.methods.splat import optimization
from reconstruction.methods.splat.gaussians import (
    Gaussians,
    Projected,
    draw,
    make_gaussians,
    project,
    quaternions,
    read_splats,
    render_gaussians,
    write_splats,
    write_spz,
)
from reconstruction.methods.splat.optimization import add_slopes, optimize
from reconstruction.methods.splat.splat_method import SplatMethod
from reconstruction.methods.splat.splat_run import _with_learned, middle_camera, optimize_moments
from reconstruction.scene.moving_pixels import write_masks
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import PERIOD_NS, Reconstruct
from tests.unit.reconstruction.depth.moments import BOARD_M, FOCAL, WALL_M, moment, seen, view_at
from tests.unit.reconstruction.depth.test_backdrop import before_blue, board_before_blue


def one_gaussian(x: float = 0.0, opacity: float = 0.8, size: float = 0.1, z: float = 2.0) -> Gaussians:
    """A sphere before the camera at the origin."""
    return Gaussians(
        places=np.array([[x, 0, z]], np.float32),
        axes=np.eye(3, dtype=np.float32)[None],
        sizes=np.full((1, 3), size, np.float32),
        colours=np.array([[0.2, 0.4, 0.9]], np.float32),
        opacities=np.array([opacity], np.float32),
        pixels=np.zeros(1, np.int64),
    )


def joined(*given: Gaussians) -> Gaussians:
    return Gaussians(**{name: np.concatenate([vars(one)[name] for one in given]) for name in vars(given[0])})


def drawn(gaussians: Gaussians, grown: float = 0.0) -> tuple[Projected, Array, Array]:
    with worker_pool() as pool:
        logs = np.full(len(gaussians), grown, np.float32)
        projected = project(gaussians, view_at(0.0), logs, pool)
        return projected, *draw(projected, gaussians.colours, gaussians.opacities, pool, 3)


def test_a_gaussian_is_drawn_as_its_formula_says() -> None:
    _, picture, passes = drawn(one_gaussian())
    y, x = np.mgrid[:90, :120]
    away = (x - 59.5) ** 2 + (y - 44.5) ** 2
    spread = (FOCAL * 0.1 / 2) ** 2 + 0.3
    alpha = np.where(away < 9 * spread, 0.8 * np.exp(-away / spread / 2), 0)
    alpha[alpha < 1 / 255] = 0
    # A sphere off the axis is an ellipse; here it is too small to tell.
    assert np.abs(1 - passes - alpha).max() < 5e-3
    assert np.abs(picture - alpha[..., None] * [0.2, 0.4, 0.9]).max() < 5e-3


def test_the_nearer_one_hides_the_farther_in_any_order() -> None:
    near, far = one_gaussian(opacity=0.99, size=0.15), one_gaussian(z=3.0)
    near.colours[:] = 1.0
    for pair in ((near, far), (far, near)):
        _, picture, _ = drawn(joined(*pair))
        assert picture[44, 59].min() > 0.97


def test_what_is_behind_the_camera_or_beside_the_picture_is_not_drawn() -> None:
    for hidden in (one_gaussian(z=-2.0), one_gaussian(x=4.0)):
        assert not drawn(hidden)[1].any()


def test_gradients_are_those_of_the_picture() -> None:
    gaussians = joined(one_gaussian(0.0), one_gaussian(0.08, 0.6, z=2.5), one_gaussian(-0.1, 0.5, 0.15))
    target = np.random.default_rng(0).random((90, 120, 3)).astype(np.float32)

    def loss(colours: Array, opacities: Array, grown: Array) -> float:
        with worker_pool() as pool:
            projected = project(gaussians, view_at(0.0), grown, pool)
            picture, _ = draw(projected, colours, opacities, pool, 2)
        return float(((picture.astype(float) - target) ** 2).sum())

    values = [gaussians.colours, gaussians.opacities, np.zeros(3, np.float32)]
    projected, picture, passes = drawn(gaussians)
    slopes = [np.zeros_like(one) for one in values]
    errors = 2 * (picture - target)
    for rows in ((0, 50), (50, 90)):
        values_seen = (gaussians.opacities, gaussians.colours), (picture, errors, passes)
        add_slopes(projected, *values_seen, tuple(slopes), rows)
    # What a larger size adds at the cut-off border has no gradient.
    for number, (step, near) in enumerate([(1e-2, 0.02), (1e-2, 0.02), (1e-2, 0.2)]):
        for place in np.ndindex(values[number].shape):
            ends = []
            for sign in (-1, 1):
                changed = [one.copy() for one in values]
                changed[number][place] += sign * step
                ends.append(loss(*changed))
            assert slopes[number][place] == pytest.approx((ends[1] - ends[0]) / 2 / step, rel=near, abs=0.3)


def test_optimizing_makes_a_held_out_view_better() -> None:
    cameras, view = moment(), view_at(-0.1, 0.02)
    gaussians, truth = make_gaussians(cameras), seen(view).colours
    before = psnr(render_gaussians(gaussians, view), truth)
    better, kept = optimize(gaussians, cameras, 5)
    assert psnr(render_gaussians(better, view), truth) > before + 2
    assert kept.sum() == len(better)


def test_all_cameras_see_neighbours_on_a_surface_in_the_same_order() -> None:
    """A wall is ordered from its left to its right in one camera, and the other way round in another."""
    camera = seen(view_at(0.0))
    noise = np.random.default_rng(4).integers(0, 256, camera.colours.shape).astype(np.uint8)
    wall = np.full_like(camera.depth, WALL_M)
    gaussians = make_gaussians({"middle": replace(camera, colours=noise, depth=wall)})
    left, right = (view_at(side, turn=side / 3) for side in (-0.6, 0.6))
    depths = [(gaussians.places @ view.rotation.T + view.translation)[:, 2] for view in (left, right)]
    beside = np.flatnonzero(np.diff(gaussians.pixels % camera.view.width) == 1)
    nearer = [depth[beside] < depth[beside + 1] for depth in depths]
    assert np.mean(nearer[0] == nearer[1]) == 1


def test_fine_texture_is_not_blurred() -> None:
    """With steps of one length, and sizes that changed half as fast, the PSNR was 37.4 dB."""
    plain = moment()["left"]
    noise = np.random.default_rng(3).integers(0, 256, plain.colours.shape).astype(np.uint8)
    fine = {"left": replace(plain, colours=cv2.GaussianBlur(noise, (0, 0), 0.8))}
    splat, _ = optimize(make_gaussians(fine), fine, 20)
    assert psnr(render_gaussians(splat, plain.view), fine["left"].colours) > 38.5


def test_an_iteration_visits_each_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras, visits = moment(), list[View]()

    def seen_from(gaussians: Gaussians, view: View, *given: Any) -> Projected:
        visits.append(view)
        return project(gaussians, view, *given)

    monkeypatch.setattr(optimization, "project", seen_from)
    optimize(make_gaussians(cameras), cameras, 2)
    assert visits == 2 * [one.view for one in cameras.values()]


def test_what_no_map_holds_has_the_backdrops_colour() -> None:
    """Before, the fill of gaps smeared the board over it."""
    cameras, view = board_before_blue(), view_at(-0.1, 0.02)
    truth = before_blue(seen(view)).colours
    splat, _ = optimize(make_gaussians(cameras, find_backdrop(cameras)), cameras, 2)
    assert psnr(render_gaussians(make_gaussians(cameras), view), truth) < 20
    assert psnr(render_gaussians(splat, view), truth) > 30


def test_the_middle_of_four_cameras_judges_the_splat() -> None:
    views = {name: view_at(x) for name, x in (("a", -2.0), ("b", 0.2), ("c", 1.0), ("d", 2.0))}
    assert middle_camera(views) == "b"
    del views["a"]
    assert middle_camera(views) == ""


def test_surfaces_that_two_cameras_see_are_made_once() -> None:
    number = len(make_gaussians(moment()))
    assert 90 * 120 < number < 1.9 * 90 * 120


def test_plain_blocks_become_one_gaussian_each() -> None:
    cameras = {"left": moment()["left"]}
    cameras["left"].colours[:] = 90
    assert len(make_gaussians(cameras)) < 0.35 * 90 * 120
    made = render_gaussians(make_gaussians(cameras), cameras["left"].view)
    assert np.abs(made.astype(int) - 90).max() <= 3


def test_a_file_has_the_fields_of_3d_gaussian_splatting(tmp_path: Path) -> None:
    gaussians, _ = optimize(make_gaussians(moment()), moment(), 1)
    write_splats(tmp_path / "splat.ply", gaussians)
    head, _, body = (tmp_path / "splat.ply").read_bytes().partition(b"end_header\n")
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property float")]
    assert names == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    assert len(body) == 68 * len(gaussians)
    rows = np.frombuffer(body, "<f4").reshape(-1, 17)
    assert 0.5 + 0.28209479 * rows[:, 6:9] == pytest.approx(gaussians.colours[:, ::-1], abs=1e-5)
    assert np.linalg.norm(rows[:, 13:], axis=1) == pytest.approx(1, abs=1e-5)
    again, view = read_splats(tmp_path / "splat.ply"), view_at(0.1)
    assert psnr(render_gaussians(again, view), render_gaussians(gaussians, view)) > 45


def test_spz_is_what_its_specification_says(tmp_path: Path) -> None:
    """Niantic's SPZ 2: its header; positions in 24 bits, right, up and back; one byte for all else."""
    gaussians = make_gaussians(moment())
    write_spz(tmp_path / "splat.spz", gaussians)
    data = gzip.decompress((tmp_path / "splat.spz").read_bytes())
    assert data[:12] == b"NGSP" + struct.pack("<II", 2, len(gaussians))
    degree, bits, flags, _ = data[12:16]
    assert (degree, flags) == (0, 0)
    body, number = np.frombuffer(data[16:], np.uint8), len(gaussians)
    assert len(body) == 19 * number
    low, middle, high = body[: 9 * number].reshape(number, 3, 3).astype(int).transpose(2, 0, 1)
    places = ((low | middle << 8 | high << 16) ^ 1 << 23) - (1 << 23)
    assert places / 2**bits * [1, -1, -1] == pytest.approx(gaussians.places, abs=1e-5)
    columns = body[9 * number :]
    assert columns[:number] / 255 == pytest.approx(gaussians.opacities, abs=0.003)
    colours = columns[number : 4 * number].reshape(number, 3)
    assert 0.5 + 0.28209479 / 0.15 * (colours / 255 - 0.5) == pytest.approx(
        gaussians.colours[:, ::-1], abs=0.004
    )
    sizes = columns[4 * number : 7 * number].reshape(number, 3)
    assert np.exp(sizes / 16 - 10) == pytest.approx(gaussians.sizes, rel=0.04)
    turns = columns[7 * number :].reshape(number, 3) / 127.5 - 1
    w = quaternions(gaussians.rotations)
    assert turns * [1, -1, -1] * np.where(w[:, :1] < 0, -1, 1) == pytest.approx(w[:, 1:], abs=0.006)
    assert (tmp_path / "splat.spz").stat().st_size < 0.3 * 68 * number


def test_quaternions_of_all_rotations() -> None:
    vectors = np.random.default_rng(0).normal(size=(200, 3)) * 2
    turns = np.array([cv2.Rodrigues(vector)[0] for vector in vectors])
    w, x, y, z = quaternions(turns).T
    columns = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    assert np.stack(columns, axis=1) == pytest.approx(turns[:, :, 0], abs=1e-6)
    assert 1 - 2 * (x * x + y * y) == pytest.approx(turns[:, 2, 2], abs=1e-6)


def test_what_stands_still_begins_with_what_was_learned() -> None:
    gaussians = make_gaussians(moment())
    gaussians = gaussians.chosen(np.argsort(gaussians.pixels, kind="stable"))
    better, kept = optimize(gaussians, moment(), 2)
    begun = _with_learned(gaussians, gaussians.chosen(kept), better)
    assert begun.chosen(kept).opacities == pytest.approx(better.opacities)
    assert begun.chosen(kept).sizes == pytest.approx(better.sizes, rel=1e-5)
    noisy = gaussians.chosen(np.arange(len(gaussians)))
    noisy.places[:] *= 1.0005
    assert (_with_learned(noisy, gaussians.chosen(kept), better).chosen(kept).places == better.places).all()
    moved = gaussians.chosen(np.arange(len(gaussians)))
    moved.places[:] += 0.3
    again = _with_learned(moved, gaussians.chosen(kept), better)
    assert (again.opacities == gaussians.opacities).all()


def test_what_a_mask_excludes_is_not_fitted() -> None:
    """Only the board is in front: no wall, no backdrop, and pictures that are black beside it."""
    masked = {camera: one.within(one.depth < 2.5) for camera, one in moment().items()}
    assert not masked["left"].colours[masked["left"].depth == 0].any()
    options = SplatMethod(iterations=2, masks="masks", all_cameras=True)
    ((_, splat),) = optimize_moments([SeenInstant(0, masked, {})], 1, options)
    assert 500 < len(splat) < 90 * 120 / 2
    assert splat.places[:, 2] == pytest.approx(BOARD_M, abs=0.015)
    ((_, before_black),) = optimize_moments([SeenInstant(0, masked, {})], 1, SplatMethod(iterations=2))
    assert before_black.places[:, 2].max() > 2 * BOARD_M


def test_masks_are_paired_with_cameras_by_their_labels(boards: Session, tmp_path: Path) -> None:
    scene = Scene.open(boards.folder)
    camera, *_ = scene.dataset.cameras
    width, height = scene.dataset.size(camera)
    mask = np.zeros((height, width), np.uint8)
    mask[:, : width // 2] = 255
    (tmp_path / camera.upper()).mkdir()
    cv2.imwrite(str(tmp_path / camera.upper() / "000000.png"), mask)
    assert (read_mask(scene, str(tmp_path), camera, 0) == (mask > 0)).all()
    with pytest.raises(BadInputError, match=r"000001\.png is missing"):
        read_mask(scene, str(tmp_path), camera, 1)


def test_a_mask_is_of_an_image_wherever_that_is_assigned(boards: Session, tmp_path: Path) -> None:
    """Masks have the names of the session's files, which corrected times do not change."""
    write_masks(Scene.open(boards.folder).motion, tmp_path / "masks")
    shifted = Scene.open(boards.folder, {"right": PERIOD_NS / 1e6})
    own = read_image(tmp_path / "masks" / "right" / "000002.png")[..., 0] > 127
    assert (read_mask(shifted, str(tmp_path / "masks"), "right", 3) == own).all()
    write_masks(shifted.motion, tmp_path / "again")
    names = sorted(path.name for path in (tmp_path / "again" / "right").iterdir())
    assert names == [f"{k:06d}.png" for k in range(4)]


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (("--instants", "7-9"), ExitCode.BAD_INPUT, "no instant"),
        (("--iterations", "-1"), ExitCode.USAGE, "--iterations"),
    ],
)
def test_what_cannot_be_is_said(
    reconstruct: Reconstruct, boards: Session, tmp_path: Path, options: tuple[str, ...], code: int, says: str
) -> None:
    done = reconstruct("splat", boards.folder, *options, "--out", tmp_path / "out")
    assert done.code == code
    assert says in done.err
    assert not (tmp_path / "out").exists()
