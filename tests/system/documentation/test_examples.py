"""The scripts of docs/examples run as they are, from the project's folder."""

from collections.abc import Callable
from pathlib import Path

from tests.unit.documentation.test_examples import (
    run,
    run_here,  # noqa: F401 - a fixture
)


def test_error_bars_of_each_camera_are_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "error_bars.svg"
    run("error_bars.py", picture)
    drawn = picture.read_text()
    assert all(f"<!-- {name} -->" in drawn for name in ("cam00", "cam01", "cam04", "cam05", "cam06"))


def test_a_dataset_has_an_image_and_a_mask_for_each_frame(
    run_here: Callable[..., str], tmp_path: Path
) -> None:
    assert "5 cameras, 5 instants" in run_here("masked_dataset.py", tmp_path / "dataset")
    assert len(list(tmp_path.rglob("*-mask.png"))) == len(list(tmp_path.rglob("*-image.png"))) == 25


def test_a_burst_of_simulated_cameras(tmp_path: Path) -> None:
    assert "3 cameras, 5 instants" in run("take_burst.py", tmp_path)
