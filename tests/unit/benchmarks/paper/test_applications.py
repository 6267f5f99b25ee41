"""The paper's applications on its page: read from what `reconstruct compare` writes."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from benchmarks.paper import page
from benchmarks.paper.applications import APPLICATIONS, read_compared
from capture_app.common.errors import BadInputError
from reconstruction.method.study_result import Interval, Measure, Picture, StudyResult
from tests.project import SAMPLES

OVERLAP = Picture(key="panorama_overlap", title="", synced="pictures/one.png", offset="pictures/other.png")


@pytest.fixture
def compared(tmp_path: Path) -> Path:
    """A folder with a panorama and a burst of `crossing`, in the structs that `reconstruct` writes."""
    folder = tmp_path / "crossing"
    (folder / "pictures").mkdir(parents=True)
    for name, level in (("one.png", 90), ("other.png", 30), ("small.jpg", 60)):
        picture = np.full((240, 320, 3), level, np.uint8)
        (folder / "pictures" / name).write_bytes(cv2.imencode(Path(name).suffix, picture)[1].tobytes())
    moving = Measure(name="mover_misfit_px", synced=Interval(value=1.4), offset=Interval(value=18.0))
    still = Measure(name="static_misfit_px", synced=Interval(value=0.1))
    panorama: StudyResult[None] = StudyResult(
        name="panorama", cameras=("cam01", "cam02"), measures=(moving, still), pictures=(OVERLAP,)
    )
    depth: StudyResult[None] = StudyResult(name="stereo", skipped="too little overlap")
    metrics = {"session": "sample_sessions/crossing", "studies": [depth, panorama]}
    (folder / "metrics.json").write_bytes(msgspec.json.encode(metrics))
    return folder


def test_a_panorama_is_shown_in_both_conditions(compared: Path, tmp_path: Path) -> None:
    applications = {one.key: one for one in read_compared([compared], tmp_path)}
    assert list(applications) == [showing.application.key for showing in APPLICATIONS]
    panorama = applications["figure-9"]
    assert [(m.synced, m.offset) for m in panorama.measures] == [(1.4, 18.0), (0.1, None)]
    assert panorama.files == ("figure-9-synced.jpg", "figure-9-offset.jpg")
    levels = [cv2.imread(str(tmp_path / name)).mean() for name in panorama.files]
    assert levels == pytest.approx([90, 30], abs=1)
    assert all(not one.files and not one.measures for one in applications.values() if one is not panorama)


def test_a_burst_becomes_one_picture(compared: Path, tmp_path: Path) -> None:
    small = "pictures/small.jpg"
    metrics = {
        "session": "elsewhere/jumper",
        "studies": [
            {"name": "burst", "facts": {"thumbnails": [[small] * 5] * 3}},
            {"name": "bullet_time", "facts": {"synced_step_px": 6.5, "offset_step_px": 21.6}},
        ],
    }
    (compared / "metrics.json").write_bytes(msgspec.json.encode(metrics))
    burst = read_compared([compared], tmp_path)[0]
    assert [(m.synced, m.offset) for m in burst.measures] == [(6.5, 21.6)]
    assert cv2.imread(str(tmp_path / burst.files[0])).shape == (3 * 150, 5 * 200, 3)


def test_the_page_shows_them_or_says_that_they_were_not_run(compared: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    out, markdown = tmp_path / "out", tmp_path / "docs" / "paper.md"
    out.mkdir()
    page.run(
        out,
        quick=True,
        seed=1,
        compared=[compared],
        markdown=markdown,
        only=frozenset(["none of them"]),
    )
    for text in ((out / "paper.md").read_text(), markdown.read_text()):
        assert text.count("not run for this page") == len(APPLICATIONS) - 1
        assert "18 px" in text.replace("\N{NO-BREAK SPACE}", " ")
        assert "figure-9-offset.jpg" in text
    assert (markdown.parent / "images" / "paper-figure-9-offset.jpg").exists()


def test_sessions_of_the_applications_come_with_the_project() -> None:
    for showing in APPLICATIONS:
        assert (SAMPLES / showing.session / "session.json").exists()
        assert f"sample_sessions/{showing.session}" in showing.application.command


def test_a_folder_of_something_else_is_refused(compared: Path, tmp_path: Path) -> None:
    (compared / "pictures" / "one.png").write_bytes(b"no picture")
    with pytest.raises(BadInputError, match=r"one\.png is not a picture"):
        read_compared([compared], tmp_path)
    (compared / "metrics.json").write_text('{"session": 3}')
    with pytest.raises(BadInputError, match=r"metrics\.json"):
        read_compared([compared], tmp_path)
    with pytest.raises(BadInputError, match="cannot read") as refused:
        read_compared([tmp_path / "nowhere"], tmp_path)
    assert "reconstruct compare" in str(refused.value.hint)
