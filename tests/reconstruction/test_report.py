"""The report: whole, self-contained, escaped, and honest about what was not measured."""

import base64
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.errors import BadInputError
from reconstruction.report import wording
from reconstruction.report.report import write_report
from reconstruction.scores.compare_results import CompareResult, ConditionResult
from reconstruction.scores.depth_results import DepthScores, StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison, PanoramaScores
from reconstruction.scores.results import Picture
from tests.reconstruction.report_sample import CAMERAS, whole_result

NASTY = "jump <script>alert('x')</script> & \"pinwheel\" $css {x}"
VOID = {"meta", "link", "img", "input", "br", "circle", "path", "rect"}


@dataclass
class Page(HTMLParser):
    """What a browser would see: elements with their attributes, text, and whether they nest."""

    elements: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    text: str = ""
    stack: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> "Page":
        page = cls()
        HTMLParser.__init__(page)
        page.feed(path.read_text("utf-8"))
        page.close()
        assert page.stack == []
        return page

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, {key: value or "" for key, value in attrs}))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, {key: value or "" for key, value in attrs}))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.stack):
            self.text += data.replace(wording.GAP, " ").replace("\n", " ")

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def depth(**changes: float | None) -> DepthScores:
    scores = DepthScores(
        mover_coverage=0.999,
        static_coverage=0.745,
        mover_within_2pct=0.981,
        static_within_2pct=0.673,
        mover_epipolar_px=0.26,
        instants=5,
    )
    return msgspec.structs.replace(scores, **changes)


STEREO = StereoComparison(
    reference="cam2",
    other="cam3",
    synced=depth(),
    offset=depth(
        mover_coverage=0.405, static_coverage=0.733, mover_within_2pct=0.0112, mover_epipolar_px=17.7
    ),
)
STITCH = PanoramaComparison(
    cameras=("cam0", "cam4"),
    synced=PanoramaScores(
        overlap_flow_p95_px=1.31, static_overlap_mad=4.2, mover_overlap_mad=6.1, instants=5
    ),
    offset=PanoramaScores(
        overlap_flow_p95_px=23.4, static_overlap_mad=4.3, mover_overlap_mad=31.7, instants=5
    ),
)
RESULT = CompareResult(
    session=NASTY,
    offset_ms=66,
    offset_frames=2,
    actual_offset_ms=66.6,
    verdict="Synchronized cameras measure moving things. Late ones <do not>.",
    calibration="the session's own (calibration.json)",
    stereo=STEREO,
    stitch=STITCH,
    sync_residual_us=85.2,
    sync_bound_us=1912,
    seconds=14.24,
    versions={"opencv": "5.0.0"},
)


def with_pictures(result: CompareResult, *pictures: Picture) -> CompareResult:
    stereo = msgspec.structs.replace(result.stereo, pictures=pictures)
    return msgspec.structs.replace(result, stereo=stereo)


@pytest.fixture
def pictured(tmp_path: Path) -> CompareResult:
    """The result with three pictures on disk: ordinary, very wide and upright."""
    random = np.random.default_rng(1)
    (tmp_path / "pictures").mkdir()
    pictures = []
    for key, shape, suffix in (
        ("depth", (48, 64), "png"), ("pano", (40, 300), "jpg"), ("crop", (90, 30), "png")
    ):  # fmt: skip
        names = [f"pictures/{key}_{side}.{suffix}" for side in ("synced", "offset")]
        for name in names:
            assert cv2.imwrite(str(tmp_path / name), random.integers(0, 255, (*shape, 3), np.uint8))
        pictures.append(
            Picture(key=key, title=f'{key} "seen"', synced=names[0], offset=names[1], caption="a<b")
        )
    return with_pictures(RESULT, *pictures)


def test_the_page_starts_with_the_verdict_and_its_two_numbers(tmp_path, pictured):
    page = Page.read(write_report(pictured, tmp_path))

    assert len(page.all("h1")) == 1
    start = page.text.index("Synchronized cameras measure moving things.")
    first, second = page.text.index("98 %"), page.text.index("1 %")
    assert start < first < second < page.text.index("Why the instant matters")
    assert "of the moving surface measured correctly" in page.text
    assert "one picture is 67 ms late" in page.text


