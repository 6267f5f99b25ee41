"""The whole page of a report: self-contained, escaped, and with a way to every section."""

import base64
import re
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.method.comparison_results import CompareResult, ConditionResult
from reconstruction.report.comparison_report import write_report
from tests.unit.reconstruction.report.conftest import Page, ReadReport
from tests.unit.reconstruction.report.results import CAMERAS, NASTY, RESULT, changed_facts, found, skipped


def test_the_page_starts_with_the_verdict_and_its_two_numbers(
    pictured: CompareResult, read_report: ReadReport
) -> None:
    page = read_report(pictured)
    assert len(page.all("h1")) == 1
    start = page.text.index("Synchronized cameras measure moving things.")
    first, second = page.text.index("98 %"), page.text.index("1 %")
    assert start < first < second < page.text.index("Why the instant matters")
    assert "of the moving surface measured correctly" in page.text
    assert "one picture is 67 ms late" in page.text


def test_every_sentence_of_the_page_ends_once(whole: CompareResult, read_report: ReadReport) -> None:
    commands = {"cloud": "reconstruct stereo"}
    studies = [msgspec.structs.replace(study, commands=commands) for study in whole.studies]
    text = read_report(whole, *studies).text
    assert "(SGBM). Its numbers are the score" in text
    assert not re.search(r"\.\s*\.", text)


def test_everything_is_in_the_one_file(tmp_path: Path, pictured: CompareResult) -> None:
    path = write_report(pictured, tmp_path)
    page = Page(path)
    assert path == tmp_path / "report.html"
    images = page.all("img")
    assert len(images) == 6
    for image, name in zip(
        images, [p for q in found(pictured, "stereo").pictures for p in (q.synced, q.offset)], strict=True
    ):
        head, data = image["src"].split(",", 1)
        assert head == "data:image/webp;base64"
        shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        mean, most = _differences(shown, cv2.imread(str(tmp_path / name)))
        # Flat colours are kept to the bit; noise, the worst of photographs, is only nearly the same.
        assert most == 0 if name.endswith("png") else mean < 40
    assert {(i["width"], i["height"]) for i in images} == {("64", "48"), ("300", "40"), ("30", "90")}
    for _, attributes in page.elements:
        for key in ("src", "href", "action"):
            assert attributes.get(key, "data:").startswith(("data:", "#"))
    text = path.read_text("utf-8")
    assert not re.search(r"https?://|@import|url\(", re.sub(r"base64,[^\"]+", "", text))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pictures", "report.html"]


def _differences(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    apart = np.abs(one.astype(float) - other)
    return float(apart.mean()), float(apart.max())


def test_words_of_the_user_stay_words(tmp_path: Path, pictured: CompareResult) -> None:
    path = write_report(pictured, tmp_path)
    page = Page(path)
    assert NASTY.rpartition("/")[2] in page.text
    assert NASTY in page.text
    assert len(page.all("script")) == 1
    assert not page.all("do")
    assert "<do not>" in page.text


def test_no_name_and_no_note_becomes_markup(read_report: ReadReport, whole: CompareResult) -> None:
    nasty = "<script>alert(1)</script>"
    stereo, multiview, poses, sweep, burst = (
        found(whole, name) for name in ("stereo", "multiview", "poses", "bullet_time", "burst")
    )
    cameras = tuple(f"{nasty}{camera}" for camera in CAMERAS)
    picture = msgspec.structs.replace(stereo.pictures[0], title=nasty, caption=nasty)
    unseen = {"reference": nasty, "left_out": {nasty: nasty}}
    late_ms = dict.fromkeys(cameras, 5.0)
    page = read_report(
        whole,
        msgspec.structs.replace(stereo, cameras=(nasty, nasty), reason=nasty, pictures=(picture,)),
        msgspec.structs.replace(
            multiview, cameras=cameras, facts=msgspec.structs.replace(multiview.facts, **unseen)
        ),
        skipped("panorama", nasty),
        msgspec.structs.replace(
            poses,
            cameras=cameras,
            offsets_ms=late_ms,
            reason=nasty,
            facts=msgspec.structs.replace(poses.facts, truth_source=nasty),
        ),
        changed_facts(sweep, cameras=cameras, file=nasty),
        msgspec.structs.replace(burst, facts=burst.facts | {"cameras": cameras}),
        session=nasty,
        verdict=f"{nasty} It matters. {nasty}",
        calibration=nasty,
        conditions=(ConditionResult(name=nasty, session=nasty, studies=(skipped("stereo", nasty),)),),
        versions={nasty: nasty},
    )
    assert len(page.all("script")) == 1
    assert page.text.count(nasty) > 30


def test_the_contents_lead_to_every_section(read_report: ReadReport, whole: CompareResult) -> None:
    page = read_report(whole)
    links = [a["href"].removeprefix("#") for a in page.all("a")]
    headings = [h["id"] for h in page.all("h2")]
    assert links == headings
    assert len(links) == 9


def test_a_long_verdict_is_set_smaller(read_report: ReadReport) -> None:
    pages = [read_report(verdict=verdict) for verdict in ("It matters. A lot.", "word " * 40 + ".")]
    assert [page.all("h1")[0]["class"] for page in pages] == ["short", "long"]


def test_a_verdict_is_a_headline_three_lines_and_the_rest_on_demand(read_report: ReadReport) -> None:
    page = read_report(verdict="It matters. One line. Two lines. Three lines. A fourth. A fifth.")
    before, _, after = page.text.partition("2 more")
    assert before.index("One line.") < before.index("Two lines.") < before.index("Three lines.")
    assert "A fourth. A fifth." in after
    assert "more" not in read_report(verdict="It matters. A lot.").text.partition("A lot.")[0]


def test_how_it_was_made_names_what_decides_the_numbers(read_report: ReadReport) -> None:
    page = read_report()
    for words in (
        "66 ms requested; 66.6 ms applied, which is 2 frames",
        "the session's own (calibration.json)",
        "every picture within 85 µs of its instant",
        "the clocks agree to 1.9 ms in the worst case",
        "cameras cam2 and cam3, 5 instants",
        "14.2 s",
        "opencv 5.0.0",
    ):
        assert words in page.text


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(BadInputError, match=r"cannot write the report .*--out"):
        write_report(RESULT, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_an_unfinished_page_says_what_is_left_and_loads_itself_again(
    pictured: CompareResult, tmp_path: Path
) -> None:
    again = 'http-equiv="refresh"'
    page = write_report(pictured, tmp_path, ["points by COLMAP", "bullet time"]).read_text()
    assert again in page
    assert "Still being measured: points by COLMAP, bullet time." in page
    unknown = msgspec.structs.replace(pictured, tolerance=None)
    assert "was not measured yet" in write_report(unknown, tmp_path, ["time offsets"]).read_text()
    assert "was not measured<" in write_report(unknown, tmp_path, ["bullet time"]).read_text()
    page = write_report(pictured, tmp_path).read_text()
    assert again not in page
    assert "Still" not in page


def test_a_study_that_failed_is_named_first(read_report: ReadReport) -> None:
    failed = msgspec.structs.replace(skipped("burst", "unexpected KeyError in burst.py:7: 'x'"), failed=True)
    page = read_report(RESULT, failed)
    assert "Failed: pictures of the burst: unexpected KeyError in burst.py:7: 'x'." in page.text
