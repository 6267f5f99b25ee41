"""Errors that a calibration from a board states, beside the true ones.

    python -m benchmarks.reconstruction.board_errors             100 rigs of two cameras
    python -m benchmarks.reconstruction.board_errors --rigs 20

Each rig draws its lenses (three perspective ones, with and without tangential distortion, and fisheyes of 100
to 170 degrees), the part of the picture that the board covers (10 to 100 %), its tilt and the corners' noise.
One rig in four is upright, and one corner in two hundred is misread by some pixels. Corners are simulated; no
images are rendered, and blur counts as noise. A lens taken for the other model counts too: both have the same
focal length at the axis. A stated error is 95 %: it should contain the true one in 93 of
100, and be about twice the typical one.
"""

from typing import Any

import cv2
import numpy as np

from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.board.boards import DEFAULT_BOARD
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.scene.calibration.board_bundle import Sightings, adjust_bundle
from reconstruction.scene.calibration.board_calibration import calibrate_lens, relative_pose

PLACES = DEFAULT_BOARD.places.astype(float)
SIZE = 1280, 720
PERSPECTIVE = ((1400.0, (-0.05, 0.1)), (900.0, (-0.25, 0.08)), (640.0, (-0.3, 0.1)))
"""Focal length, px, and k1 and k2 of the perspective lenses."""
FEWEST = 8
COLUMNS = {
    "kind": ("lenses", ""),
    "rigs": ("cameras", "d"),
    "focal": ("focal length within", ".0%"),
    "focal_ratio": ("stated / true", ".1f"),
    "centre": ("principal point within", ".0%"),
    "turn": ("rotation within", ".0%"),
    "turn_ratio": ("stated / true", ".1f"),
    "move": ("position within", ".0%"),
    "fisheye": ("taken for fisheyes", ".0%"),
}


def main() -> None:
    """Measure all rigs and print the table."""
    parser = new_parser(__doc__, seed_of="the rigs")
    parser.add_argument("--rigs", type=int, default=100, help="number of rigs (100)")
    args = parser.parse_args()
    trials = [trial for number in range(args.rigs) for trial in measure_rig(args.seed, number)]
    rows = [summarize(kind, trials) for kind in ("plain", "tangential", "fisheye", "all")]
    print_report(
        {"rows": [row for row in rows if row["rigs"]], "trials": trials},
        lambda report: print_rows(report["rows"], COLUMNS),
        as_json=args.json,
    )


