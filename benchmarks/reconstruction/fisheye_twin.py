"""A rig of five fisheyes, 130 degrees wide, beside the rig of the lenses for which they are redrawn.

    python -m benchmarks.reconstruction.fisheye_twin             board, depth, views and splat (3 min)
    python -m benchmarks.reconstruction.fisheye_twin --only board
    python -m benchmarks.reconstruction.fisheye_twin --only view --scale 1

Both rigs are rendered at the same places; the still life of `rendered_rigs`. `board`: `calibrate --from
board` from pictures of a ChArUco board, rendered too, 640x480 px. `view`, at half the size: depth within 2 %
of the truth where the redrawn images see, also of what another camera sees, and the PSNR of views and splats
from places between, above and beyond the cameras. The third rig is the second one with as many pixels in the
field as the fisheyes have there: what it loses to the second one is pixels, not the redrawing. At half the
size pixels decide (view 1.3 dB below the second rig, 0.4 above the third); at the full one (`--scale 1`) the
first two are equal within 0.2 dB. Simulated.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from benchmarks.reconstruction.rendered_rigs import EXPOSURE_NS, Placed, light_of, make_stage, place_view
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.board.boards import DEFAULT_BOARD
from capture_app.plugins.cameras.sim.rendering import layers as still
from capture_app.plugins.cameras.sim.rendering.scene import develop
from capture_app.session.exporting.pinhole import straight_lens
from capture_app.session.files.untrusted_files import read_arrays
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.lens import Lens, lens_of
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction import Multiview, open_session
from reconstruction.common.geometry import Array, View
from reconstruction.depth.backdrop import find_backdrop
from reconstruction.depth.seen_moment import SeenView
from reconstruction.depth.view_blending import render
from reconstruction.method.picture_quality import psnr
from reconstruction.methods.splat.gaussians import make_gaussians, render_gaussians
from reconstruction.methods.splat.optimization import optimize
from reconstruction.scene.calibration.board_calibration import LensModel
from reconstruction.scene.calibration_run import CalibrateOptions, CalibrationSource, calibrate
from reconstruction.scene.scene import Scene
from tests.facts import make_facts

SIZE = 640, 480
FISHEYE: dict[str, Any] = {
    "width": SIZE[0],
    "height": SIZE[1],
    "fx": 282.0,
    "fy": 282.0,
    "cx": 321.3,
    "cy": 237.6,
    "model": "fisheye",
    "distortion": (-0.02, 0.004, -0.001, 0.0003),
}
RIG = tuple(Placed(8.0 * k, 10.0 + 2 * (k % 2), 1.3) for k in (-2, -1, 0, 1, 2))
HELD = tuple(Placed(*place, 1.3) for place in ((-12.0, 11.0), (4.0, 11.0), (0.0, 18.0), (20.0, 11.0)))
"""Places of held-out views: two between cameras, one above and one beyond them."""
NOISE_MEANS, SAMPLES, BOARDS, ITERATIONS, SQUARE_PX = 8, 4, 20, 5, 70
SAME_DEPTH = 0.02
"""Maximum relative difference of the depth that another camera sees of a point that is not occluded."""
RIGS = "fisheye", "perspective", "as-many-pixels"
COLUMNS = {
    "rig": ("rig", ""),
    "within_2pct": ("depth within 2 %", ".1%"),
    "least": ("worst camera", ".1%"),
    "seen": ("seen by two", ".1%"),
    "seen_within_2pct": ("of these within 2 %", ".1%"),
    "view": ("view, dB", ".2f"),
    "splat": ("splat, dB", ".2f"),
}


@dataclass(frozen=True)
class LensView(still.View):
    """A camera of the renderer with any lens."""

    lens: Lens | None = None

    def directions(self, right: float = 0.0, down: float = 0.0) -> Array:
        """Return world directions (H, W, 3) of unit depth through the pixels, offset by part of a pixel."""
        assert self.lens is not None
        columns, rows = np.meshgrid(np.arange(self.width) + right, np.arange(self.height) + down)
        rays = self.lens.rays(np.column_stack([columns.ravel(), rows.ravel()]))
        ahead = np.column_stack([rays, np.ones(len(rays))]) @ self.rotation
        return np.asarray(ahead.reshape(self.height, self.width, 3), np.float32)


def placed(number: int, place: Placed, scale: float = 1.0) -> tuple[LensView, CameraCalibration]:
    """Return a fisheye at a place, with images of the full size times `scale`."""
    view = place_view(f"cam{number:02d}", place, 1.0)
    pose = view.calibration()
    lens = CameraCalibration(rotation=pose.rotation, translation=pose.translation, **FISHEYE)
    lens = resized(lens, scale)
    return with_lens(view, lens), lens


def resized(lens: CameraCalibration, scale: float) -> CameraCalibration:
    """Return a lens with images of its size times `scale`."""
    size = round(lens.width * scale), round(lens.height * scale)
    matrix = lens.matrix(*size)
    changes = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    floats = {key: float(value) for key, value in changes.items()}
    return msgspec.structs.replace(lens, width=size[0], height=size[1], **floats)


def with_lens(view: still.View, lens: CameraCalibration) -> LensView:
    """Return the renderer's camera with a lens at the same pose."""
    pose = view.rotation, view.translation
    return LensView(view.name, lens.width, lens.height, lens.fx, *pose, lens_of(lens))


