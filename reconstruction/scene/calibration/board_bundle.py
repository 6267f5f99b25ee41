"""Bundle adjustment over boards, with the lens terms that the corners determine, and the result's errors.

It is Levenberg-Marquardt on a Huber loss (Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000), with
OpenCV's derivatives. The errors of OpenCV 5's own `calibrateMultiview` were 3 to 100 times larger on the same
simulated boards once corners were misread.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace as replace_struct

from capture_app.session.format.lens import Lens
from reconstruction.common.geometry import SIGMAS_95, Array, View

HUBER_PX = 1.0
"""Residual beyond which a corner counts less and less: it was probably misread."""
LENS = 9
"""Number of lens parameters: fx, fy, cx, cy, then k1, k2, p1, p2, k3 or a fisheye's k1 to k4."""
CAMERA = LENS + 6
"""Number of a camera's parameters: its lens, rotation vector and translation."""
SIMPLE = frozenset(range(6))
"""Parameters of the first adjustment: few boards, or boards at one angle, do not determine higher terms."""
GROUPS = {False: ((8,), (6, 7), (5,)), True: ((7,), (6,), (5,))}
"""Terms that are left out together, in this order, of a perspective lens and of a fisheye."""
MIN_NOISE_PX = 0.02
"""Minimum noise of corners that is assumed."""
LARGE_PERCENT, LARGE_PX = 1.0, 3.0
"""Errors of the focal length, and of the distortion in the corner, that call for a better recording."""
CONTRADICTION = 1.5
"""Residual of all cameras' corners together, relative to each alone, above which they contradict."""

Sightings = Mapping[tuple[str, int], tuple[Array, Array]]
"""Board corners by camera and moment: places on the board (n, 3; m) and pixels (n, 2)."""


class CameraErrors(Struct, frozen=True, kw_only=True):
    """95 % errors of a camera's calibration by the covariance of the bundle adjustment."""

    focal_percent: float
    centre_px: float
    """Error of the principal point."""
    border_px: float
    """Error of the distortion at the corner of the picture."""
    turn_deg: float
    """Error of the rotation, relative to the first camera."""
    move_mm: float
    """Error of the position, relative to the first camera."""

    def __str__(self) -> str:
        """Describe the errors, and what would make them smaller."""
        remedies = ["tilt the board more" if self.focal_percent > LARGE_PERCENT else ""]
        remedies += ["move it to the corners of the picture" if self.border_px > LARGE_PX else ""]
        advice = f": {' and '.join(filter(None, remedies))}" if any(remedies) else ""
        pose = (
            f", turned ± {self.turn_deg:.2g} degrees, moved ± {self.move_mm:.2g} mm" if self.move_mm else ""
        )
        return (
            f"focal length ± {self.focal_percent:.2g} %, principal point ± {self.centre_px:.2g} px, "
            f"distortion in the corner ± {self.border_px:.2g} px{pose} (95 %){advice}"
        )


@dataclass(frozen=True, eq=False)
class Bundle:
    """Views that fit all corners together, and the errors of each."""

    views: dict[str, View]
    errors: dict[str, CameraErrors]
    rms_px: float
    """Root mean square of the corners' residuals, each coordinate; misread ones count less."""
    apart_px: float | None = None
    """`rms_px` of each camera's corners alone, which give the lenses; None unless cameras contradict."""