def test_everything_is_in_the_one_file(tmp_path, pictured):
    path = write_report(pictured, tmp_path)
    page = Page.read(path)

    assert path == tmp_path / "report.html"
    images = page.all("img")
    assert len(images) == 6
    for image, name in zip(
        images, [p for q in pictured.stereo.pictures for p in (q.synced, q.offset)], strict=True
    ):
        head, data = image["src"].split(",", 1)
        assert head == f"data:image/{'jpeg' if name.endswith('jpg') else 'png'};base64"
        assert base64.b64decode(data) == (tmp_path / name).read_bytes()
    assert {(i["width"], i["height"]) for i in images} == {("64", "48"), ("300", "40"), ("30", "90")}
    for _, attributes in page.elements:
        for key in ("src", "href", "action"):
            assert attributes.get(key, "data:").startswith(("data:", "#"))
    text = path.read_text("utf-8")
    assert not re.search(r"https?://|@import|url\(", re.sub(r"base64,[^\"]+", "", text))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pictures", "report.html"]


def test_every_picture_can_be_read_and_wiped_without_a_mouse(tmp_path, pictured):
    page = Page.read(write_report(pictured, tmp_path))

    assert all(len(image["alt"]) > 10 for image in page.all("img"))
    sliders = [i for i in page.all("input") if i["type"] == "range"]
    assert len(sliders) == len(pictured.stereo.pictures)
    assert all(slider["aria-label"] and "tabindex" not in slider for slider in sliders)
    assert len(page.all("figcaption")) == len(pictured.stereo.pictures)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.elements:
        assert attributes.get("aria-labelledby", "why") in ids


def test_words_of_the_user_stay_words(tmp_path, pictured):
    path = write_report(pictured, tmp_path)
    page = Page.read(path)

    assert NASTY.rpartition("/")[2] in page.text
    assert NASTY in page.text
    assert len(page.all("script")) == 1
    assert not page.all("do")
    assert "<do not>" in page.text


def test_no_name_and_no_note_becomes_markup(tmp_path):
    nasty = "<script>alert(1)</script>"
    result = whole_result(tmp_path)
    sweep, burst, poses = result.bullet_time, result.burst, result.poses
    cameras = tuple(f"{nasty}{camera}" for camera in CAMERAS)
    picture = msgspec.structs.replace(result.stereo.pictures[0], title=nasty, caption=nasty)
    changed = msgspec.structs.replace(
        result,
        session=nasty,
        verdict=f"{nasty} It matters. {nasty}",
        calibration=nasty,
        stereo=msgspec.structs.replace(
            result.stereo, reference=nasty, other=nasty, why=nasty, pictures=(picture,)
        ),
        multiview=msgspec.structs.replace(
            result.multiview, reference=nasty, cameras=cameras, left_out={nasty: nasty}, cloud_skipped=nasty
        ),
        stitch=None,
        stitch_skipped=nasty,
        poses=msgspec.structs.replace(
            poses, cameras=cameras, offsets_ms=dict.fromkeys(cameras, 5.0), truth=nasty, why=nasty
        ),
        bullet_time=msgspec.structs.replace(sweep, cameras=cameras, file=nasty),
        burst=msgspec.structs.replace(burst, cameras=cameras),
        conditions=(ConditionResult(name=nasty, session=nasty, skipped=(nasty,)),),
        versions={nasty: nasty},
    )
    page = Page.read(write_report(changed, tmp_path))

    assert len(page.all("script")) == 1
    assert page.text.count(nasty) > 30


def test_movers_stand_beside_the_static_control(tmp_path):
    page = Page.read(write_report(RESULT, tmp_path))

    row = page.text[page.text.index("Given a distance") :]
    assert re.match(r".*?99\.9 %\D*40\.5 %\D*74\.5 %\D*73\.3 %", row)
    assert "comes from timing alone" in page.text
    row = page.text[page.text.index("Up-and-down mismatch") :]
    assert re.match(r".*?0\.26 px\s*17\.7 px\s*n/a\s*n/a", row)
    assert "Brightness mismatch" not in page.text
    assert "more strictly" not in page.text


