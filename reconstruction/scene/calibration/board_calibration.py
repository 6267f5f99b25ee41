"""Calibration from a board: each lens (Zhang 2000), the rig pair by pair, then a joint bundle adjustment.

The pairwise stage accumulates errors along the rig, and each lens uses only its own images. The bundle
adjustment therefore uses all corners. It is Levenberg-Marquardt on a Huber loss (Triggs et al., Bundle
Adjustment - A Modern Synthesis, 2000), with OpenCV's derivatives. The errors of OpenCV 5's own
`calibrateMultiview` were 3 to 100 times larger on the same simulated boards once corners were misread.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate, combinations

import cv2
import numpy as np

from capture_app.board.boards import MIN_CORNERS, Checkerboard
from capture_app.board.coverage import BoardCoverage, CoverageCount
from capture_app.board.detector import Board, BoardDetector, Corners
from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.session.format.calibration import Calibration
from reconstruction.common.geometry import Array, View
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset

MIN_BOARDS = 4
MAX_BOARDS = 40

Lens = tuple[Array, Array]
"""The camera matrix 3x3 in px and OpenCV's distortion (5,)."""
HUBER_PX = 1.0
"""Residual beyond which a corner counts less and less: it was probably misread."""
MAX_STEPS = 30
ENOUGH = 1e-5
"""Relative decrease of the loss below which the adjustment stops."""
LENS = 6
"""Number of lens parameters, fx, fy, cx, cy, k1, k2.

Few boards, or boards at one angle, do not determine the higher terms."""
CAMERA = LENS + 6
"""Number of a camera's parameters: its lens, rotation vector and translation."""
BUNDLE_MOMENTS_EACH, BUNDLE_MOMENTS = 20, 150
"""Maximum moments of each camera and pair, and in total, in the adjustment; its time is cubic in them."""


def calibrate_lens(name: str, size: tuple[int, int], board: Board, seen: Sequence[Corners]) -> Lens:
    """Calibrate the lens of a camera of this size (px) from the board's corners in its images.

    Raises:
        BadInputError: it saw the board too rarely.
    """
    if len(seen) < MIN_BOARDS:
        raise BadInputError(
            f"{name} shows the board in {count(len(seen), 'image')}; {MIN_BOARDS} are needed",
            hint="record the board from more places; check --board, --square-mm and --dictionary",
        )
    seen = evenly_spaced(seen, MAX_BOARDS)
    points = [board.places[sorted(corners)] for corners in seen]
    pixels = [_pixels(corners, sorted(corners)) for corners in seen]
    _, matrix, distortion, _, _ = cv2.calibrateCamera(
        points, pixels, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    )
    return np.asarray(matrix), np.asarray(distortion).ravel()[:5]


def lenses_of_recordings(dataset: Dataset, board: Board, recordings: Sequence[Dataset]) -> dict[str, Lens]:
    """Calibrate lenses of a session's cameras from recordings in which single cameras see the board.

    Raises:
        BadInputError: a recording is of none of these cameras, of another size, or shows too little.
    """
    seen: dict[str, list[Corners]] = {}
    for recording in recordings:
        if not (shared := [name for name in recording.cameras if name in dataset.cameras]):
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"give a recording of {', '.join(dataset.cameras)}",
            )
        refuse_other_sizes(recording, dataset, shared)
        for name in shared:
            detector = BoardDetector(board)
            images = (recording.grey(name, instant) for instant in recording.instants(name))
            seen.setdefault(name, []).extend(filter(None, map(detector.detect, images)))
    return {name: calibrate_lens(name, dataset.size(name), board, corners) for name, corners in seen.items()}


def refuse_other_sizes(recording: Dataset, dataset: Dataset, cameras: Sequence[str]) -> None:
    """Raise BadInputError if a recording's images of these cameras have another size."""
    for name in cameras:
        if recording.size(name) != dataset.size(name):
            sizes = ["x".join(map(str, source.size(name))) for source in (recording, dataset)]
            raise BadInputError(
                f"{name} has pictures of {sizes[0]} in {recording.name}, of {sizes[1]} in {dataset.name}",
                hint="record the board in the mode that is used later: another may show another part",
            )