def adjust_bundle(
    views: Mapping[str, View], seen: Sightings, keep_lenses: frozenset[str] = frozenset()
) -> Bundle:
    """Fit all views to all corners together; the first view's pose and lenses in `keep_lenses` stay fixed.

    A lens has the terms that improve the fit by more than chance (Schwarz's criterion, 1978, by the fit with
    all).
    If the cameras contradict each other, because the board moved between their images or is bent, each lens
    is fitted to its own camera's corners.
    """
    together = _fit(views, seen, keep_lenses)
    if len(views) < 2 or keep_lenses >= views.keys():
        return together
    own_seen = {name: {key: at for key, at in seen.items() if key[0] == name} for name in views}
    alone = {
        name: _fit({name: view}, own_seen[name], keep_lenses & {name})
        for name, view in views.items()
        if own_seen[name]
    }
    apart_px = float(np.sqrt(np.mean([lens.rms_px**2 for lens in alone.values()])))
    if together.rms_px < CONTRADICTION * max(apart_px, MIN_NOISE_PX):
        return together
    lenses = {
        name: replace(
            view, matrix=alone[name].views[name].matrix, distortion=alone[name].views[name].distortion
        )
        if name in alone
        else view
        for name, view in views.items()
    }
    placed = _fit(lenses, seen, frozenset(views))
    errors = {
        name: replace_struct(
            alone[name].errors[name],
            turn_deg=placed.errors[name].turn_deg,
            move_mm=placed.errors[name].move_mm,
        )
        for name in alone
    }
    return Bundle(placed.views, errors, placed.rms_px, apart_px)


def _fit(views: Mapping[str, View], seen: Sightings, keep_lenses: frozenset[str]) -> Bundle:
    """Fit views to corners, with the terms of each lens that the corners determine."""
    fitted = {name: frozenset() if name in keep_lenses else SIMPLE for name in views}
    simple = Adjustment(views, seen, fitted)
    whole = {
        name: frozenset() if name in keep_lenses else frozenset(range(8 if view.is_fisheye else LENS))
        for name, view in views.items()
    }
    values = simple.solve(simple.start())
    noise_px = max(MIN_NOISE_PX, simple.rms_px(values))
    full = Adjustment(views, seen, whole, noise_px)
    all_terms = full.solve(values)
    covariance = full.covariance(all_terms)
    start, borne = all_terms.copy(), {}
    for name, view in views.items():
        lens = full.of_lens[name]
        of_lens = all_terms[lens], covariance[lens, lens]
        needed = math.log(max(2, sum(at[1].size for key, at in seen.items() if key[0] == name)))
        borne[name], start[lens] = _borne_terms(view.is_fisheye, whole[name], *of_lens, needed)
    final = Adjustment(views, seen, borne, noise_px)
    values = final.solve(start)
    # What a term that is left out would change is unknown by as much.
    change = np.where(final.free, (all_terms - values) / SIGMAS_95, 0.0)
    covariance = final.covariance(values) + np.diag(change**2)
    adjusted = final.views_at(values)
    errors = {name: final.errors(name, view, covariance) for name, view in adjusted.items()}
    return Bundle(adjusted, errors, final.rms_px(values))


def _borne_terms(
    is_fisheye: bool, terms: frozenset[int], lens: Array, covariance: Array, needed: float
) -> tuple[frozenset[int], Array]:
    """Return the terms of a lens that its corners determine, and its values without the others.

    `needed`: minimum squared size of a term, in its variances.
    """
    determined, lens, variance = terms, lens.copy(), covariance
    for group in GROUPS[is_fisheye] if terms else ():
        if group == (5,) and 8 in determined:
            break
        where = np.ix_(group, group)
        gain = np.linalg.solve(variance[where], lens[list(group)])
        if float(lens[list(group)] @ gain) > needed * len(group):
            if is_fisheye:
                break
            continue
        # The other values as they are once these are known to be 0.
        lens = lens - variance[:, group] @ gain
        variance = variance - variance[:, group] @ np.linalg.solve(variance[where], variance[list(group)])
        determined -= {*group}
    lens[sorted(terms - determined)] = 0.0
    return determined, lens


