"""Pictures of a report: embedded, described, and moved by a slider or a sweep."""

from pathlib import Path

import msgspec
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult
from reconstruction.report.comparison_report import write_report
from tests.unit.reconstruction.report.conftest import ReadReport
from tests.unit.reconstruction.report.results import CAMERAS, RESULT, changed_facts, found, with_pictures


def test_every_picture_can_be_read_and_wiped_without_a_mouse(
    pictured: CompareResult, read_report: ReadReport
) -> None:
    page = read_report(pictured)
    assert all(len(image["alt"]) > 10 for image in page.all("img"))
    sliders = [i for i in page.all("input") if i["type"] == "range"]
    assert len(sliders) == len(found(pictured, "stereo").pictures)
    assert all(slider["aria-label"] and "tabindex" not in slider for slider in sliders)
    assert len(page.all("figcaption")) == len(found(pictured, "stereo").pictures)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.elements:
        assert attributes.get("aria-labelledby", "why") in ids


def test_pictures_of_several_panels_get_no_slider(pictured: CompareResult, read_report: ReadReport) -> None:
    pair = msgspec.structs.replace(found(pictured, "stereo").pictures[0], panels=2)
    page = read_report(with_pictures(pictured, pair))
    assert len(page.all("img")) == 2
    assert not [i for i in page.all("input") if i["type"] == "range"]


def test_the_sweep_shows_each_camera_twice_and_says_how_late_it_is(
    read_report: ReadReport, whole: CompareResult
) -> None:
    page = read_report(whole)
    frames = [a for a in page.all("span") if a.get("class") == "frame"]
    assert [a["data-camera"] for a in frames] == [*CAMERAS, *CAMERAS]
    assert [a["data-time"].replace(wording.GAP, " ") for a in frames[3:]] == [
        "on time", "67 ms late", "33 ms early"
    ]  # fmt: skip
    assert "no pixel is invented" in page.text
    assert "As a file to share: pictures/sweep.gif" in page.text
    assert (
        "shifts by at most 4.70 px from one picture to the next; without synchronization, 18.7 px"
        in page.text
    )
    loose = changed_facts(
        found(whole, "bullet_time"), stabilized=False, ordered_by_position=False, offset_step_px=5.0
    )
    page = read_report(whole, loose)
    assert "invented" not in page.text
    assert "4.70 px" not in page.text
    assert "from camera to camera, by name" in page.text


def test_every_file_beside_the_page_is_named(
    tmp_path: Path, read_report: ReadReport, whole: CompareResult
) -> None:
    page = read_report(whole)
    shown = page.text[page.text.index("Every file beside this page") :]
    made = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.png")}
    assert len(made) > 30
    assert all(path in shown for path in made)
    for path in ("metrics.json", "pictures/sweep.gif", "sessions/jump"):
        assert path in shown


@pytest.mark.parametrize("broken", ["missing", "text", "cut"])
def test_a_picture_that_cannot_be_shown_leaves_the_old_report_alone(
    tmp_path: Path, pictured: CompareResult, broken: str
) -> None:
    before = write_report(RESULT, tmp_path).read_bytes()
    victim = tmp_path / found(pictured, "stereo").pictures[0].offset
    if broken == "missing":
        victim.unlink()
    else:
        victim.write_bytes(b"not a picture" if broken == "text" else victim.read_bytes()[:12])
    with pytest.raises(BadInputError, match=r"depth_offset\.png"):
        write_report(pictured, tmp_path)
    assert (tmp_path / "report.html").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pictures", "report.html"]