def picture_of(view: LensView, seeds: range) -> Array:
    """Render what a camera sees, the mean of an exposure with the noise of each seed."""
    light = light_of(view, make_stage("still life")[0], SAMPLES)
    shots = [develop(light, EXPOSURE_NS, np.random.default_rng(seed)).astype(float) for seed in seeds]
    return np.asarray(np.rint(np.mean(shots, axis=0)), np.uint8)


def write_session(
    folder: Path, name: str, pictures: list[dict[str, Array]], cameras: Mapping[str, CameraCalibration]
) -> Session:
    """Write a session of instants, with its calibration unless `cameras` is empty."""
    writer, period_ns = SessionWriter.create(folder, name), 33_333_333
    for instant, images in enumerate(pictures):
        for camera, image in images.items():
            data = cv2.imencode(".png", image)[1].tobytes()
            writer.add_image(
                data, camera=camera, instant=instant, leader_ns=instant * period_ns, suffix=".png"
            )
    if cameras:
        writer.set_calibration(Calibration(cameras=dict(cameras), source="simulated"))
    burst = BurstRecord(instants_ns=tuple(k * period_ns for k in range(len(pictures))), period_ns=period_ns)
    height, width = next(iter(pictures[0].values())).shape[:2]
    facts = make_facts(width=width, height=height)
    return writer.finish([CameraRecord(name=c, facts=facts) for c in pictures[0]], burst, [], "simulated")


def unused_part(fisheye: CameraCalibration) -> float:
    """Return the fraction of a fisheye's pixels that `straight_lens` does not see."""
    lens, straight = lens_of(fisheye), lens_of(straight_lens(fisheye))
    size = np.array([fisheye.width, fisheye.height])
    across, down = np.meshgrid(*(np.linspace(0, side - 1, 60) for side in size))
    pixels = np.column_stack([across.ravel(), down.ravel()])
    seen = straight.project(lens.rays(pixels))
    return 1 - float((lens.known(pixels) & (seen >= -0.5).all(1) & (seen <= size - 0.5).all(1)).mean())