def test_stricter_and_laxer_shares_are_told_where_they_were_taken(tmp_path):
    both = {"mover_within_1pct": 0.905, "mover_within_5pct": 0.993}
    stereo = msgspec.structs.replace(STEREO, synced=depth(**both))
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=stereo), tmp_path))

    assert re.match(r".*more strictly.*?90\.5 %\s*n/a.*less strictly.*?99\.3 %\s*n/a", page.text)


def test_a_control_that_moves_is_admitted(tmp_path):
    shaky = msgspec.structs.replace(STEREO, offset=depth(static_within_2pct=0.6))
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=shaky), tmp_path))

    assert "comes from timing alone" not in page.text
    assert "not all of the difference comes from timing" in page.text


def test_pictures_that_are_not_of_one_instant_are_not_called_synchronized(tmp_path):
    lost = depth(mover_within_2pct=0.005, mover_epipolar_px=9.8, static_epipolar_px=0.05)
    stereo = msgspec.structs.replace(STEREO, synced=lost, offset=lost)
    result = msgspec.structs.replace(whole_result(tmp_path), stereo=stereo, verdict="They were not.")
    page = Page.read(write_report(result, tmp_path))

    assert "As recorded against offset" in page.text
    assert "Synced" not in page.text
    assert "fire together; these did not" in page.text
    assert "in the pictures as they were recorded" in page.text
    assert "comes from timing alone" not in page.text
    assert "they do as well either way (67.3 % and 67.3 %)." in page.text


def test_without_ground_truth_nothing_is_called_correct(tmp_path):
    blind = {"mover_within_2pct": None, "static_within_2pct": None}
    stereo = msgspec.structs.replace(
        STEREO, synced=depth(**blind), offset=depth(**blind, mover_coverage=0.118, static_coverage=0.744)
    )
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=stereo), tmp_path))

    assert "orrectly" not in page.text
    assert "12 % of the moving surface given a distance" in page.text
    assert "Nobody knows the true distances" in page.text


def test_a_panorama_alone_speaks_of_its_overlap(tmp_path):
    only = msgspec.structs.replace(RESULT, stereo=None, stereo_skipped="only one camera <looks> that way")
    page = Page.read(write_report(only, tmp_path))

    assert "1.31 px of misfit" in page.text
    assert "23.4 px of misfit" in page.text
    assert "Depth was not measured: only one camera <looks> that way" in page.text
    assert not page.all("svg")


def test_a_panorama_is_judged_by_what_moves_where_that_is_known(tmp_path):
    stitch = msgspec.structs.replace(
        STITCH,
        synced=msgspec.structs.replace(STITCH.synced, mover_flow_p95_px=2.5),
        offset=msgspec.structs.replace(STITCH.offset, mover_flow_p95_px=31.4),
        why="52 % overlap",
    )
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=None, stitch=stitch), tmp_path))

    assert page.text.index("2.50 px of misfit of moving things") < page.text.index("31.4 px of misfit")
    assert "Misfit of moving things" in page.text
    assert "5 instants (taken for 52 % overlap)" in page.text


def test_pictures_of_several_panels_get_no_slider(tmp_path, pictured):
    pair = msgspec.structs.replace(pictured.stereo.pictures[0], panels=2)
    page = Page.read(write_report(with_pictures(pictured, pair), tmp_path))

    assert len(page.all("img")) == 2
    assert not [i for i in page.all("input") if i["type"] == "range"]


def test_the_contents_lead_to_every_section(tmp_path):
    page = Page.read(write_report(whole_result(tmp_path), tmp_path))

    links = [a["href"].removeprefix("#") for a in page.all("a")]
    headings = [h["id"] for h in page.all("h2")]
    assert links == headings
    assert len(links) == 9


def test_a_long_verdict_is_set_smaller(tmp_path):
    pages = [
        Page.read(write_report(msgspec.structs.replace(RESULT, verdict=verdict), tmp_path))
        for verdict in ("It matters. A lot.", "word " * 40 + ".")
    ]
    assert [page.all("h1")[0]["class"] for page in pages] == ["short", "long"]