Sightings = Mapping[tuple[str, int], tuple[Array, Array]]
"""Board corners by camera and moment: places on the board (n, 3; m) and pixels (n, 2)."""


def adjust_bundle(
    views: Mapping[str, View], seen: Sightings, keep_lenses: frozenset[str] = frozenset()
) -> dict[str, View]:
    """Fit all views to all corners together; the first view's pose and lenses in `keep_lenses` stay fixed."""
    boards = _first_boards(views, seen)
    of_camera = {name: CAMERA * i for i, name in enumerate(views)}
    of_board = {moment: CAMERA * len(views) + 6 * i for i, moment in enumerate(boards)}
    values = np.concatenate([*map(_camera_values, views.values()), *boards.values()])
    # The first camera's pose defines the rig's frame.
    free = np.ones(len(values), bool)
    free[LENS:CAMERA] = False
    for name in keep_lenses:
        free[of_camera[name] : of_camera[name] + LENS] = False

    def linearize(values: Array) -> tuple[float, Array, Array]:
        """Return the loss, and the normal equations of its reweighted least squares."""
        loss, normal, gradient = 0.0, np.zeros((len(values), len(values))), np.zeros(len(values))
        for (name, moment), (points, pixels) in seen.items():
            camera, board = of_camera[name], of_board[moment]
            where = np.r_[camera : camera + CAMERA, board : board + 6]
            error, jacobian = _residuals(views[name], values[where], points, pixels)
            size = np.linalg.norm(error, axis=1)
            loss += float(np.where(size < HUBER_PX, size**2 / 2, HUBER_PX * (size - HUBER_PX / 2)).sum())
            weight = np.repeat(np.sqrt(np.minimum(1, HUBER_PX / size.clip(1e-9))), 2)
            jacobian = weight[:, None] * jacobian * free[where]
            normal[np.ix_(where, where)] += jacobian.T @ jacobian
            gradient[where] += jacobian.T @ (weight * error.ravel())
        return loss, normal, gradient

    damping, (loss, normal, gradient) = 1e-3, linearize(values)
    for _ in range(MAX_STEPS):
        before = loss
        while damping < 1e8:
            # Fixed values have no slope: the damping alone keeps their equations solvable.
            damped = normal + damping * np.diag(np.diag(normal).clip(1e-12))
            stepped = values - np.linalg.solve(damped, gradient)
            residuals = linearize(stepped)
            if residuals[0] < loss:
                values, (loss, normal, gradient) = stepped, residuals
                damping /= 5
                break
            damping *= 5
        if before - loss < ENOUGH * before:
            break
    return {name: _adjusted(view, values[of_camera[name] :]) for name, view in views.items()}


def _camera_values(view: View) -> Array:
    """Return the values of a camera (CAMERA,) that are adjusted: fx, fy, cx, cy, k1, k2 and its pose."""
    lens = np.append(view.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], view.distortion[: LENS - 4])
    return np.append(lens, _pose(view.rotation, view.translation))


def _adjusted(view: View, values: Array) -> View:
    """Return the view with the first `CAMERA` of these values."""
    matrix, distortion = view.matrix.copy(), view.distortion.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = values[:4]
    distortion[: LENS - 4] = values[4:LENS]
    rotation, _ = cv2.Rodrigues(values[LENS : LENS + 3])
    return View(view.width, view.height, matrix, distortion, rotation, values[LENS + 3 : CAMERA])


def _pose(rotation: Array, translation: Array) -> Array:
    """Return the rotation vector and the translation as one vector (6,)."""
    return np.concatenate([cv2.Rodrigues(rotation)[0].ravel(), translation])


def _first_boards(views: Mapping[str, View], seen: Sightings) -> dict[int, Array]:
    """Return `rig_from_board` of each moment, from the camera that sees most corners."""
    counts = sorted((moment, len(points), name) for (name, moment), (points, _) in seen.items())
    best = {moment: name for moment, _, name in counts}
    return {k: _pose(*rig_from_board(views[name], *seen[name, k])) for k, name in best.items()}


