"""Bundle adjustment over boards: what pairs got wrong is mended, and misread corners do no harm."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.common.errors import BadInputError
from capture_app.session.format.lens import Lens
from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.scene.calibration import board_calibration
from reconstruction.scene.calibration.board_bundle import Adjustment, Sightings, _borne_terms, adjust_bundle
from reconstruction.scene.calibration.board_calibration import LensModel, calibrate_from_board, calibrate_lens
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, make_view

RIG = {
    "a": make_view((0, 0, 0)),
    "b": make_view((0.15, 0.02, 0), yaw=-6),
    "c": make_view((-0.15, -0.02, 0), yaw=6),
}
PLACES = DEFAULT_BOARD.places.astype(float)


def sightings(noise_px: float, rig: dict[str, View] = RIG) -> Sightings:
    """Nine boards in front of the rig, as each camera sees them."""
    rng = np.random.default_rng(3)
    found = {}
    for moment in range(9):
        turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        middle = rng.uniform((-0.15, -0.12, 0.6), (0.15, 0.12, 0.9))
        points = (PLACES - PLACES.mean(0)) @ turn.T + middle
        for name, view in rig.items():
            pixels = view.project(points @ view.rotation.T + view.translation)
            pixels = pixels + rng.normal(0, noise_px, pixels.shape)
            inside = ((pixels > 0) & (pixels < (WIDTH, HEIGHT))).all(1)
            if inside.sum() >= 8:
                found[name, moment] = PLACES[inside], pixels[inside]
    return found


def roughly(views: dict[str, View]) -> dict[str, View]:
    """The views as pairs may have them: lenses 2 % off, cameras turned by half a degree and moved by 5 mm."""
    rough = {}
    for sign, (name, view) in zip((0, 1, -1), views.items(), strict=True):
        matrix = view.matrix * np.array([[1 + 0.02 * sign, 1, 1.01], [1, 1 + 0.02 * sign, 0.99], [1, 1, 1]])
        turn = cv2.Rodrigues(np.radians([0.5, -0.4, 0.3]) * sign)[0]
        move = view.translation + 0.005 * sign
        rough[name] = replace(view, matrix=matrix, rotation=turn @ view.rotation, translation=move)
    return rough


def errors(found: dict[str, View], name: str) -> tuple[float, float, float]:
    """Of a camera against the first: degrees turned, mm moved, and its focal length's share."""
    turn, move = other_from_reference(found["a"], found[name])
    true_turn, true_move = other_from_reference(RIG["a"], RIG[name])
    turned = np.degrees(np.linalg.norm(cv2.Rodrigues(turn @ true_turn.T)[0]))
    moved = 1000 * np.linalg.norm(move - true_move)
    return float(turned), float(moved), abs(found[name].focal / RIG[name].focal - 1)


def test_what_pairs_got_wrong_is_mended() -> None:
    found = adjust_bundle(roughly(RIG), sightings(0.0)).views
    for name in ("b", "c"):
        assert errors(found, name) == pytest.approx((0, 0, 0), abs=1e-3)


def test_noise_and_misread_corners_do_little_harm() -> None:
    seen = dict(sightings(0.05))
    for key in list(seen)[::7]:
        places, pixels = seen[key]
        spoiled = pixels.copy()
        spoiled[3] += 12
        seen[key] = places, spoiled
    found = adjust_bundle(roughly(RIG), seen).views
    for name in ("b", "c"):
        turned, moved, focal = errors(found, name)
        assert turned < 0.25
        assert moved < 5
        assert focal < 0.01


TANGENTIAL = (-0.1, 0.03, 0.004, -0.003, 0.0)


def test_errors_contain_the_truth_and_tangential_terms_are_fitted_where_they_are() -> None:
    bent = {name: replace(view, distortion=np.array(TANGENTIAL)) for name, view in RIG.items()}
    found = adjust_bundle(roughly(bent), sightings(0.05, bent))
    for name, view in found.views.items():
        assert abs(view.focal / RIG[name].focal - 1) * 100 < found.errors[name].focal_percent < 2
        assert np.abs(view.matrix[:2, 2] - RIG[name].matrix[:2, 2]).max() < 1.5 * found.errors[name].centre_px
        assert view.distortion[2:4] == pytest.approx(TANGENTIAL[2:4], abs=0.003)
    assert "focal length ± " in str(found.errors["b"])


def test_terms_that_the_corners_do_not_bear_stay_out() -> None:
    found = adjust_bundle(roughly(RIG), sightings(0.05))
    assert sum(not view.distortion[2:].any() for view in found.views.values()) >= 2


