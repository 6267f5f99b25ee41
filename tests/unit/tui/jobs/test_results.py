"""Results are read as they were written, and what is not there is said."""

from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.tui.jobs.result_screen import read_result
from tests.unit.tui.jobs.found import (
    VERDICT,
    add_clouds,
    add_comparison,
    add_depth,
    add_dose,
    add_panel,
    add_panorama,
)


def test_a_comparison(tmp_path: Path) -> None:
    result = read_result(add_comparison(tmp_path, "take"))
    assert result.verdict == VERDICT
    assert [picture.title for picture in result.pictures] == ["Distance", "Panorama", "Late"]
    assert all(picture.synced.is_file() for picture in result.pictures)
    assert {picture.offset_label for picture in result.pictures} == {"67 ms late"}
    assert result.tables[0].rows[0][:3] == ("Measured correctly", "96.8 %", "1.6 %")
    assert result.notes == ("no multiview: it was not requested",)


def test_a_panorama(tmp_path: Path) -> None:
    result = read_result(add_panorama(tmp_path, "take"))
    assert result.pictures[0].offset_label == "67 ms offset"
    assert [picture.synced.name for picture in result.pictures] == [
        "panorama_synced.jpg",
        "ghosts_synced.jpg",
    ]
    assert result.notes == ("cam02 is left out: it shows nothing that the others show",)


def test_clouds_of_every_instant(tmp_path: Path) -> None:
    log = ["[1/2] instant 0", "instant 1 has no cloud: no camera has a picture", "1 cloud"]
    result = read_result(add_clouds(tmp_path, "take"), log)
    assert result.notes == tuple(log[1:])


def test_a_sentence_is_a_note_once(tmp_path: Path) -> None:
    run = add_panorama(tmp_path, "take")
    left_out = "cam02 is left out: it shows nothing that the others show"
    log = [left_out, "the axes are the calibration's own", "the axes are the calibration's own", run.message]
    assert read_result(run, log).notes == (left_out, "the axes are the calibration's own")


def test_a_dose(tmp_path: Path) -> None:
    assert read_result(add_dose(tmp_path, "take"), ["33 ms late: 20 %"]).notes == ("33 ms late: 20 %",)


def test_depth_from_all_cameras(tmp_path: Path) -> None:
    result = read_result(add_depth(tmp_path, "take"))
    assert [picture.offset for picture in result.pictures] == [None, None]
    assert result.pictures[0].caption == "1.2 to 7 m; dark: no distance"


def test_a_panel(tmp_path: Path) -> None:
    result = read_result(add_panel(tmp_path, "take"))
    apart, seen = result.tables
    assert seen.rows[1][:4] == ("cam01", "5", "1", "±10 µs")
    assert apart.columns[:2] == ("error", "mean abs")
    assert apart.rows[0][:3] == ("cam00 - cam01", "total", "32 µs")
    assert result.notes == ("panel led-pair: a tick of 200 µs, the same again after 1.0 s",)


def test_a_panel_that_one_camera_saw(tmp_path: Path) -> None:
    result = read_result(add_panel(tmp_path, "take", compared=False))
    assert [table.rows[0][0] for table in result.tables] == ["cam00"]


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"studies": [{"pictures": [1]}]}', '{"words": {"tables": 5}}']
)
def test_a_file_that_is_not_ours_is_said_to_be_so(tmp_path: Path, text: str) -> None:
    job = add_comparison(tmp_path, "take")
    assert job.result is not None
    job.result.write_text(text)
    with pytest.raises(BadInputError, match="run it again"):
        read_result(job)


def test_pictures_outside_of_the_folder_are_not_read(tmp_path: Path) -> None:
    job = add_comparison(tmp_path, "take")
    assert job.result is not None
    job.result.write_text(
        job.result.read_text().replace("pictures/panorama_synced.jpg", "../../../../etc/passwd")
    )
    with pytest.raises(BadInputError):
        read_result(job)
