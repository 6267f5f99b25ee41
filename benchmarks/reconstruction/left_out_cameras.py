"""One instant of a calibrated session without each of its cameras, beside the picture which that one took.

    python -m benchmarks.reconstruction.left_out_cameras SESSION --instant 3
    python -m benchmarks.reconstruction.left_out_cameras SESSION --cameras left right --splats

Methods: the nearest camera's picture, turned and zoomed as a whole about the subject; all pictures blended
through their depth maps; with --splats, a Gaussian splat of 10 iterations. The last PSNR is of what another
camera saw.
"""

from pathlib import Path
from typing import Any

from benchmarks.reconstruction.novel_views import turned
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.common.errors import NotApplicableError
from reconstruction.depth.backdrop import find_backdrop
from reconstruction.depth.seen_moment import find_subject
from reconstruction.depth.view_blending import render
from reconstruction.method.moments import see_moments
from reconstruction.method.picture_quality import psnr, ssim
from reconstruction.methods.splat.gaussians import make_gaussians, render_gaussians
from reconstruction.methods.splat.optimization import optimize
from reconstruction.scene.scene import Scene

ITERATIONS = 10


def measure(scene: Scene, camera: str, instant: int, splats: bool) -> list[dict[str, Any]]:
    """Return a row of figures for each method of showing what a camera saw, from the others' pictures."""
    (seen,) = see_moments(scene, [instant], without=[camera])
    given = scene.views[camera]
    truth = given.undistort_image(scene.dataset.image(camera, instant))
    view, moment = given.undistorted, seen.moment
    blended = render(view, moment)
    pictures = {"turned": turned(view, moment, find_subject(moment)), "blended": blended.colours}
    if splats:
        splat, _ = optimize(make_gaussians(moment, find_backdrop(moment)), moment, ITERATIONS)
        pictures[f"splat, {ITERATIONS}"] = render_gaussians(splat, view)
    return [
        {
            "camera": camera,
            "method": method,
            "others": len(moment),
            "seen": float(blended.known.mean()),
            "psnr": psnr(picture, truth),
            "ssim": ssim(picture, truth),
            "seen_psnr": psnr(picture, truth, blended.known),
        }
        for method, picture in pictures.items()
    ]


def main() -> None:
    """Print the table of a session."""
    parser = new_parser(__doc__)
    parser.add_argument("session", type=Path, help="folder of a calibrated session")
    parser.add_argument("--instant", type=int, default=0, help="the instant (0)")
    parser.add_argument(
        "--cameras", nargs="*", metavar="NAME", help="leave out these, one after another (all)"
    )
    parser.add_argument("--splats", action="store_true", help="also splats")
    options = parser.parse_args()
    scene, rows = Scene.open(options.session), list[dict[str, Any]]()
    for camera in options.cameras or scene.dataset.cameras:
        try:
            rows += measure(scene, camera, options.instant, options.splats)
        except NotApplicableError as error:
            talk(f"without {camera}: {error}")
    columns = {
        "camera": ("left out", ""),
        "method": ("method", ""),
        "others": ("others", "d"),
        "seen": ("seen", ".0%"),
        "psnr": ("PSNR, dB", ".2f"),
        "ssim": ("SSIM", ".3f"),
        "seen_psnr": ("PSNR of what is seen", ".2f"),
    }
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], columns), as_json=options.json)


if __name__ == "__main__":
    main()
