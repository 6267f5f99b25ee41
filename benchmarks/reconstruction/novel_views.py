"""Views of a moment from places without a camera, beside the true picture.

    python -m benchmarks.reconstruction.novel_views            the sample session jumper, six held-out views
    python -m benchmarks.reconstruction.novel_views pinwheel

A scene is rendered once more from places between its cameras, beyond and above them, with little noise.
Methods: the nearest camera's picture, turned and zoomed as a whole about the subject; the same warped by its
depth map; all pictures blended through their maps; with --splats, Gaussian splats. PSNR and SSIM are of the
whole picture, the last PSNR of what moves with a margin of 4 px. Simulated pictures.
"""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.plugins.cameras.sim.rendering import scene as rendering
from capture_app.plugins.cameras.sim.scenes.stages import DEFINITIONS
from reconstruction.common.geometry import Array, View
from reconstruction.compare.moments import see_moments
from reconstruction.depth.camera_paths import find_subject
from reconstruction.depth.seen_moment import Moment
from reconstruction.depth.view_blending import render
from reconstruction.methods.splat.gaussians import make_gaussians, render_gaussians
from reconstruction.methods.splat.optimization import optimize
from reconstruction.reconstructed_session import open_session
from reconstruction.scores.picture_quality import psnr, ssim
from reconstruction.session.dataset import Dataset