def test_where_the_board_moved_between_the_images_lenses_are_from_each_cameras_own() -> None:
    seen = {}
    for (name, moment), (places, pixels) in sightings(0.05).items():
        seen[name, moment] = places, pixels + (4 * np.sin(3.0 * moment) if name == "b" else 0.0)
    found = adjust_bundle(roughly(RIG), seen)
    assert found.apart_px is not None
    assert found.apart_px < 0.1 < found.rms_px
    for name in RIG:
        assert 100 * errors(found.views, name)[2] < found.errors[name].focal_percent


@pytest.mark.parametrize("noise_px", [0.05, 0.16])
def test_a_fisheye_that_a_perspective_lens_nearly_fits_is_found(noise_px: float) -> None:
    """From eight boards a perspective lens fitted its corners within 0.2 px, 17 % off in focal length.

    With more noise, its residual is within 25 % of the fisheye's.
    """
    matrix = np.array([[282.0, 0, 321.3], [0, 282.0, 237.6], [0, 0, 1]])
    true = Lens(matrix, np.array([-0.02, 0.004, -0.001, 0.0003]), is_fisheye=True)
    rng, seen = np.random.default_rng(3), list[dict[int, Array]]()
    while len(seen) < 8:
        turn = cv2.Rodrigues(rng.uniform((-0.6, -0.6, -0.4), (0.6, 0.6, 0.4)))[0]
        away = rng.uniform(0.2, 0.45)
        middle = away * np.array([*rng.uniform((-1.4, -0.9), (1.4, 0.9)), 1.0])
        points = (PLACES - PLACES.mean(0)) @ turn.T + middle
        if points[:, 2].min() < 0.05:
            continue
        at = true.project(points[:, :2] / points[:, 2:]) + rng.normal(0, noise_px, (len(PLACES), 2))
        inside = np.flatnonzero((at > 0).all(1) & (at < (640, 480)).all(1))
        if len(inside) >= 8:
            seen.append({int(number): at[number].astype(np.float32) for number in inside})
    found = calibrate_lens("wide", (640, 480), DEFAULT_BOARD, seen)
    assert found.is_fisheye
    assert found.matrix[0, 0] == pytest.approx(282, rel=0.005 if noise_px < 0.1 else 0.01)
    # The model that is asked for is fitted, whatever the corners say.
    asked = calibrate_lens("wide", (640, 480), DEFAULT_BOARD, seen, LensModel.PERSPECTIVE)
    assert not asked.is_fisheye


def test_what_a_term_that_is_left_out_had_explained_goes_to_the_others() -> None:
    """As the normal distribution of the others is, once these are known to be 0."""
    rng = np.random.default_rng(4)
    spread = rng.normal(size=(9, 9))
    covariance = spread @ spread.T + 9 * np.eye(9)
    lens = np.array([300.0, 300, 160, 120, 50, 40, 0.1, 0.2, 0.3])
    terms, left = _borne_terms(False, frozenset(range(9)), lens, covariance, 4.0)
    assert terms == frozenset({0, 1, 2, 3, 4, 5})
    known = [8, 6, 7]
    gain = covariance[:, known] @ np.linalg.inv(covariance[np.ix_(known, known)])
    assert left[:6] == pytest.approx((lens - gain @ lens[known])[:6])
    assert left[6:].tolist() == [0, 0, 0]
    # A term that is clear stays, and with the last radial one the first.
    sure = np.append(lens[:8], 90.0)
    terms, left = _borne_terms(False, frozenset(range(9)), sure, covariance, 4.0)
    assert terms == frozenset({0, 1, 2, 3, 4, 5, 8})
    assert _borne_terms(False, frozenset(), lens, covariance, 4.0)[0] == frozenset()
    # A fisheye's terms are left out from the last one on, up to the first that is clear.
    bent = np.array([140.0, 140, 160, 120, 50, 40, 60, 0.1, 0])
    assert _borne_terms(True, frozenset(range(8)), bent, covariance, 4.0)[0] == frozenset(range(7))


