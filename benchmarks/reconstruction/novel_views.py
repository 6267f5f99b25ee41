"""Views of a moment from places without a camera, beside the true picture.

    python -m benchmarks.reconstruction.novel_views            six held-out views of all scenes
    python -m benchmarks.reconstruction.novel_views jumper --seeds 5 --splats
    python -m benchmarks.reconstruction.novel_views "rods 4" "rods 3"     how many of seven rods are seen

A scene is rendered from its five cameras, with the noise of each seed, and from places between them, beyond
and above them, with little noise. Methods: the nearest camera's picture, turned and zoomed as a whole about
the subject; the same warped by its depth map; the mesh; all pictures blended through their maps; with
--splats, Gaussian splats. PSNR and SSIM are of the whole picture, the last PSNR of what moves with a margin
of 4 px. Simulated pictures.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction.novel_view_scenes import SHOTS, Held, take, true_views
from benchmarks.reconstruction.thin_scenes import count_rods
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.session.files.untrusted_files import read_arrays
from reconstruction import Multiview, open_session
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import load_open3d
from reconstruction.depth.backdrop import find_backdrop
from reconstruction.depth.seen_moment import Moment, SeenView, find_subject
from reconstruction.depth.view_blending import render
from reconstruction.method.picture_quality import psnr, ssim
from reconstruction.methods.splat.gaussians import make_gaussians, render_gaussians
from reconstruction.methods.splat.optimization import optimize
from reconstruction.reconstructed_session import ReconstructedSession

MARGIN_PX = 9
ITERATIONS = 2, 5, 10


def nearest_camera(view: View, moment: Moment) -> str:
    """Return the camera that is nearest to a view."""
    return min(moment, key=lambda name: float(np.linalg.norm(moment[name].view.centre - view.centre)))


def _blended(view: View, moment: Moment) -> Array:
    return render(view, moment).colours


def turned(view: View, moment: Moment, subject: Array) -> Array:
    """Return the nearest camera's picture, moved as a whole so that a plane through the subject stays."""
    seen = moment[nearest_camera(view, moment)]
    depth = float((view.rotation @ subject + view.translation)[2])
    rotation = seen.view.rotation @ view.rotation.T
    shift = seen.view.translation - rotation @ view.translation
    plane = rotation + np.outer(shift, [0, 0, 1]) / depth
    to = seen.view.matrix @ plane @ np.linalg.inv(view.matrix)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = view.width, view.height
    return np.asarray(
        cv2.warpPerspective(seen.colours, to, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    )


def mesh_picture(file: Path, view: View) -> Array:
    """Return what a view sees of a mesh with colours, uint8 BGR; holes are filled from around."""
    o3d = load_open3d()
    mesh = o3d.t.io.read_triangle_mesh(str(file))
    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    scene.add_triangles(mesh)
    rays = np.column_stack([view.grid(), np.ones(view.width * view.height)]) @ np.linalg.inv(view.matrix).T
    rays = rays @ view.rotation
    origin = np.broadcast_to(view.centre, rays.shape)
    hits = scene.cast_rays(o3d.core.Tensor(np.hstack([origin, rays]).astype(np.float32)))
    hit = np.isfinite(hits["t_hit"].numpy())
    corners = mesh.triangle.indices.numpy()[hits["primitive_ids"].numpy()[hit]]
    second, third = hits["primitive_uvs"].numpy()[hit].T
    weights = np.column_stack([1 - second - third, second, third])[..., None]
    colours = mesh.vertex.colors.numpy()
    scale = 1 if colours.dtype == np.uint8 else 255
    picture = np.zeros((view.width * view.height, 3), np.uint8)
    picture[hit] = np.rint(scale * (colours[corners] * weights).sum(axis=1))[:, ::-1]
    holes = (~hit).astype(np.uint8).reshape(view.height, view.width)
    return np.asarray(cv2.inpaint(picture.reshape(view.height, view.width, 3), holes, 3, cv2.INPAINT_TELEA))


def _moment(session: ReconstructedSession, folder: Path) -> Moment:
    """Read the maps of a session's only instant."""
    calibration = session.calibration()
    assert calibration is not None
    moment = {}
    for name, lens in calibration.cameras.items():
        view = View.from_calibration(lens, lens.width, lens.height)
        maps = read_arrays(folder / "depth" / f"{name}.npz")
        colours = view.undistort_image(session.frame(name, 0).bgr())
        depth, normals = (maps[which].astype(np.float32) for which in ("depth", "normals"))
        moment[name] = SeenView(view.undistorted, colours, depth, normals)
    return moment


def measure(
    shot: str, seed: int, held: dict[str, Held], scratch: Path, pictures: Path | None, splats: Sequence[int]
) -> list[dict[str, Any]]:
    """Return a row of figures for each held-out view and method; write the pictures if a folder is given."""
    session = open_session(take(shot, seed, scratch))
    begun = time.process_time()
    made = session.multiview(Multiview(instant=0, mesh=True, workspace=False))
    talk(f"{shot}, seed {seed}: maps and mesh {time.process_time() - begun:.1f} CPU-s")
    moment = _moment(session, made.folder)
    subject = find_subject(moment)
    optimized, seconds = {}, {}
    for iterations in splats:
        begun = time.process_time()
        optimized[iterations], _ = optimize(make_gaussians(moment, find_backdrop(moment)), moment, iterations)
        seconds[f"splat, {iterations}"] = time.process_time() - begun
        talk(f"{len(optimized[iterations]):,} Gaussians, {iterations} iterations: {seconds}")
    rows = list[dict[str, Any]]()
    for name, one in held.items():
        nearest = nearest_camera(one.view, moment)
        methods: dict[str, Callable[[], Array]] = {
            "turned": partial(turned, one.view, moment, subject),
            "one warped": partial(_blended, one.view, {nearest: moment[nearest]}),
            "mesh": partial(mesh_picture, made.folder / "mesh.ply", one.view),
            "blended": partial(_blended, one.view, moment),
            **{f"splat, {n}": partial(render_gaussians, of, one.view) for n, of in optimized.items()},
        }
        moving = cv2.dilate(one.moving.astype(np.uint8), np.ones((MARGIN_PX, MARGIN_PX), np.uint8)) > 0
        if pictures:
            _save(pictures, f"{shot}_{name}_true", one.picture)
        for method, draw in methods.items():
            begun = time.process_time()
            drawn = draw()
            own_s = seconds.get(method, time.process_time() - begun)
            if pictures:
                _save(pictures, f"{shot}_{name}_{method}", drawn)
            quality = {"psnr": psnr(drawn, one.picture), "ssim": ssim(drawn, one.picture)}
            moves = psnr(drawn, one.picture, moving) if moving.any() else None
            about = {"shot": shot, "seed": seed, "view": name, "method": method}
            seen = None if one.without is None else count_rods(drawn, one.picture, one.without, one.depth)
            rows.append({**about, **quality, "moving_psnr": moves, "seconds": own_s, "rods": seen})
    return rows


def _save(folder: Path, name: str, picture: Array) -> None:
    cv2.imwrite(str(folder / f"{name}.png".replace(" ", "_")), picture)


KINDS = ("psnr", "ssim", "moving_psnr", "seconds", "rods")


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the means of each scene and method over the seeds, of each view and of all."""
    found = []
    keys = dict.fromkeys((row["shot"], row["method"]) for row in rows)
    views = dict.fromkeys((row["shot"], row["view"]) for row in rows)
    for shot, method in keys:
        for view in [*(name for of, name in views if of == shot), "mean"]:
            own = [row for row in rows if (row["shot"], row["method"]) == (shot, method)]
            own = [row for row in own if view in (row["view"], "mean")]
            values = {kind: [row[kind] for row in own if row[kind] is not None] for kind in KINDS}
            means = {kind: float(np.mean(known)) if known else None for kind, known in values.items()}
            by_seed = [
                float(np.mean([row["psnr"] for row in own if row["seed"] == seed]))
                for seed in dict.fromkeys(row["seed"] for row in own)
            ]
            found.append(
                {"shot": shot, "view": view, "method": method, **means, "psnr_range": float(np.ptp(by_seed))}
            )
    return found


def main() -> None:
    """Print the table of the scenes."""
    parser = new_parser(__doc__)
    parser.add_argument("scenes", nargs="*", default=[*SHOTS], help=f"of {', '.join(SHOTS)} (all)")
    parser.add_argument("--seeds", type=int, default=1, help="seeds of the noise (1)")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write the first seed's pictures here")
    parser.add_argument("--splats", action="store_true", help="also splats of 2, 5 and 10 iterations")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for shot in options.scenes:
            held = true_views(shot)
            for seed in range(options.seeds):
                pictures = None if seed else options.pictures
                splats = ITERATIONS if options.splats else ()
                rows += measure(shot, seed, held, Path(scratch), pictures, splats)
    columns = {
        "shot": ("scene", ""),
        "view": ("view", ""),
        "method": ("method", ""),
        "psnr": ("PSNR, dB", ".2f"),
        "psnr_range": ("range of the seeds", ".2f"),
        "ssim": ("SSIM", ".3f"),
        "moving_psnr": ("PSNR of what moves", ".2f"),
        "seconds": ("CPU-s", ".2f"),
        "rods": ("rods seen", ".1f"),
    }
    report = {"rows": rows, "means": summary(rows)}
    print_report(report, lambda report: print_rows(report["means"], columns), as_json=options.json)


if __name__ == "__main__":
    main()
