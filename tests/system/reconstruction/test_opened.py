"""The commands as methods of an open session: results with arrays, and not a word on the terminal."""

import shutil
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import talk
from capture_app.session.reading.array_access import open_session as open_for_pictures
from reconstruction import (
    CalibrateOptions,
    CalibrationSource,
    Panorama,
    Stereo,
    open_session,
)
from tests.project import JUMPER

SAMPLE = JUMPER


def test_depth_comes_as_arrays_and_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    made = open_session(open_for_pictures(SAMPLE)).stereo(Stereo(instant=1, pair=("cam00", "cam01")))
    depth, filled, confidence = made.depth, made.filled, made.confidence
    assert (made.result.reference, made.result.instant, made.result.unit) == ("cam00", 1, "m")
    assert depth.dtype == np.float32
    assert depth.shape == filled.shape == confidence.shape == (480, 640)
    assert (depth > 0).mean() == pytest.approx(made.result.coverage)
    assert (filled > 0).mean() > (depth > 0).mean()
    assert 0.5 < confidence.max() <= 1
    assert capfd.readouterr() == ("", "")
    folder = made.folder
    assert folder.is_dir()
    del made
    assert not folder.exists()


def test_a_session_at_work_in_another_thread_silences_nobody_else(capfd: pytest.CaptureFixture[str]) -> None:
    said = 0
    with ThreadPoolExecutor(1) as pool:
        work = pool.submit(open_session(SAMPLE).stereo, Stereo(instant=1, pair=("cam00", "cam01")))
        while not work.done():
            talk("heard")
            said += 1
            wait([work], 0.02)
    assert work.result().result.instant == 1
    assert capfd.readouterr().err == "heard\n" * said


def test_files_are_kept_where_they_are_asked_for(tmp_path: Path) -> None:
    made = open_session(SAMPLE).panorama(Panorama(instant=1), out=tmp_path / "panorama")
    picture = made.image(made.result.synced.panorama)
    assert picture.shape == (made.result.synced.height, made.result.synced.width, 3)
    file = tmp_path / "panorama" / made.result.synced.panorama
    del made
    assert file.is_file()


def test_a_calibration_that_was_made_is_the_sessions(tmp_path: Path) -> None:
    folder = tmp_path / "jumper"
    shutil.copytree(SAMPLE, folder)
    (folder / "calibration.json").unlink()
    session = open_session(str(folder))
    assert not session.cameras["cam01"].is_calibrated
    result = session.calibrate(CalibrateOptions(source=SAMPLE, keep=False))
    assert result.stored
    assert session.cameras["cam01"].is_calibrated
    with pytest.raises(BadInputError, match="--replace"):
        session.calibrate(CalibrateOptions(source=CalibrationSource.SESSION, keep=False, scale_by_board=True))


def test_a_mistake_is_an_error_of_ours(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no session at"):
        open_session(tmp_path / "none")
    with pytest.raises(BadInputError, match="99"):
        open_session(SAMPLE).stereo(Stereo(instant=99))