def test_depth_alone_says_why_there_is_no_panorama(tmp_path):
    only = msgspec.structs.replace(RESULT, stitch=None, stitch_skipped="the pictures do not overlap")
    page = Page.read(write_report(only, tmp_path))

    assert "No panorama was made: the pictures do not overlap" in page.text
    assert len(page.all("table")) == 1


def test_with_nothing_measured_the_page_says_so_and_claims_nothing(tmp_path):
    nothing = msgspec.structs.replace(
        RESULT, stereo=None, stitch=None, sync_residual_us=None, sync_bound_us=None, versions={}
    )
    page = Page.read(write_report(nothing, tmp_path))

    assert "Depth was not measured" in page.text
    assert "No panorama was made" in page.text
    assert not page.all("table")
    assert "claim" not in {attributes.get("class", "").split(" ")[0] for _, attributes in page.elements}
    assert "None" not in page.text


def test_how_it_was_made_names_what_decides_the_numbers(tmp_path):
    page = Page.read(write_report(RESULT, tmp_path))

    for words in (
        "66 ms asked for; 66.6 ms given, which is 2 frames",
        "the session's own (calibration.json)",
        "every synchronized picture within 85 µs of its instant",
        "the clocks agree to 1.9 ms at the very worst",
        "cameras cam2 and cam3, 5 instants",
        "14.2 s",
        "opencv 5.0.0",
    ):
        assert words in page.text