def measure_rig(rig: str, folder: Path, scale: float) -> dict[str, Any]:
    """Return a row of figures of one of the rigs."""
    fisheyes = [placed(number, place, scale) for number, place in enumerate(RIG)]
    cameras = {view.name: lens for view, lens in fisheyes}
    if rig != "fisheye":
        cameras = {name: straight_lens(lens) for name, lens in cameras.items()}
    if rig == "as-many-pixels":
        used = 1 - unused_part(fisheyes[0][1])
        cameras = {name: resized(lens, used**0.5) for name, lens in cameras.items()}
    views = {view.name: with_lens(view, cameras[view.name]) for view, _ in fisheyes}
    pictures = {name: picture_of(view, range(n, n + 1)) for n, (name, view) in enumerate(views.items())}
    session = open_session(write_session(folder, rig, [pictures], cameras).folder)
    made = session.multiview(Multiview(instant=0, mesh=False, workspace=False))
    scene = Scene.open(session.folder)
    moment = dict[str, SeenView]()
    errors, truths = dict[str, Array](), dict[str, tuple[LensView, Array]]()
    for view, lens in fisheyes:
        maps = read_arrays(made.folder / "depth" / f"{view.name}.npz")
        depth, normals = (maps[which].astype(np.float32) for which in ("depth", "normals"))
        own = scene.views[view.name].undistorted
        moment[view.name] = SeenView(own, scene.dataset.image(view.name, 0), depth, normals)
        redrawn = with_lens(view, straight_lens(lens) if rig == "fisheye" else cameras[view.name])
        truth, _ = still.cast_depth(redrawn, make_stage("still life")[0], redrawn.directions())
        errors[view.name] = np.abs(depth / np.where(truth > 0, truth, np.inf) - 1)
        truths[view.name] = redrawn, truth
    seen = {name: seen_by_another(name, truths) for name in truths}
    within = [float((errors[name][truth > 0] < 0.02).mean()) for name, (_, truth) in truths.items()]
    gaussians, _ = optimize(make_gaussians(moment, find_backdrop(moment)), moment, ITERATIONS)
    found = dict[str, list[float]](view=[], splat=[])
    for number, place in enumerate(HELD):
        view, lens = placed(number, place, scale)
        straight = straight_lens(lens)
        true = picture_of(with_lens(view, straight), range(100, 100 + NOISE_MEANS))
        from_here = View.from_calibration(straight, straight.width, straight.height)
        found["view"].append(psnr(render(from_here, moment).colours, true))
        found["splat"].append(psnr(render_gaussians(gaussians, from_here), true))
        talk(
            f"{rig}, {place.round_deg:g}, {place.up_deg:g} degrees: "
            + str({k: v[-1] for k, v in found.items()})
        )
    means = {name: float(np.mean(values)) for name, values in found.items()}
    of_seen = [float((errors[name][seen[name]] < 0.02).mean()) for name in truths]
    share = [float(seen[name][truth > 0].mean()) for name, (_, truth) in truths.items()]
    depths = {"within_2pct": within, "seen": share, "seen_within_2pct": of_seen}
    return {"rig": rig, "least": min(within), **{k: float(np.mean(v)) for k, v in depths.items()}, **means}


def seen_by_another(name: str, truths: Mapping[str, tuple[LensView, Array]]) -> Array:
    """Return which pixels with a true depth another camera sees too, in its redrawn image and unoccluded."""
    view, truth = truths[name]
    points = view.centre + view.directions() * truth[..., None]
    found = np.zeros(truth.shape, bool)
    for other, depth in (of for which, of in truths.items() if which != name):
        there = points @ other.rotation.T + other.translation
        ahead = there[..., 2] > 0
        assert other.lens is not None
        at = other.lens.project(
            (there[..., :2] / np.where(ahead, there[..., 2], 1)[..., None]).reshape(-1, 2)
        )
        columns, rows = np.rint(at).astype(int).reshape(*truth.shape, 2).transpose(2, 0, 1)
        inside = ahead & (columns >= 0) & (rows >= 0) & (columns < other.width) & (rows < other.height)
        shown = depth[rows.clip(0, other.height - 1), columns.clip(0, other.width - 1)]
        found |= inside & (np.abs(shown / np.where(ahead, there[..., 2], 1) - 1) < SAME_DEPTH)
    return found & (truth > 0)


@cache
def board_rays() -> list[Array]:
    """Return four rays of each pixel, from four places in it, in the camera's frame (n, 3)."""
    lens = lens_of(placed(0, RIG[0])[1])
    grids = [
        np.meshgrid(np.arange(SIZE[0]) + right, np.arange(SIZE[1]) + down)
        for right in (-0.25, 0.25)
        for down in (-0.25, 0.25)
    ]
    rays = [lens.rays(np.column_stack([columns.ravel(), rows.ravel()])) for columns, rows in grids]
    return [np.column_stack([ray, np.ones(len(ray))]) for ray in rays]


