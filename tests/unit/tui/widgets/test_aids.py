"""Focus and exposure, on pictures of which they are known."""

import cv2
import numpy as np
import pytest

from capture_app.tui.widgets.focus_aids import exposure_of, paint_marks, peaking, sharpness, zebra


def checkers(blur: float = 0.0) -> np.ndarray:
    """A chess board, in focus or not."""
    board = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((20, 20))) * 160 + 40
    image = np.repeat(board.astype(np.uint8)[..., None], 3, axis=2)
    return cv2.GaussianBlur(image, (0, 0), blur) if blur else image


def test_the_focus_number_is_the_greater_the_sharper() -> None:
    numbers = [sharpness(checkers(blur)) for blur in (0, 1, 2, 4, 8)]
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[0] > 5 * numbers[2]


def test_the_focus_number_does_not_depend_on_the_light() -> None:
    bright = checkers(1)
    dim = (bright // 2).astype(np.uint8)
    assert sharpness(dim) == pytest.approx(sharpness(bright), rel=0.1)
    assert sharpness(np.full((20, 20), 128, np.uint8)) == 0.0


def test_peaking_marks_edges_in_focus_only() -> None:
    half = checkers()
    half[:, 160:] = checkers(4)[:, 160:]
    ((mask, _, _),) = peaking(half)
    assert mask[:, :150].mean() > 0.1
    assert not mask[:, 170:].any()


def test_zebra_marks_what_is_clipped() -> None:
    image = np.full((40, 80, 3), 120, np.uint8)
    image[:, :20] = 0
    image[:, 60:, 2] = 255
    (highlights, colour, _), (shadows, _, _) = zebra(image)
    assert highlights[:, 60:].all()
    assert highlights.sum() == 40 * 20
    assert shadows[:, :20].all()
    assert shadows.sum() == 40 * 20
    painted = paint_marks(image, image, [zebra])
    striped = (painted[:, 60:] == colour).all(axis=2)
    assert striped.mean() == pytest.approx(0.5)
    assert np.array_equal(painted[:, 20:60], image[:, 20:60])
    assert image[:, :20].max() == 0, "what is measured is not painted on"


def test_exposure_in_numbers() -> None:
    image = np.full((40, 80, 3), 120, np.uint8)
    image[:, :20] = 0
    image[:, 70:] = 255
    exposure = exposure_of(image, bins=16)
    assert exposure.shadows == 0.25
    assert exposure.highlights == 0.125
    assert sum(exposure.histogram) == pytest.approx(1.0)
    assert exposure.histogram[0] == 0.25
    assert exposure.histogram[7] == 0.625
    assert exposure.histogram[15] == 0.125
    assert exposure.mean == pytest.approx(120 * 0.625 + 255 * 0.125)


def test_marks_survive_the_way_to_few_cells() -> None:
    line = np.full((480, 640, 3), 100, np.uint8)
    line[:, 320:] = 200
    small = cv2.resize(line, (64, 48), interpolation=cv2.INTER_AREA)
    ((_, colour, _),) = peaking(line)
    painted = paint_marks(small, line, [peaking])
    marked = (painted == colour).all(axis=2)
    assert marked[:, 31:33].any(axis=1).all()
    assert marked.sum() <= 2 * 48