class Adjustment:
    """Values of all cameras and boards, of which some are free, and the loss that they have."""

    def __init__(
        self,
        views: Mapping[str, View],
        seen: Sightings,
        terms: Mapping[str, Collection[int]],
        noise_px: float = MIN_NOISE_PX,
    ) -> None:
        """`terms`: numbers of the lens parameters that are free, by camera. `noise_px`: of the corners."""
        self.views, self.seen = views, seen
        self.of_camera = {name: CAMERA * i for i, name in enumerate(views)}
        self.moments = sorted({moment for _, moment in seen})
        self.of_board = {moment: CAMERA * len(views) + 6 * i for i, moment in enumerate(self.moments)}
        self.free = np.ones(CAMERA * len(views) + 6 * len(self.moments), bool)
        # The first camera's pose defines the rig's frame.
        self.free[LENS:CAMERA] = False
        self.of_lens = {name: slice(at, at + LENS) for name, at in self.of_camera.items()}
        # What lenses are like decides what the corners leave open.
        self.typical, self.weight = np.zeros(len(self.free)), np.zeros(len(self.free))
        for name, lens in self.of_lens.items():
            self.free[lens] = [place in terms[name] for place in range(LENS)]
            self.typical[lens], deviation = _typical_lens(views[name])
            self.weight[lens] = (noise_px / deviation) ** 2 * self.free[lens]

    def start(self) -> Array:
        """Return the values of the views, and of boards as the camera that sees most of each has them."""
        counts = sorted((moment, len(points), name) for (name, moment), (points, _) in self.seen.items())
        best = {moment: name for moment, _, name in counts}
        boards = [_pose(*rig_from_board(self.views[best[k]], *self.seen[best[k], k])) for k in self.moments]
        return np.concatenate([*map(_camera_values, self.views.values()), *boards])

    def solve(self, values: Array) -> Array:
        """Return the values with the least loss, from these on."""
        damping, (loss, normal, gradient) = 1e-3, self._linearize(values)
        for _ in range(30):
            before = loss
            while damping < 1e8:
                # Fixed values have no slope: the damping alone keeps their equations solvable.
                damped = normal + damping * np.diag(np.diag(normal).clip(1e-12))
                stepped = values - np.linalg.solve(damped, gradient)
                residuals = self._linearize(stepped)
                if residuals[0] < loss:
                    values, (loss, normal, gradient) = stepped, residuals
                    damping /= 5
                    break
                damping *= 5
            if before - loss < 1e-5 * before:
                break
        return values

    def views_at(self, values: Array) -> dict[str, View]:
        """Return the views that these values describe."""
        return {name: _adjusted(view, values[self.of_camera[name] :]) for name, view in self.views.items()}

    def rms_px(self, values: Array) -> float:
        """Return the root mean square of the residuals, corners that were misread counted less."""
        count = sum(pixels.size for _, pixels in self.seen.values())
        return float(np.sqrt(self.squares(values).sum() / max(1, count)))

    def squares(self, values: Array) -> Array:
        """Return each sighting's sum of squared residuals, px^2, corners that were misread counted less."""
        fits = (self._sighting(key, values) for key in self.seen)
        return np.array([((weight * error.ravel()) ** 2).sum() for error, _, weight, _ in fits])

    def covariance(self, values: Array) -> Array:
        """Return the covariance of the values; 0 for fixed ones.

        It holds for independent corners. If the corners of a picture err together, it is widened by the ratio
        in which the focal lengths and poses then vary more (White 1980, by pictures).
        """
        _, normal, _ = self._linearize(values)
        free = np.flatnonzero(self.free)
        # Values of very different sizes: invert the equations of values in their own slopes.
        scale = 1 / np.sqrt(np.diag(normal)[free].clip(1e-12))
        inverse = np.zeros_like(normal)
        inverse[np.ix_(free, free)] = np.outer(scale, scale) * np.linalg.pinv(
            normal[np.ix_(free, free)] * np.outer(scale, scale), hermitian=True
        )
        scores, count = np.zeros((len(self.seen), len(values))), 0
        for row, key in enumerate(self.seen):
            error, jacobian, weight, where = self._sighting(key, values)
            scores[row, where], count = jacobian.T @ (weight * error.ravel()), count + error.size
        plain = inverse * self.rms_px(values) ** 2 * count / max(1, count - len(free))
        pictures = len(self.seen) / max(1, len(self.seen) - LENS)
        watched = [at + n for at in self.of_camera.values() for n in (0, *range(LENS, CAMERA))]
        watched = [at for at in watched if self.free[at]]
        worse = pictures * ((inverse[watched] @ scores.T) ** 2).sum(1) / np.diag(plain)[watched].clip(1e-300)
        return np.asarray(plain * max(1.0, float(np.median(worse if watched else 1.0))))

    def errors(self, name: str, view: View, covariance: Array) -> CameraErrors:
        """Return the 95 % errors of a camera."""
        at = self.of_camera[name]
        own = covariance[at : at + CAMERA, at : at + CAMERA]
        deviation = np.sqrt(np.diag(own).clip(0))
        corner = view.lens.rays(np.array([[view.width - 1.0, view.height - 1.0]]))
        _, by_lens, _ = project(view, np.append(corner[0], 1.0)[None], np.zeros(3), np.zeros(3))
        bend = by_lens[:, 4:] @ own[4:LENS, 4:LENS] @ by_lens[:, 4:].T
        turned, moved = own[LENS : LENS + 3, LENS : LENS + 3], _centre_variance(view, own[LENS:, LENS:])
        return CameraErrors(
            focal_percent=100 * SIGMAS_95 * float(deviation[:2].max()) / view.focal,
            centre_px=SIGMAS_95 * float(deviation[2:4].max()),
            border_px=SIGMAS_95 * float(np.sqrt(np.trace(bend))),
            turn_deg=SIGMAS_95 * float(np.degrees(np.sqrt(np.linalg.eigvalsh(turned).max().clip(0)))),
            move_mm=1000 * SIGMAS_95 * float(np.sqrt(np.linalg.eigvalsh(moved).max().clip(0))),
        )

    def _sighting(self, key: tuple[str, int], values: Array) -> tuple[Array, Array, Array, Array]:
        """Return residuals (n, 2) px of a sighting, their weighted slopes and weights (2n), and the values'
        numbers."""
        name, moment = key
        points, pixels = self.seen[key]
        camera, board = self.of_camera[name], self.of_board[moment]
        where = np.r_[camera : camera + CAMERA, board : board + 6]
        error, jacobian = _residuals(self.views[name], values[where], points, pixels)
        size = np.linalg.norm(error, axis=1)
        weight = np.repeat(np.sqrt(np.minimum(1, HUBER_PX / size.clip(1e-9))), 2)
        return error, weight[:, None] * jacobian * self.free[where], weight, where

    def _linearize(self, values: Array) -> tuple[float, Array, Array]:
        """Return the loss, and the normal equations of its reweighted least squares."""
        loss, normal, gradient = 0.0, np.zeros((len(values), len(values))), np.zeros(len(values))
        for key in self.seen:
            error, jacobian, weight, where = self._sighting(key, values)
            size = np.linalg.norm(error, axis=1)
            loss += float(np.where(size < HUBER_PX, size**2 / 2, HUBER_PX * (size - HUBER_PX / 2)).sum())
            normal[np.ix_(where, where)] += jacobian.T @ jacobian
            gradient[where] += jacobian.T @ (weight * error.ravel())
        unusual = self.weight * (values - self.typical)
        loss += float(unusual @ (values - self.typical)) / 2
        normal[np.diag_indices(len(values))] += self.weight
        gradient += unusual
        return (loss if np.isfinite(loss) else np.inf), normal, gradient