def rig_from_board(view: View, places: Array, pixels: Array) -> tuple[Array, Array]:
    """Return the pose of a board in the rig from its corners, places (n, 3; m) at pixels (n, 2) of a view."""
    rotation, translation = _board_pose(places, pixels, (view.matrix, view.distortion))
    return view.rotation.T @ rotation, view.rotation.T @ (translation - view.translation)


def _residuals(view: View, values: Array, points: Array, pixels: Array) -> tuple[Array, Array]:
    """Return the residuals (n, 2), px, and their derivatives (2n, CAMERA + 6) by a camera and a board."""
    camera, board = values[LENS:CAMERA], values[CAMERA:]
    lens = _adjusted(view, values)
    rvec, tvec, *rates = cv2.composeRT(board[:3], board[3:], camera[:3], camera[3:])
    projected, by = cv2.projectPoints(points, rvec, tvec, lens.matrix, lens.distortion)
    # OpenCV's order: the composed rotation by both poses, board first, then the composed translation.
    by_poses = np.block([[*rates[2:4], *rates[:2]], [*rates[6:8], *rates[4:6]]])
    return projected.reshape(-1, 2) - pixels, np.hstack([by[:, 6 : 6 + LENS], by[:, :6] @ by_poses])


BoardCorners = dict[tuple[str, int], Corners]
"""Pixels of the board's corners, by camera and moment; moments are instants counted over all recordings."""


def detect_board(recordings: Sequence[Dataset], board: Board) -> BoardCorners:
    """Detect the board in every image; images with fewer than MIN_CORNERS are left out."""
    finders = {camera: BoardDetector(board) for camera in recordings[0].cameras}
    first_moments = accumulate((len(recording.instants_ns) for recording in recordings), initial=0)
    return {
        (camera, first + instant): corners
        for recording, first in zip(recordings, first_moments, strict=False)
        for camera in recording.cameras
        for instant in recording.instants(camera)
        if (corners := finders[camera].detect(recording.grey(camera, instant)))
    }


def count_coverage(dataset: Dataset, board: Board, corners: BoardCorners) -> BoardCoverage:
    """Count which parts of the cameras' images the board has covered."""
    counted = CoverageCount(board, {name: dataset.size(name) for name in dataset.cameras})
    for seen in corners_by_moment(corners).values():
        counted.add(seen)
    return counted.coverage()


def corners_by_moment(corners: BoardCorners) -> dict[int, dict[str, Corners]]:
    """Group corners by moment, then camera, in the order of moments."""
    by_moment: dict[int, dict[str, Corners]] = {moment: {} for moment in sorted({k for _, k in corners})}
    for (camera, moment), seen in corners.items():
        by_moment[moment][camera] = seen
    return by_moment


def shared_corners(corners: BoardCorners) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return, for pairs of cameras, the pixels of corners that both see at the same instant."""
    shared: dict[tuple[str, str], list[tuple[Array, Array]]] = {}
    for seen in corners_by_moment(corners).values():
        for a, b in combinations(sorted(seen), 2):
            both = sorted(seen[a].keys() & seen[b].keys())
            shared.setdefault((a, b), []).extend((seen[a][i], seen[b][i]) for i in both)
    pixels = {pair: np.stack(found, axis=1) for pair, found in shared.items() if found}
    return {pair: (at_a, at_b) for pair, (at_a, at_b) in pixels.items()}


def calibrate_from_board(
    dataset: Dataset, board: Board, corners: BoardCorners, known: Mapping[str, Lens] | None = None
) -> Calibration:
    """Calibrate every lens, place the cameras by boards that they share, then adjust everything together.

    `known`: lenses that are calibrated already and stay fixed.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places, known = board.places, known or {}
    lenses = {
        camera: known[camera]
        if camera in known
        else calibrate_lens(
            camera, dataset.size(camera), board, [corners[key] for key in sorted(corners) if key[0] == camera]
        )
        for camera in dataset.cameras
    }
    poses = _rig_poses(dataset, places, corners, lenses)
    views = {name: View(*dataset.size(name), *lenses[name], *poses[name]) for name in dataset.cameras}
    used = _bundle_moments(corners)
    sightings = {
        (name, moment): (
            places[sorted(own_corners)].astype(float),
            _pixels(own_corners, sorted(own_corners)).astype(float),
        )
        for (name, moment), own_corners in corners.items()
        if moment in used
    }
    views = adjust_bundle(views, sightings, frozenset(known))
    kind = "checkerboard" if isinstance(board, Checkerboard) else "ChArUco board"
    own = f", lenses of {', '.join(known)} from recordings of their own" if known else ""
    return Calibration(
        cameras={name: view.to_calibration() for name, view in views.items()},
        unit="m",
        source=f"{kind} in {len(corners)} images of {dataset.name}{own}",
    )