SAMPLES = Path(__file__).parents[2] / "sample_sessions"
NOISE_MEANS = 12
"""Number of exposures whose mean is the true picture."""
MARGIN_PX = 9
Place = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Position of a camera and the point that it looks at, m."""
JUMPER: Mapping[str, Place] = {
    "between": ((0.0, -0.02, 0.0), (0.0, 0.13, 2.9)),
    "between right": ((0.17, -0.02, 0.01), (0.017, 0.13, 2.85)),
    "above": ((0.0, -0.16, 0.01), (0.0, 0.135, 2.85)),
    "above left": ((-0.15, -0.17, 0.015), (-0.01, 0.13, 2.8)),
    "beyond right": ((0.38, -0.05, 0.03), (0.03, 0.13, 2.8)),
    "beyond left": ((-0.38, -0.05, 0.03), (-0.03, 0.13, 2.8)),
}


class Held(NamedTuple):
    """A held-out view, its true picture, and where something moves (bool)."""

    view: View
    picture: Array
    moving: Array


def places(session: str) -> Mapping[str, Place]:
    """Return held-out places: two between cameras, two beyond and two above them."""
    if session == "jumper":
        return JUMPER
    return dict(_around(list(DEFINITIONS[_scene_of(session)].cameras.values())))


def _scene_of(session: str) -> str:
    """Return the name of the scene that a sample session shows."""
    calibration = open_session(SAMPLES / session).calibration()
    assert calibration is not None
    return calibration.source.rsplit(" ", 1)[1]


def _around(cameras: list[Place]) -> Iterator[tuple[str, Place]]:
    places = np.array(cameras)
    order = np.argsort(places[:, 0, 0])
    left, right, middle = places[order[0]], places[order[-1]], places.mean(axis=0)
    up = np.array([[0.0, -0.12, 0.0], [0.0, 0.0, 0.0]])
    found = {
        "between left": (left + middle) / 2,
        "between right": (right + middle) / 2,
        "beyond left": left + 0.2 * (left - right),
        "beyond right": right + 0.2 * (right - left),
        "above": middle + up,
        "above left": (left + middle) / 2 + up,
    }
    for name, (place, target) in found.items():
        yield name, (tuple(place.tolist()), tuple(target.tolist()))


def true_views(session: str, instant: int, names: Collection[str] = ()) -> dict[str, Held]:
    """Render the held-out views of an instant of a sample session: all, or those named."""
    opened = open_session(SAMPLES / session)
    record = opened.frame(next(iter(opened.cameras)), instant).record
    scene_name = _scene_of(session)
    facts = opened.camera(record.camera).facts
    assert record.exposure_start_ns is not None
    assert record.exposure_ns is not None
    shutter = record.exposure_start_ns, record.exposure_ns, facts.row_time_ns or 0
    held = {name: place for name, place in places(session).items() if not names or name in names}
    return render_places(scene_name, held, shutter)


def render_places(
    scene_name: str, held: Mapping[str, Place], shutter: tuple[int, int, int]
) -> dict[str, Held]:
    """Render a scene from places: start of the exposure, exposure and row time in ns."""
    scene = rendering.Scene(scene_name, replace(DEFINITIONS[scene_name], cameras=held))
    develop = rendering.develop

    def mean(light: Any, exposure_ns: int, rng: Any) -> Any:
        noisy = (develop(light, exposure_ns, np.random.default_rng(k)) for k in range(NOISE_MEANS))
        return np.rint(np.mean([one.astype(np.float32) for one in noisy], axis=0)).astype(np.uint8)

    found = {}
    for name in held:
        talk(f"rendering {name}")
        with patch.object(rendering, "develop", mean):
            picture = scene.render(name, *shutter, seed=1)
        _, _, moving = scene.ground_truth(name, *shutter)
        camera = scene.views[name].calibration()
        found[name] = Held(View.from_calibration(camera, camera.width, camera.height), picture, moving)
    return found


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


def measure(session: str, instant: int, pictures: Path | None, splats: Sequence[int]) -> list[dict[str, Any]]:
    """Return a row of figures for each held-out view and method; write the pictures if a folder is given."""
    held = true_views(session, instant)
    begun = time.process_time()
    (seen_instant,) = see_moments(Dataset.open(SAMPLES / session), [instant])
    moment = seen_instant.moment
    talk(f"maps: {time.process_time() - begun:.1f} CPU-s")
    subject = find_subject(moment)
    optimized = {}
    for iterations in splats:
        begun = time.process_time()
        optimized[iterations], _ = optimize(make_gaussians(moment), moment, iterations)
        size = len(optimized[iterations])
        talk(f"{size:,} Gaussians, {iterations} iterations: {time.process_time() - begun:.1f} CPU-s")
    rows = []
    for name, one in held.items():
        nearest = nearest_camera(one.view, moment)
        methods: dict[str, Callable[[], Array]] = {
            "turned": partial(turned, one.view, moment, subject),
            "one warped": partial(_blended, one.view, {nearest: moment[nearest]}),
            "blended": partial(_blended, one.view, moment),
            **{f"splat, {n}": partial(render_gaussians, of, one.view) for n, of in optimized.items()},
        }
        moving = cv2.dilate(one.moving.astype(np.uint8), np.ones((MARGIN_PX, MARGIN_PX), np.uint8)) > 0
        if pictures:
            cv2.imwrite(str(pictures / f"{session}_{name}_true.png".replace(" ", "_")), one.picture)
        for method, draw in methods.items():
            begun = time.process_time()
            drawn = draw()
            seconds = time.process_time() - begun
            if pictures:
                cv2.imwrite(str(pictures / f"{session}_{name}_{method}.png".replace(" ", "_")), drawn)
            quality = {"psnr": psnr(drawn, one.picture), "ssim": ssim(drawn, one.picture)}
            moves = psnr(drawn, one.picture, moving) if moving.any() else None
            rows.append({"view": name, "method": method, **quality, "moving_psnr": moves, "seconds": seconds})
    return rows


def main() -> None:
    """Print the table of one sample session."""
    parser = new_parser(__doc__)
    parser.add_argument("session", nargs="?", default="jumper", help="a sample session (jumper)")
    parser.add_argument("--instant", type=int, default=3, help="its instant (3)")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write the pictures here")
    parser.add_argument("--splats", action="store_true", help="also splats of 10, 25 and 50 iterations")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    splats = (10, 25, 50) if options.splats else ()
    rows = measure(options.session, options.instant, options.pictures, splats)
    names = dict.fromkeys(str(row["method"]) for row in rows)
    for method in names:
        own = [row for row in rows if row["method"] == method]
        kinds = ("psnr", "ssim", "moving_psnr", "seconds")
        known = {kind: [row[kind] for row in own if row[kind] is not None] for kind in kinds}
        means = {kind: float(np.mean(values)) if values else None for kind, values in known.items()}
        rows.append({"view": "mean", "method": method, **means})
    columns = {
        "view": ("view", ""),
        "method": ("method", ""),
        "psnr": ("PSNR, dB", ".2f"),
        "ssim": ("SSIM", ".3f"),
        "moving_psnr": ("PSNR of what moves", ".2f"),
        "seconds": ("CPU-s", ".2f"),
    }
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], columns), as_json=options.json)


if __name__ == "__main__":
    main()
