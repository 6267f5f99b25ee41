"""Bundle adjustment of a rig that saw a board: lenses, cameras and boards together, by all corners at once.

Pair by pair, errors add up along the rig, and each lens knows only its own pictures. By Levenberg and
Marquardt's method on Huber's loss (Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000), with
OpenCV's derivatives.

OpenCV 5's `calibrateMultiview` was 3 to 100 times further off on the same simulated boards once corners were
misread, which is why this is our own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View

HUBER_PX = 1.0
"""Corners that miss by more count less and less: they were misread."""
MAX_STEPS = 30
ENOUGH = 1e-5
"""The share by which the loss falls in the last step."""
LENS = 6
"""fx, fy, cx, cy, k1, k2: few boards, or boards at one angle, do not determine the higher terms."""


@dataclass(frozen=True)
class _Pose:
    """Rotation vector and translation, (3,) each."""

    turn: Array
    move: Array

    def stepped(self, step: Array) -> "_Pose":
        return _Pose(self.turn + step[:3], self.move + step[3:])


Sightings = Mapping[tuple[str, int], tuple[Array, Array]]
"""By camera and moment, the corners' places on the board (n, 3; m) and their pixels (n, 2)."""


def adjust_bundle(
    views: Mapping[str, View], seen: Sightings, keep_lenses: frozenset[str] = frozenset()
) -> dict[str, View]:
    """The views as all corners together have them; the first one stays where it is, and so do some lenses."""
    names = list(views)
    cameras = {name: _Pose(cv2.Rodrigues(v.rotation)[0].ravel(), v.translation) for name, v in views.items()}
    lenses = dict(views)
    boards = _first_boards(views, seen)
    column = {name: LENS * i for i, name in enumerate(names)}
    first = LENS * len(names)
    place = {name: first + 6 * (i - 1) for i, name in enumerate(names) if i}
    first += 6 * (len(names) - 1)
    held = {moment: first + 6 * i for i, moment in enumerate(boards)}
    size = first + 6 * len(boards)
    damping, loss = 1e-3, _loss(lenses, cameras, boards, seen)
    for _ in range(MAX_STEPS):
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        for (name, moment), (points, pixels) in seen.items():
            error, parts = _linearized(lenses[name], cameras[name], boards[moment], points, pixels)
            weight = np.sqrt(np.minimum(1, HUBER_PX / np.linalg.norm(error, axis=1).clip(1e-9)))
            rows = np.repeat(weight, 2)[:, None]
            of_lens = parts[0] * (name not in keep_lenses)
            blocks = [(column[name], of_lens), (held[moment], parts[2])]
            if name in place:
                blocks.append((place[name], parts[1]))
            where = np.concatenate([np.arange(at, at + part.shape[1]) for at, part in blocks])
            jacobian = rows * np.hstack([part for _, part in blocks])
            normal[np.ix_(where, where)] += jacobian.T @ jacobian
            gradient[where] += jacobian.T @ (rows[:, 0] * error.ravel())
        before = loss
        while damping < 1e8:
            scaled = normal + damping * np.diag(np.diag(normal).clip(1e-12))
            step = -np.linalg.solve(scaled, gradient)
            new_lenses = {n: _stepped_lens(lenses[n], step[column[n] : column[n] + LENS]) for n in names}
            new_cameras = {
                n: cameras[n].stepped(step[place[n] : place[n] + 6]) if n in place else cameras[n]
                for n in names
            }
            new_boards = {m: boards[m].stepped(step[held[m] : held[m] + 6]) for m in boards}
            if (new := _loss(new_lenses, new_cameras, new_boards, seen)) < loss:
                lenses, cameras, boards, loss = new_lenses, new_cameras, new_boards, new
                damping /= 5
                break
            damping *= 5
        if before - loss < ENOUGH * before:
            break
    return {
        name: replace(
            lenses[name], rotation=cv2.Rodrigues(cameras[name].turn)[0], translation=cameras[name].move
        )
        for name in names
    }


def _first_boards(views: Mapping[str, View], seen: Sightings) -> dict[int, _Pose]:
    """`rig_from_board` of each moment, by the camera that sees most of it."""
    best: dict[int, tuple[int, str]] = {}
    for (name, moment), (points, _) in seen.items():
        best[moment] = max(best.get(moment, (0, "")), (len(points), name))
    boards = {}
    for moment, (_, name) in sorted(best.items()):
        points, pixels = seen[name, moment]
        view = views[name]
        _, turn, move = cv2.solvePnP(points, pixels, view.matrix, view.distortion)
        rotation = view.rotation.T @ cv2.Rodrigues(turn)[0]
        translation = view.rotation.T @ (move.ravel() - view.translation)
        boards[moment] = _Pose(cv2.Rodrigues(rotation)[0].ravel(), translation)
    return boards


def _linearized(
    view: View, camera: _Pose, board: _Pose, points: Array, pixels: Array
) -> tuple[Array, tuple[Array, Array, Array]]:
    """Errors (n, 2) in px, and their derivatives (2n, .) by lens, camera and board."""
    turn, move, *rates = cv2.composeRT(board.turn, board.move, camera.turn, camera.move)
    found, by = cv2.projectPoints(points, turn, move, view.matrix, view.distortion)
    turn_by_board, _, turn_by_camera, _, move_by_board, move_by_board_move = rates[:6]
    move_by_camera, move_by_camera_move = rates[6:8]
    of_camera = np.hstack([by[:, :3] @ turn_by_camera + by[:, 3:6] @ move_by_camera,
                           by[:, 3:6] @ move_by_camera_move])  # fmt: skip
    of_board = np.hstack([by[:, :3] @ turn_by_board + by[:, 3:6] @ move_by_board,
                          by[:, 3:6] @ move_by_board_move])  # fmt: skip
    return found.reshape(-1, 2) - pixels, (by[:, 6 : 6 + LENS], of_camera, of_board)


def _loss(
    lenses: Mapping[str, View], cameras: Mapping[str, _Pose], boards: Mapping[int, _Pose], seen: Sightings
) -> float:
    total = 0.0
    for (name, moment), (points, pixels) in seen.items():
        camera, board, view = cameras[name], boards[moment], lenses[name]
        turn, move = cv2.composeRT(board.turn, board.move, camera.turn, camera.move)[:2]
        found, _ = cv2.projectPoints(points, turn, move, view.matrix, view.distortion)
        size = np.linalg.norm(found.reshape(-1, 2) - pixels, axis=1)
        total += float(np.where(size < HUBER_PX, size**2 / 2, HUBER_PX * (size - HUBER_PX / 2)).sum())
    return total


def _stepped_lens(view: View, step: Array) -> View:
    matrix, distortion = view.matrix.copy(), view.distortion.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
    distortion[:2] += step[4:6]
    return replace(view, matrix=matrix, distortion=distortion)