def _bundle_moments(corners: BoardCorners) -> set[int]:
    """Choose moments for the bundle adjustment: a limited number of each camera pair and each camera."""
    groups: dict[frozenset[str], list[int]] = {}
    for moment, seen in corners_by_moment(corners).items():
        for who in [*combinations(seen, 2), *((name,) for name in seen)]:
            groups.setdefault(frozenset(who), []).append(moment)
    chosen = {k for moments in groups.values() for k in evenly_spaced(moments, BUNDLE_MOMENTS_EACH)}
    return set(evenly_spaced(sorted(chosen), BUNDLE_MOMENTS))


def _pixels(seen: dict[int, Array], ids: list[int]) -> Array:
    return np.array([seen[i] for i in ids], np.float32)


def _rig_poses(
    dataset: Dataset, places: Array, corners: BoardCorners, lenses: dict[str, tuple[Array, Array]]
) -> dict[str, tuple[Array, Array]]:
    """Return `cam_from_rig`, chained from the first camera through those that share most boards."""
    shared: dict[frozenset[str], list[tuple[int, list[int]]]] = {}
    for k, seen in corners_by_moment(corners).items():
        for a, b in combinations(seen, 2):
            if len(ids := sorted(seen[a].keys() & seen[b].keys())) >= MIN_CORNERS:
                shared.setdefault(frozenset((a, b)), []).append((k, ids))
    poses = {dataset.cameras[0]: (np.eye(3), np.zeros(3))}
    while left := [b for b in dataset.cameras if b not in poses]:
        links = [(len(shared.get(frozenset((a, b)), ())), a, b) for a in poses for b in left]
        shared_boards, a, b = max(links, key=lambda link: link[0])
        if shared_boards < MIN_BOARDS:
            raise BadInputError(
                f"{b} and {a} show the board together at {count(shared_boards, 'instant')}; {MIN_BOARDS} are "
                "needed",
                hint="hold the board where neighbouring cameras both see it",
            )
        together = shared[frozenset((a, b))][:MAX_BOARDS]
        in_a, in_b = ([_pixels(corners[name, k], ids) for k, ids in together] for name in (a, b))
        rotation, translation = _relative_pose(
            [places[ids] for _, ids in together], (in_a, in_b), (lenses[a], lenses[b])
        )
        poses[b] = rotation @ poses[a][0], rotation @ poses[a][1] + translation
    return poses


def _relative_pose(
    points: list[Array], pixels: tuple[list[Array], list[Array]], lenses: tuple[Lens, Lens]
) -> tuple[Array, Array]:
    """Return rotation (3, 3) and translation (3,) from the first camera to the second.

    They are the means over the half of the boards that agree best. OpenCV's stereoCalibrate is not used: it
    starts from a median of rotation vectors, which fails near half a turn.
    """
    rotations, translations = [], []
    for at, *seen in zip(points, *pixels, strict=True):
        (of_a, move_a), (of_b, move_b) = map(_board_pose, (at, at), seen, lenses)
        rotations.append(of_b @ of_a.T)
        translations.append(move_b - of_b @ of_a.T @ move_a)
    every = np.array(rotations)
    apart = np.linalg.norm(every[:, None] - every[None], axis=(2, 3))
    agreeing = np.argsort(apart[int(apart.sum(0).argmin())])[: max(1, (len(every) + 1) // 2)]
    left, _, right = np.linalg.svd(every[agreeing].sum(0))
    return left @ right, np.array(translations)[agreeing].mean(0)


def _board_pose(points: Array, pixels: Array, lens: Lens) -> tuple[Array, Array]:
    _, rvec, tvec = cv2.solvePnP(points, pixels, *lens)
    return cv2.Rodrigues(rvec)[0], np.asarray(tvec).ravel()