def summarize(kind: str, trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the fraction of cameras whose true errors are within the stated ones, and the ratio of both."""
    own = [trial for trial in trials if kind in (trial["kind"], "all")]
    row: dict[str, Any] = {"kind": kind, "rigs": len(own)}
    for name in ("focal", "centre", "turn", "move"):
        pairs = np.array([trial[name] for trial in own if trial[name] is not None]).reshape(-1, 2)
        row[name] = float((pairs[:, 0] <= pairs[:, 1]).mean()) if len(pairs) else None
        # A true error has half of its 95 % at its median of a normal distribution, times 1.45.
        row[f"{name}_ratio"] = (
            float(np.median(pairs[:, 1]) / (2.9 * np.median(pairs[:, 0]))) if len(pairs) else None
        )
    row["fisheye"] = float(np.mean([trial["taken_for_fisheye"] for trial in own])) if own else None
    return row


def measure_rig(seed: int, number: int) -> list[dict[str, Any]]:
    """Return the true and the stated errors of a rig's cameras."""
    rng = np.random.default_rng([seed, number])
    kind = ("plain", "tangential", "fisheye")[number % 3]
    size = SIZE[::-1] if number % 4 == 3 else SIZE
    truth = {
        "a": draw_view(rng, kind, size, np.eye(3), np.zeros(3)),
        "b": draw_view(
            rng, kind, size, cv2.Rodrigues(np.array([0, 0.2, 0.05]))[0], np.array([-0.3, 0, 0.02])
        ),
    }
    seen = draw_sightings(rng, truth)
    try:
        lenses = {
            name: calibrate_lens(
                name,
                size,
                DEFAULT_BOARD,
                [corners(at) for key, at in seen.items() if key[0] == name],
            )
            for name in truth
        }
        shared = [k for name, k in seen if name == "a" and ("b", k) in seen]
        both = [both_see(seen["a", k], seen["b", k]) for k in shared]
        both = [one for one in both if len(one[0]) >= FEWEST]
        points, *pixels = map(list, zip(*both, strict=True))
        pose = relative_pose(points, (pixels[0], pixels[1]), (lenses["a"], lenses["b"]))
    except (BadInputError, cv2.error, ValueError, np.linalg.LinAlgError) as error:
        talk(f"rig {number}: {error}")
        return []
    poses = {"a": (np.eye(3), np.zeros(3)), "b": pose}
    views = {name: View.from_lens(lens, size, *poses[name]) for name, lens in lenses.items()}
    found = adjust_bundle(views, seen)
    return [compare(kind, truth, found.views, name, found.errors[name]) for name in truth]


def compare(
    kind: str, truth: dict[str, View], found: dict[str, View], name: str, stated: Any
) -> dict[str, Any]:
    """Return pairs of the true and the stated error of a camera."""
    true, view = truth[name], found[name]
    turn, move = other_from_reference(found["a"], view)
    true_turn, true_move = other_from_reference(truth["a"], true)
    turned = float(np.degrees(np.linalg.norm(cv2.Rodrigues(turn @ true_turn.T)[0])))
    moved = 1000 * float(np.linalg.norm(turn.T @ move - true_turn.T @ true_move))
    focal = 100 * abs(view.focal / true.focal - 1)
    centre = float(np.abs(view.matrix[:2, 2] - true.matrix[:2, 2]).max())
    return {
        "kind": kind,
        "focal": (focal, stated.focal_percent),
        "centre": (centre, stated.centre_px),
        "turn": (turned, stated.turn_deg) if name != "a" else None,
        "move": (moved, stated.move_mm) if name != "a" else None,
        "taken_for_fisheye": view.is_fisheye,
    }


def draw_view(
    rng: np.random.Generator, kind: str, size: tuple[int, int], rotation: Array, translation: Array
) -> View:
    """Return a camera with a lens of this kind."""
    centre = (np.array(size) - 1) / 2 + rng.normal(0, 8, 2)
    if kind == "fisheye":
        focal = max(size) / np.radians(rng.uniform(100, 170))
        distortion = np.array([rng.uniform(-0.04, 0.04), rng.uniform(-0.01, 0.01), 0.0, 0.0])
    else:
        focal, (k1, k2) = PERSPECTIVE[rng.integers(3)]
        tangential = rng.normal(0, 0.001, 2) if kind == "tangential" else (0.0, 0.0)
        distortion = np.array([k1, k2, *tangential, 0.0])
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
    return View(*size, matrix, distortion, rotation, translation, kind == "fisheye")


def draw_sightings(rng: np.random.Generator, views: dict[str, View]) -> Sightings:
    """Return corners of 25 boards that one camera or both see, with noise."""
    covered, tilt, noise = rng.uniform(0.1, 1.0), rng.uniform(0.2, 0.7), rng.uniform(0.05, 0.3)
    found: dict[tuple[str, int], tuple[Array, Array]] = {}
    first, size = views["a"], np.array([views["a"].width, views["a"].height])
    for moment in range(25):
        for _ in range(50):
            at = size / 2 + (rng.random(2) - 0.5) * size * np.sqrt(covered)
            ahead = np.append(first.lens.rays(at[None])[0], 1.0)
            turn = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0] @ facing(ahead)
            distance = rng.uniform(0.4, 0.8) * max(1.0, first.focal / 800)
            points = (PLACES - PLACES.mean(0)) @ turn.T + ahead / np.linalg.norm(ahead) * distance
            shown = {name: pixels_of(rng, view, points, noise) for name, view in views.items()}
            if len(shown["a"][0]) >= FEWEST:
                found |= {(name, moment): one for name, one in shown.items() if len(one[0]) >= FEWEST}
                break
    return found


def facing(ahead: Array) -> Array:
    """Return the rotation that turns a board from the optical axis towards a direction."""
    unit = ahead / np.linalg.norm(ahead)
    across = np.cross([0.0, 0.0, 1.0], unit)
    length = float(np.linalg.norm(across))
    return np.asarray(cv2.Rodrigues(across / max(length, 1e-9) * np.arctan2(length, unit[2]))[0])


def pixels_of(rng: np.random.Generator, view: View, points: Array, noise: float) -> tuple[Array, Array]:
    """Return places on the board and pixels of the corners that a camera sees."""
    there = points @ view.rotation.T + view.translation
    front = there[:, 2] > 0.02
    at = view.lens.project(there[:, :2] / np.where(front, there[:, 2], 1.0)[:, None])
    seen = front & (at > 0).all(1) & (at < (view.width - 1, view.height - 1)).all(1) & view.lens.known(at)
    misread = rng.normal(0, 4, at.shape) * (rng.random((len(at), 1)) < 0.005)
    return PLACES[seen], (at + rng.normal(0, noise, at.shape) + misread)[seen]


def both_see(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Return the places that two cameras see, and each one's pixels."""
    a, b = corners(first), corners(second)
    ids = sorted(a.keys() & b.keys())
    return PLACES[ids], np.array([a[i] for i in ids]), np.array([b[i] for i in ids])


def corners(at: tuple[Array, Array]) -> dict[int, Array]:
    """Return the pixels of a board's corners by number."""
    places, pixels = at
    numbers = np.abs(places[:, None] - PLACES[None]).sum(2).argmin(1)
    return dict(zip(map(int, numbers), pixels, strict=True))


if __name__ == "__main__":
    main()
