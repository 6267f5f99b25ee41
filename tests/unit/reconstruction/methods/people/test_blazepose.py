"""The detector: its weights are checked, and what is missing is said with the command that fetches it."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.methods.people import blazepose_weights
from reconstruction.methods.people.blazepose import BlazePose, Crop, _refined
from reconstruction.methods.people.blazepose_weights import DETECTOR, fetch, find_weights
from reconstruction.scene.scene import Scene
from tests.project import JUMPER


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder that may have weights."""
    monkeypatch.setattr(blazepose_weights, "folders", lambda: [tmp_path])
    return tmp_path


def test_damaged_weights_are_refused(elsewhere: Path) -> None:
    (elsewhere / DETECTOR).write_bytes(b"TFL3")
    with pytest.raises(NotAvailableError, match="damaged"):
        find_weights("full")


def test_a_download_that_fails_writes_nothing(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blazepose_weights, "_wheel_command", lambda target: ["false"])
    with pytest.raises(NotAvailableError, match="cannot be fetched"):
        fetch()
    assert list(elsewhere.iterdir()) == []


def test_a_file_that_is_not_the_published_one_is_not_stored(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = ["cp", "/dev/null", DETECTOR]
    monkeypatch.setattr(blazepose_weights, "_wheel_command", lambda target: copy)
    with pytest.raises(NotAvailableError, match="not the published file"):
        fetch()
    assert list(elsewhere.iterdir()) == []


def test_a_crop_is_upright_and_not_mirrored() -> None:
    crop = Crop(np.array([100.0, 200.0]), np.array([100.0, 100.0]))
    corner, right = (crop.image_from_crop @ [x, y, 1] for x, y in ((-0.5, -0.5), (255.5, -0.5)))
    assert corner.tolist() == pytest.approx([-25, 75])
    assert right.tolist() == pytest.approx([225, 75])


def test_a_landmark_is_where_the_model_sees_it() -> None:
    rows, columns = np.indices((900, 700))
    light = 250 * np.exp(-((columns - 315) ** 2 + (rows - 415) ** 2) / 2 / 40**2)
    image = np.repeat(light[..., None], 3, axis=2).astype(np.uint8)

    def see(square: Array) -> dict[int, Array]:
        """Return landmarks in the middle of the light, from the crop's corner as the model counts."""
        weights = square[..., 0] / square[..., 0].sum()
        middle = [(weights * axis).sum() + 0.5 for axis in np.indices(weights.shape)[::-1]]
        landmarks = np.column_stack([np.tile(middle, (39, 1)), np.full((39, 3), 5.0)])
        return {195: landmarks, 39 * 64 * 64: np.full((64, 64, 39), -9.0), 1: np.ones(1)}

    detector = BlazePose.__new__(BlazePose)
    detector._landmarks = see  # type: ignore[assignment]
    landmarks, _ = detector._look(image, Crop(np.array([320.0, 440.0]), np.array([320.0, 140.0])))
    assert landmarks[0, :2] == pytest.approx([315, 415], abs=0.1)


def test_heat_moves_a_landmark_and_none_leaves_it() -> None:
    heat = np.full((64, 64, 3), -20.0)
    heat[10, 20:22, :2] = 5.0
    points = np.array([[78.0, 38.0], [200.0, 200.0], [-9.0, 30.0]])
    assert _refined(points, heat) == pytest.approx(np.array([[82, 40], [200, 200], [-9, 30]]), abs=1e-3)


def watched() -> tuple[BlazePose, list[tuple[float, ...]]]:
    """Return a detector of one person, whom all crops show, and the parts of images that it searches."""
    parts = list[tuple[float, ...]]()
    crop = Crop(np.array([50.0, 60.0]), np.array([50.0, 10.0]))

    def search(image: Array, *part: int) -> list[Crop]:
        parts.append(part)
        return [crop]

    detector = BlazePose.__new__(BlazePose)
    detector._followed, detector._last_s, detector._searched_s = [], -np.inf, -np.inf
    landmarks = np.ones((39, 3))
    landmarks[[33, 34], :2] = crop
    detector._search = search  # type: ignore[method-assign, assignment]
    detector._look = lambda image, crop: (landmarks, 0.9)  # type: ignore[method-assign]
    return detector, parts


@pytest.mark.parametrize("rate_hz", [24, 30, 60, 120])
def test_people_are_searched_for_four_times_a_second_at_any_rate(rate_hz: int) -> None:
    detector, parts = watched()
    for k in range(2 * rate_hz):
        assert len(detector.detect(np.zeros((100, 100, 3), np.uint8), k / rate_hz)[0]) == 1
    assert 7 <= len(parts) <= 8


def test_nobody_is_followed_over_a_pause() -> None:
    detector, parts = watched()
    for at_s in (0.0, 0.1, 100.0, 100.1, 300.0):
        detector.detect(np.zeros((100, 100, 3), np.uint8), at_s)
    assert len(parts) == 3
    detector._search = lambda image, *part: []  # type: ignore[method-assign]
    assert len(detector.detect(np.zeros((100, 100, 3), np.uint8), 300.1)[0]) == 1
    assert len(detector.detect(np.zeros((100, 100, 3), np.uint8), 900.0)[0]) == 0


def test_squares_along_the_longer_side_are_searched_too() -> None:
    detector, parts = watched()
    detector.detect(np.zeros((90, 160, 3), np.uint8), 0.0)
    assert parts == [(0, 0, 160, 90), (0, 0, 90, 90), (35, 0, 90, 90), (70, 0, 90, 90)]
    detector.detect(np.zeros((160, 90, 3), np.uint8), 9.0)
    assert parts[-3:] == [(0, 0, 90, 90), (0, 35, 90, 90), (0, 70, 90, 90)]


def test_a_person_in_a_square_is_where_the_image_shows_them() -> None:
    detector, outputs = BlazePose.__new__(BlazePose), dict[int, Array]()
    anchors = 28 * 28 * 2 + 14 * 14 * 2 + 7 * 7 * 6
    outputs[anchors], outputs[12 * anchors] = np.full(anchors, -9.0), np.zeros((anchors, 12))
    outputs[anchors][0] = 9.0  # in the first cell of 28
    detector._detector = lambda square: outputs  # type: ignore[assignment]
    ((hip, _),) = detector._search(np.zeros((90, 160, 3), np.uint8), 70, 0, 90, 90)
    assert hip.tolist() == pytest.approx([70 + 90 / 56 - 0.5, 90 / 56 - 0.5])


def test_the_rendered_jumper_is_one_person_with_its_left_on_its_left() -> None:
    try:
        find_weights("full")
    except NotAvailableError:
        pytest.skip("the weights of BlazePose were never fetched")
    dataset = Scene.open(JUMPER).dataset
    pixels, confidence = BlazePose("full").detect(dataset.image("cam00", 2), 0.0)
    assert pixels.shape == (1, 33, 2)
    assert confidence[0, 11:13].min() > 0.9
    left, right = pixels[0, 11], pixels[0, 12]
    assert abs(left[0] - right[0]) > 5
