"""Each file of a drawn folder shows its truth, whatever wrote it: images of all kinds, and videos."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.sessions.drawn_folders import (
    KINDS,
    Film,
    Folder,
    Picture,
    Shot,
    draw_folders,
    draw_shot,
    read_shot,
    write_folder,
)

SEED = 3
FOLDERS = draw_folders(SEED, 2 * len(KINDS))


def test_a_seed_draws_equal_folders_again() -> None:
    assert [one.paths for one in FOLDERS] == [one.paths for one in draw_folders(SEED, len(FOLDERS))]
    assert [one.paths for one in FOLDERS] != [one.paths for one in draw_folders(SEED + 1, len(FOLDERS))]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.kind)
def test_no_path_is_drawn_twice_and_cameras_have_names(folder: Folder) -> None:
    assert len(folder.paths) == len(set(folder.paths))
    assert {shot.camera for shot in folder.shots} <= set(range(len(folder.names)))


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff"])
def test_an_image_file_shows_its_shot(suffix: str, tmp_path: Path) -> None:
    shot = Shot(camera=11, instant=1023, take=3)
    folder = Folder((("a",),), (Picture(f"a/1{suffix}", shot), Picture(f"b{suffix}", None)))
    write_folder(folder, tmp_path)
    assert _read(tmp_path / f"a/1{suffix}") == shot
    assert _read(tmp_path / f"b{suffix}") is None


@pytest.mark.parametrize("suffix", [".mp4", ".avi", ".mkv", ".mov"])
def test_each_frame_of_a_film_shows_its_shot(suffix: str, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    film = next(folder.films[0] for folder in FOLDERS if folder.films and len(folder.films[0].shots) > 10)
    film = Film(f"film{suffix}", film.shots, film.fps)
    write_folder(Folder((("a",),), films=(film,)), tmp_path)
    with av.open(str(tmp_path / film.path)) as container:
        frames = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    assert tuple(read_shot(frame) for frame in frames) == film.shots


def test_a_damaged_picture_shows_nothing() -> None:
    image = draw_shot(Shot(1, 2))
    image[:8, :8] = 255 - image[:8, :8]
    assert read_shot(image) is None


def _read(path: Path) -> Shot | None:
    image = cv2.imread(str(path))
    assert image is not None
    return read_shot(image.astype(np.uint8))