def test_the_gradient_is_that_of_the_loss_with_what_lenses_are_like() -> None:
    seen = sightings(0.3)
    bundle = Adjustment(RIG, seen, dict.fromkeys(RIG, frozenset(range(9))), 0.3)
    values = bundle.start()
    values[bundle.free] *= 1 + 1e-4 * np.random.default_rng(1).normal(size=int(bundle.free.sum()))
    loss, normal, gradient = bundle._linearize(values)
    assert np.isfinite(loss)
    assert normal == pytest.approx(normal.T)
    for place in (0, 3, 5, 8, 10, 15, 16, 25, 28, len(values) - 1):
        step = np.zeros(len(values))
        step[place] = max(1e-6, 1e-6 * abs(values[place]))
        slope = (bundle._linearize(values + step)[0] - bundle._linearize(values - step)[0]) / (
            2 * step[place]
        )
        if bundle.free[place]:
            assert gradient[place] == pytest.approx(slope, rel=1e-2, abs=1e-3 * abs(gradient).max()), place
        else:
            assert gradient[place] == 0
    # The first camera's pose is the rig's, and corners that were misread count less.
    assert not bundle.free[9:15].any()
    assert bundle.free[24:30].all()


def test_errors_are_those_of_the_terms_that_were_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """With those terms known exactly, what is left of an error is the change by the terms left out."""
    plain = adjust_bundle(RIG, sightings(0.3)).errors
    covariance, calls = Adjustment.covariance, list[int]()

    def known(self: Adjustment, values: np.ndarray) -> np.ndarray:
        calls.append(len(values))
        return covariance(self, values) * (1.0 if len(calls) % 2 else 0.0)

    monkeypatch.setattr(Adjustment, "covariance", known)
    exact = adjust_bundle(RIG, sightings(0.3)).errors
    assert len(calls) % 2 == 0
    for name in RIG:
        assert exact[name].focal_percent < 0.8 * plain[name].focal_percent
        assert exact[name].focal_percent > 0


def corners_of(seen: Sightings) -> dict[tuple[str, int], dict[int, np.ndarray]]:
    """The corners by their numbers, as a detector finds them."""
    numbers = {tuple(place): number for number, place in enumerate(PLACES)}
    return {
        key: {numbers[tuple(place)]: at for place, at in zip(places, pixels, strict=True)}
        for key, (places, pixels) in seen.items()
    }


def test_known_lenses_stay_and_the_rig_is_chained_from_its_first_camera(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset: Any = SimpleNamespace(name="rig", cameras=tuple(RIG), size=lambda name: (WIDTH, HEIGHT))
    corners = corners_of(sightings(0.05))
    lenses = {name: view.lens for name, view in RIG.items()}
    calibration, errors_by_camera = calibrate_from_board(dataset, DEFAULT_BOARD, corners, lenses)
    assert calibration.unit == "m"
    assert calibration.source == (
        f"ChArUco board in {len(corners)} images of rig, lenses of a, b, c from recordings of their own"
    )
    assert calibration.known_lenses.level == "well"
    for name, view in RIG.items():
        found = View.from_calibration(calibration.cameras[name], WIDTH, HEIGHT)
        assert found.focal == pytest.approx(view.focal)
        assert errors({**RIG, name: found}, name) == pytest.approx((0, 0, 0), abs=1.0)
        assert 15 < (calibration.cameras[name].seen_deg or 0) < 40
        assert errors_by_camera[name].focal_percent == 0
    assert "the board moved" not in capsys.readouterr().err
    # A camera whose lens is not known is calibrated by its own corners, in the order of moments.
    asked: list[Any] = []

    def calibrated(name: str, size: Any, board: Any, seen: Any, model: Any) -> Lens:
        asked.append((name, size, len(seen), model.name))
        return lenses[name]

    monkeypatch.setattr(board_calibration, "calibrate_lens", calibrated)
    bundle = SimpleNamespace(
        views=RIG, errors={name: SimpleNamespace(focal_percent=3.0) for name in RIG}, rms_px=0.9, apart_px=0.2
    )
    monkeypatch.setattr(board_calibration, "adjust_bundle", lambda views, seen, kept: bundle)
    some = {"a": lenses["a"], "b": lenses["b"]}
    calibration, _ = calibrate_from_board(dataset, DEFAULT_BOARD, corners, some)
    boards = sum(name == "c" for name, _ in corners)
    assert asked == [("c", (WIDTH, HEIGHT), boards, "AUTO")]
    assert calibration.known_lenses.level == "roughly"
    assert "off by up to 3 to 3 % (95 %)" in calibration.source
    said = capsys.readouterr().err
    assert "corners fit all cameras together within 0.90 px, each alone within 0.20 px: the board" in said
    lonely = {key: seen for key, seen in corners.items() if key[0] != "c" or key[1] < 1}
    with pytest.raises(BadInputError, match=r"c and \w show the board together at 1 instant"):
        calibrate_from_board(dataset, DEFAULT_BOARD, lonely, lenses)