def _typical_lens(view: View) -> tuple[Array, Array]:
    """Return what lenses of this field are like: means and standard deviations of the parameters (LENS,)."""
    size = np.array([view.width, view.height])
    corner = float(np.linalg.norm(size / 2) / view.focal)
    # As far as the terms bend the picture's corner, they are alike for lenses of any focal length.
    if view.is_fisheye:
        # A term shifts the corner by this fraction of its distance from the middle (standard deviation).
        terms = [0.1 / corner ** (2 * n) for n in (1, 2, 3, 4)] + [1.0]
    else:
        radial = [0.3 / corner ** (2 * n) for n in (1, 2, 3)]
        terms = [*radial[:2], *[0.01 / corner] * 2, radial[2]]
    mean = np.array([view.matrix[0, 0], view.matrix[1, 1], *(size - 1) / 2, 0, 0, 0, 0, 0])
    # Principal points are off the middle by a tenth of the longer side (standard deviation).
    return mean, np.array([np.inf, np.inf, *[0.1 * size.max()] * 2, *terms])


def _centre_variance(view: View, pose: Array) -> Array:
    """Return the covariance of a camera's position by that of its rotation vector and translation."""
    _, by_rotation = cv2.Rodrigues(cv2.Rodrigues(view.rotation)[0])
    by_rotation = np.einsum("vrc,r->cv", by_rotation.reshape(3, 3, 3), view.translation)
    slopes = -np.hstack([by_rotation, view.rotation.T])
    return np.asarray(slopes @ pose @ slopes.T)


