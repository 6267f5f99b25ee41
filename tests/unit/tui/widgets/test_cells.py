"""Images as cells: sizes, colours, and what is sent again when a picture changes a little."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.color import ColorType
from rich.style import Style

from capture_app.tui.widgets.cells import (
    CellPicture,
    Palette,
    changed_spans,
    draw_cells,
    fitted_cells,
    keep_equal_cells,
)


def scene(width: int, height: int) -> np.ndarray:
    """A gradient with a bright disc in it, BGR."""
    y, x = np.mgrid[:height, :width]
    image = np.stack([x * 255 // width, y * 255 // height, (x + y) * 127 // (width + height)], axis=2)
    image[(x - width // 2) ** 2 + (y - height // 2) ** 2 < (height // 4) ** 2] = (30, 220, 250)
    return image.astype(np.uint8)


def seen(cells: CellPicture) -> np.ndarray:
    """The RGB image that a person sees, two pixels a cell in both directions."""
    columns, rows = cells.size
    quarters = cells.pixels().reshape(rows, columns, 2, 2, 3)
    return quarters.transpose(0, 2, 1, 3, 4).reshape(2 * rows, 2 * columns, 3)


@given(st.integers(1, 4000), st.integers(1, 4000), st.integers(1, 300), st.integers(1, 100))
def test_an_image_fits_its_room_and_fills_it_in_one_direction(
    width: int, height: int, columns: int, rows: int
) -> None:
    across, down = fitted_cells(width, height, columns, rows)
    assert 1 <= across <= columns
    assert 1 <= down <= rows
    assert across == columns or down == rows


def test_a_wide_image_keeps_its_proportions() -> None:
    assert fitted_cells(640, 480, 80, 24) == (64, 24)
    assert fitted_cells(1920, 1080, 80, 24) == (80, 22)
    assert fitted_cells(480, 640, 80, 24) == (36, 24)


def test_cells_of_two_colours_show_exactly_what_is_there() -> None:
    left_half = np.zeros((2, 2, 3), np.uint8)
    left_half[:, 0] = (1, 2, 250)
    cells = draw_cells(left_half, Palette.TRUECOLOR)
    assert np.array_equal(seen(cells), left_half[..., ::-1])
    assert cells.strip(0, Style()).text == "▌"
    style = next(iter(cells.strip(0, Style()))).style
    assert style is not None
    assert style.color is not None
    assert style.color.triplet == (250, 2, 1)


def test_quarters_show_more_than_halves() -> None:
    image = scene(80, 48)
    cells = draw_cells(image, Palette.TRUECOLOR)
    halves = cv2.resize(cv2.resize(image, (40, 48), interpolation=cv2.INTER_AREA), (80, 48), interpolation=0)
    assert cv2.PSNR(seen(cells)[..., ::-1].copy(), image) > cv2.PSNR(halves, image)


def test_256_colours_are_those_that_a_terminal_has() -> None:
    cells = draw_cells(scene(160, 96), Palette.EIGHT_BIT)
    cube = {0, 95, 135, 175, 215, 255}
    for red, green, blue in cells.inks.reshape(-1, 3).tolist():
        assert {red, green, blue} <= cube or (red == green == blue and red % 10 == 8)
    for row in range(cells.size.height):
        for segment in cells.strip(row, Style()):
            assert segment.style is not None
            assert segment.style.color is not None
            assert segment.style.color.type is ColorType.EIGHT_BIT
    error = np.abs(seen(cells).astype(int) - scene(160, 96)[..., ::-1])
    assert error.mean() < 20


def test_greys_are_grey() -> None:
    cells = draw_cells(scene(80, 48), Palette.GREYS)
    assert (cells.inks == cells.inks[..., :1]).all()
    assert len(np.unique(cells.inks)) > 50


def test_dots_are_denser_where_it_is_brighter() -> None:
    image = scene(160, 192)
    plain = Style(bold=True)

    def dots(cells: CellPicture) -> np.ndarray:
        return np.array(
            [[ord(c).bit_count() for c in cells.strip(r, plain).text] for r in range(cells.size.height)]
        )

    dark, light = draw_cells(image, Palette.DOTS), draw_cells(image, Palette.DOTS, light=True)
    assert dots(dark).shape == (48, 80)
    middle = (slice(18, 30), slice(34, 46))
    assert dots(dark)[middle].mean() > dots(dark).mean()
    assert dots(light)[middle].mean() < dots(light).mean()


def test_noise_is_not_sent_again_and_a_change_is() -> None:
    image = scene(80, 48)
    shown = draw_cells(image, Palette.TRUECOLOR)
    noise = np.random.default_rng(3).integers(-2, 3, image.shape)
    noisy = np.clip(image.astype(int) + noise, 0, 255).astype(np.uint8)
    noisy[20:24, 10:14] = 255 - noisy[20:24, 10:14]
    new = draw_cells(noisy, Palette.TRUECOLOR)
    assert len(changed_spans(shown, new) or ()) == 24
    kept = keep_equal_cells(shown, new, 12)
    spans = changed_spans(shown, kept)
    assert spans is not None
    assert [span for span in spans if span[2] - span[1] >= 2] == [(10, 5, 7), (11, 5, 7)]
    assert sum(end - start for _, start, end in spans) < 0.02 * shown.glyphs.size
    assert np.abs(seen(kept).astype(int) - seen(new)).max() <= 12


@pytest.mark.parametrize("palette", list(Palette))
def test_pictures_of_other_sizes_are_new(palette: Palette) -> None:
    small, large = draw_cells(scene(40, 24), palette), draw_cells(scene(80, 48), palette)
    assert changed_spans(small, large) is None
    assert keep_equal_cells(small, large, 255) is large
    assert changed_spans(large, draw_cells(scene(80, 48), palette)) == []