def test_the_sweep_shows_each_camera_twice_and_says_how_late_it_is(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

    frames = [a for a in page.all("span") if a.get("class") == "frame"]
    assert [a["data-camera"] for a in frames] == [*CAMERAS, *CAMERAS]
    assert [a["data-time"].replace(wording.GAP, " ") for a in frames[3:]] == [
        "on time", "67 ms late", "33 ms early"
    ]  # fmt: skip
    assert "nothing in it is made up" in page.text
    assert "As a file to share: pictures/sweep.gif" in page.text
    assert "goes 4.70 px at most from one picture to the next; with the cameras apart, 18.7 px" in page.text

    loose = msgspec.structs.replace(result.bullet_time, steady=False, by_place=False, offset_step_px=5.0)
    page = Page.read(write_report(msgspec.structs.replace(result, bullet_time=loose), tmp_path))
    assert "made up" not in page.text
    assert "4.70 px" not in page.text
    assert "from camera to camera, by name" in page.text


def test_every_file_beside_the_page_is_named(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

    shown = page.text[page.text.index("Every file beside this page") :]
    made = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.png")}
    assert len(made) > 30
    assert all(path in shown for path in made)
    for path in ("metrics.json", "pictures/sweep.gif", "stages/", "sessions/jump"):
        assert path in shown


def test_a_measure_has_one_name_and_an_interval_one_decimal(tmp_path):
    page = Page.read(write_report(whole_result(tmp_path), tmp_path))

    assert page.text.count("Measured correctly") == 4
    assert "87.1 to 92.5" in page.text
    assert "Brightness mismatch" not in page.text
    conditions = page.text[page.text.index("All conditions") :]
    assert re.match(r".*session naive\s*other pictures, not paired by instant", conditions)
    assert conditions.count("every camera off by another time") == 1


def test_the_drawn_condition_is_listed_once(tmp_path):
    result = whole_result(tmp_path)
    drawn = ConditionResult(name="distinct", stereo=STEREO, multiview=result.multiview)
    page = Page.read(write_report(msgspec.structs.replace(result, conditions=(drawn,)), tmp_path))

    conditions = page.text[page.text.index("All conditions") : page.text.index("Every instant by itself")]
    assert conditions.count("apart") == 1
    assert "drawn for each instant" in conditions


def test_depth_from_all_cameras_stands_beside_its_control(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

    part = page.text[
        page.text.rindex("With all cameras at once") : page.text.rindex("Where the cameras stand")
    ]
    assert re.match(r".*Measured correctly.*?97\.0 %\D*1\.2 %\D*87\.0 %\D*87\.0 %", part)
    assert re.match(r".*Points in space.*?12 346\s*45\s*98 765", part)
    assert re.match(r".*Surface rebuilt.*? to within 1 cm:.*?81\.0 %", part)
    assert "every camera is off by another time, up to 66 ms, drawn for each instant" in part
    assert "No depth of cam_dark: its picture is black." in part
    assert "Found by others too" not in part
    assert "Distance from all cameras, synchronized" in [image["alt"] for image in page.all("img")]


def test_poses_of_single_instants_are_told_and_drawn(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

    part = page.text[page.text.rindex("Where the cameras stand") :]
    assert "lateness puts the cameras into the wrong places" in part
    assert re.match(r".*?Pairs placed right.*?100\.0 %\s*20\.0 %", part)
    assert re.match(r".*Wrong by, angle.*?0\.05°\s*27°", part)
    assert "cam_left on time, cam_middle 67 ms late, cam_right 33 ms early" in part
    drawn = [svg["aria-label"] for svg in page.all("svg") if "placed right" in svg.get("aria-label", "")]
    assert "instant 2: synchronized 100 %, apart 0 %" in drawn[0].replace(wording.GAP, " ")
    assert len(page.all("rect")) == 4


def test_what_was_not_looked_at_says_why_and_draws_nothing(tmp_path):
    none = msgspec.structs.replace(
        RESULT, multiview_skipped="it takes three <cameras>", poses_skipped="what moves is small"
    )
    page = Page.read(write_report(none, tmp_path))

    assert "With all cameras at once" not in page.text
    assert "not measured: it takes three <cameras>" in page.text
    assert "not looked at: what moves is small" in page.text


@pytest.mark.parametrize("broken", ["missing", "text", "cut"])
def test_a_picture_that_cannot_be_shown_leaves_the_old_report_alone(tmp_path, pictured, broken):
    before = write_report(RESULT, tmp_path).read_bytes()
    victim = tmp_path / pictured.stereo.pictures[0].offset
    if broken == "missing":
        victim.unlink()
    else:
        victim.write_bytes(b"not a picture" if broken == "text" else victim.read_bytes()[:12])

    with pytest.raises(BadInputError, match=r"depth_offset\.png"):
        write_report(pictured, tmp_path)

    assert (tmp_path / "report.html").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pictures", "report.html"]


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "report.html").mkdir()

    with pytest.raises(BadInputError, match=r"cannot write the report .*--out"):
        write_report(RESULT, tmp_path)

    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "n/a"),
        (float("nan"), "n/a"),
        (0.0, "0 %"),
        (0.0004, "under 0.1 %"),
        (0.004, "0.4 %"),
        (0.0112, "1 %"),
        (0.981, "98 %"),
        (0.9999, "99.9 %"),
        (1.0, "100 %"),
    ],
)
def test_shares_never_round_up_to_all_or_down_to_nothing(value, words):
    assert wording.share(value, decimals=0).replace(wording.GAP, " ") == words


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (wording.milliseconds(66.0), "66 ms"),
        (wording.milliseconds(66.64), "66.6 ms"),
        (wording.lateness(-33.3), "33 ms early"),
        (wording.lateness(0.54), "0.5 ms late"),
        (wording.microseconds(None), "n/a"),
        (wording.microseconds(999.4), "999 µs"),
        (wording.microseconds(1912), "1.9 ms"),
        (wording.quantity(9.996), "10.0"),
        (wording.quantity(0.256, "px"), "0.26 px"),
        (wording.quantity(170.4), "170"),
        (wording.quantity(85561.2), "85 561"),
        (wording.seconds(119.96), "120.0 s"),
        (
            " | ".join(wording.headline("It is 98.1 % right. At 66 ms not. So.")),
            "It is 98.1 % right. | At 66 ms not. So.",
        ),
        (wording.seconds(185), "3 min 5 s"),
        (wording.count(1, "frame"), "1 frame"),
    ],
)
def test_numbers_read_well(shown, words):
    assert shown.replace(wording.GAP, " ") == words


def test_numbers_stay_with_their_units():
    assert wording.tie("2 % in 3 ms, 4 miles") == f"2{wording.GAP}% in 3{wording.GAP}ms, 4 miles"