def board_picture(lens: CameraCalibration, turn: Array, middle: Array, noise: np.random.Generator) -> Array:
    """Render the board, turned and with its middle at a place in the rig, on white paper before grey."""
    margin, border = SQUARE_PX, cv2.BORDER_CONSTANT
    board = DEFAULT_BOARD.picture(SQUARE_PX)
    paper = np.asarray(cv2.copyMakeBorder(board, margin, margin, margin, margin, border, value=255))
    to_px = SQUARE_PX / DEFAULT_BOARD.square_m
    rotation, translation = np.array(lens.rotation), np.array(lens.translation)
    start = (-rotation.T @ translation - middle) @ turn
    shades = []
    for rays in board_rays():
        ahead = rays @ (rotation @ turn)
        away = -start[2] / ahead[:, 2]
        at = (start[:2] + away[:, None] * ahead[:, :2]) * to_px + np.array(paper.shape[::-1]) / 2 - 0.5
        at[away <= 0] = -SQUARE_PX
        xs, ys = np.ascontiguousarray(at.T.astype(np.float32)).reshape(2, SIZE[1], SIZE[0])
        shades.append(cv2.remap(paper, xs, ys, cv2.INTER_LINEAR, borderValue=110))
    grey = 20 + 0.8 * np.mean(shades, axis=0) + noise.normal(0, 2, SIZE[::-1])
    return np.asarray(np.repeat(grey.clip(0, 255)[..., None], 3, axis=2), np.uint8)


def measure_board(folder: Path, lens_model: LensModel) -> list[dict[str, Any]]:
    """Return each camera's errors of a calibration from a board."""
    cameras = {view.name: lens for view, lens in (placed(n, place) for n, place in enumerate(RIG))}
    noise, pictures = np.random.default_rng(3), []
    for number in range(BOARDS):
        near = list(cameras.values())[number % len(cameras)]
        to_rig = np.array(near.rotation).T
        angles = noise.uniform((-0.6, -0.6, -0.4), (0.6, 0.6, 0.4))
        turn = to_rig @ cv2.Rodrigues(angles)[0]
        away = noise.uniform(0.2, 0.45)
        there = away * np.array([*noise.uniform((-1.4, -0.9), (1.4, 0.9)), 1.0])
        at = to_rig @ (there - np.array(near.translation))
        pictures.append({name: board_picture(lens, turn, at, noise) for name, lens in cameras.items()})
    session = write_session(folder, "board", pictures, {})
    made = calibrate(
        session.folder, CalibrateOptions(source=CalibrationSource.BOARD, lens=lens_model, keep=False)
    )
    found = Session.open(session.folder).calibration()
    assert found is not None
    return [
        {
            "camera": name,
            "fisheye": found.cameras[name].is_fisheye,
            "focal": found.cameras[name].fx / lens.fx - 1,
            "stated": made.errors[name].focal_percent / 100,
            "centre_px": float(np.hypot(found.cameras[name].cx - lens.cx, found.cameras[name].cy - lens.cy)),
            "missing": ", ".join(made.missing),
        }
        for name, lens in cameras.items()
        if name in found.cameras
    ]


BOARD_COLUMNS = {
    "camera": ("camera", ""),
    "fisheye": ("fisheye", ""),
    "focal": ("focal length off", "+.2%"),
    "stated": ("stated", ".2%"),
    "centre_px": ("principal point off, px", ".2f"),
}


def main() -> None:
    """Print two tables, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--only", choices=("board", "view"), help="one of both")
    parser.add_argument("--scale", type=float, default=0.5, help="of the images of `view` (0.5)")
    parser.add_argument("--lens", choices=[*LensModel], default="auto", help="as of calibrate (auto)")
    asked = parser.parse_args()
    board, rows = list[dict[str, Any]](), list[dict[str, Any]]()
    with tempfile.TemporaryDirectory() as scratch:
        if asked.only != "view":
            board = measure_board(Path(scratch), LensModel(asked.lens))
            print_report(
                {"board": board}, lambda it: print_rows(it["board"], BOARD_COLUMNS), as_json=asked.json
            )
        if asked.only != "board":
            rows = [measure_rig(rig, Path(scratch), asked.scale) for rig in RIGS]
            print_report({"rows": rows}, lambda it: print_rows(it["rows"], COLUMNS), as_json=asked.json)


if __name__ == "__main__":
    main()