def project(view: View, points: Array, rvec: Array, tvec: Array) -> tuple[Array, Array, Array]:
    """Return pixels (n, 2) of points (n, 3), and their slopes by lens (2n, LENS) and by pose (2n, 6)."""
    if view.is_fisheye:
        pixels, by = cv2.fisheye.projectPoints(points[:, None], rvec, tvec, view.matrix, view.distortion)
        lens = np.hstack([by[:, :8], np.zeros((len(by), 1))])
        return pixels.reshape(-1, 2), lens, by[:, 8:14]
    pixels, by = cv2.projectPoints(points, rvec, tvec, view.matrix, view.distortion)
    return pixels.reshape(-1, 2), by[:, 6 : 6 + LENS], by[:, :6]


def _camera_values(view: View) -> Array:
    """Return the values of a camera (CAMERA,) that are adjusted: its lens and its pose."""
    lens = np.append(view.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], view.distortion)
    return np.concatenate([lens, np.zeros(LENS - len(lens)), _pose(view.rotation, view.translation)])


def _adjusted(view: View, values: Array) -> View:
    """Return the view with the first `CAMERA` of these values."""
    matrix = view.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = values[:4]
    rotation, _ = cv2.Rodrigues(values[LENS : LENS + 3])
    return replace(
        view,
        matrix=matrix,
        distortion=values[4 : 4 + len(view.distortion)].copy(),
        rotation=rotation,
        translation=values[LENS + 3 : CAMERA].copy(),
    )


def _pose(rotation: Array, translation: Array) -> Array:
    """Return the rotation vector and the translation as one vector (6,)."""
    return np.concatenate([cv2.Rodrigues(rotation)[0].ravel(), translation])


def rig_from_board(view: View, places: Array, pixels: Array) -> tuple[Array, Array]:
    """Return the pose of a board in the rig from its corners, places (n, 3; m) at pixels (n, 2) of a view."""
    rotation, translation = board_pose(view.lens, places, pixels)
    return view.rotation.T @ rotation, view.rotation.T @ (translation - view.translation)


def board_pose(lens: Lens, places: Array, pixels: Array) -> tuple[Array, Array]:
    """Return rotation (3, 3) and translation (3,) from a board to a camera, by its corners."""
    _, rvec, tvec = cv2.solvePnP(places, lens.rays(pixels), np.eye(3), None)
    return cv2.Rodrigues(rvec)[0], np.asarray(tvec).ravel()


def _residuals(view: View, values: Array, points: Array, pixels: Array) -> tuple[Array, Array]:
    """Return the residuals (n, 2), px, and their derivatives (2n, CAMERA + 6) by a camera and a board."""
    camera, board = values[LENS:CAMERA], values[CAMERA:]
    rvec, tvec, *rates = cv2.composeRT(board[:3], board[3:], camera[:3], camera[3:])
    projected, by_lens, by_pose = project(_adjusted(view, values), points, rvec, tvec)
    # OpenCV's order: the composed rotation by both poses, board first, then the composed translation.
    by_poses = np.block([[*rates[2:4], *rates[:2]], [*rates[6:8], *rates[4:6]]])
    return projected - pixels, np.hstack([by_lens, by_pose @ by_poses])
