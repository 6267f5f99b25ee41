"""One camera closely: its plots, and what the screen asks for while it is shown."""

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st
from textual.widgets import Input, Static

from capture_app.common.camera_facts import MICROSECONDS, CameraControls, Control, ControlState
from capture_app.common.errors import NetworkError
from capture_app.protocol.status import LogLine, NodeDetail
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.widgets.plots import histogram_rows, histogram_title, wedge_rows, wedge_title
from tests.unit.tui.driving import make_app, running, screen_of, settle, text, toasts
from tests.unit.tui.fake_rig import UNIX_NS, FakeRig

SAMPLES = tuple((5_000_000 + (n * 7919 % 41 - 20) * n, 120_000 + 100 * n) for n in range(100))
DETAIL = NodeDetail(
    camera="cam00",
    samples=SAMPLES,
    phase_errors_ns=(*range(-50_000, 50_000, 1000), 900_000),
    log=(LogLine(unix_ns=UNIX_NS, text="ready"),),
    spool="/var/spool",
)


def plain(rows: Sequence[object]) -> list[str]:
    return [getattr(row, "plain") for row in rows]  # noqa: B009 - rows of any kind of text


async def test_enter_opens_a_camera_and_escape_leads_back(utc: None) -> None:
    rig = FakeRig(5)
    rig.details["cam00"] = DETAIL
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("enter")
        await settle(pilot)
        screen = screen_of(app, CameraScreen)
        facts = text(app, "#camera-facts")
        for words in ("cam00", "● ready", "phase −45 µs", "clock ±9.0 µs, at most ±61 µs", "34 GB free"):
            assert words in facts
        assert screen.query_one("#camera-wedge").border_title == "clock offset, 100 exchanges"
        assert "22:13:20 · ready" in text(app, "#camera-log Lines")
        assert rig.asked[-1] == ("want_previews", ("cam00",), 320, 2.5)
        await pilot.press("right")
        await settle(pilot)
        assert "cam01" in text(app, "#camera-facts")
        assert rig.asked[-1] == ("want_previews", ("cam01",), 320, 2.5)
        await pilot.press("escape")
        await settle(pilot)
        assert not isinstance(app.screen, CameraScreen)
        assert rig.asked[-1] == ("want_previews", None, 320, 0.0)


async def test_all_cameras_are_set_like_this_one() -> None:
    rig = FakeRig(2)
    exposure = ControlState(control=Control.EXPOSURE, value=4000.0, unit=MICROSECONDS, automatic=True)
    rig.details["cam00"] = NodeDetail(camera="cam00", controls=(exposure,))
    cannot = CameraControls(problems={Control.FOCUS: "it has no [b]focus"})
    rig.matched = {"cam00": CameraControls(), "cam01": cannot}
    app = make_app(rig)
    async with app.run_test(size=(100, 30), notifications=True) as pilot:
        await settle(pilot)
        await pilot.press("enter")
        await settle(pilot)
        assert "exposure 4000 µs, auto" in text(app, "#camera-facts")
        await pilot.press("C")
        await settle(pilot)
        assert ("match_cameras", "cam00") in rig.asked
        assert toasts(app) == ["2 cameras set like cam00, except:\ncam01: it has no [b]focus"]


async def test_a_camera_is_set_and_says_what_it_refuses() -> None:
    rig = FakeRig(2)
    exposure = ControlState(
        control=Control.EXPOSURE, value=4000.0, unit=MICROSECONDS, minimum=30.0, maximum=33000.0
    )
    fixed = ControlState(control=Control.FOCUS, value=1.0, unit="steps")
    gain = ControlState(control=Control.GAIN, unit="×", automatic=True, minimum=1.0, maximum=8.0)
    rig.details["cam00"] = NodeDetail(camera="cam00", controls=(exposure, fixed, gain))
    rig.matched = {"cam00": CameraControls(problems={Control.GAIN: "9 is out of its range"})}
    app = make_app(rig)
    async with app.run_test(size=(100, 30), notifications=True) as pilot:
        await settle(pilot)
        await pilot.press("enter")
        await settle(pilot)
        await pilot.press("X")
        await settle(pilot)
        said = str(app.screen.query(Static).first().content)
        assert "exposure: 4000 µs; 30 to 33000" in said
        assert "focus" not in said, "it cannot be set"
        line = app.screen.query_one(Input)
        assert line.value == "exposure=4000 gain=auto"
        line.value = "gain=nin"
        await pilot.press("end", "e", "enter")
        await settle(pilot)
        assert "gain=nine is not a number" in str(app.screen.query_one(".wrong", Static).content)
        line.value = "exposure=2000 gain="
        await pilot.press("end", "9", "enter")
        await settle(pilot)
        assert ("set_camera", "cam00", {"exposure": 2000.0, "gain": 9.0}) in rig.asked
        assert toasts(app) == ["cam00 is set; C sets all like it, except:\ncam00: 9 is out of its range"]


async def test_a_camera_that_does_not_answer_says_so_and_one_that_left_too() -> None:
    rig = FakeRig(5)
    rig.detail_failure = NetworkError("[b]cam00 does not answer")
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("enter")
        await settle(pilot)
        assert text(app, "#camera-log Lines") == "[b]cam00 does not answer"
        rig.nodes = rig.nodes[1:]
        rig.tell()
        await settle(pilot)
        assert text(app, "#camera-facts").startswith("cam00 has left the rig.")


def test_exchanges_lie_in_a_wedge_from_the_shortest_on() -> None:
    rows = plain(wedge_rows(SAMPLES, 60, 12))
    assert len(rows) == 12
    assert all(len(row) <= 60 for row in rows)
    assert rows[-1].split() == ["120", "µs", "round", "trip", "129", "µs"]
    middle = rows[5]
    assert middle.strip().startswith("0")
    # The points of the shortest round trips are at the left, amid the rows.
    assert middle[8] != " "
    assert rows[0][8] == rows[10][8] == " "


def test_a_round_trip_too_short_to_measure_is_not_told() -> None:
    samples = ((0, 24), (3, 40), (1, 30))
    assert wedge_title(samples) == "clock offset, 3 exchanges"
    assert wedge_title(()) == "clock"
    assert "24 ns" not in "".join(plain(wedge_rows(samples, 60, 12)))


def test_bars_are_as_high_as_frames_are_many() -> None:
    rows = plain(histogram_rows([0] * 80 + [20_000] * 40 + [-5_000_000], 100_000, 40, 9))
    assert len(rows) == 9
    heights = ["".join(row[x] for row in rows[:-1]).count("█") for x in range(40)]
    assert max(heights) == 8
    assert sorted(heights)[-2] == 4
    assert rows[-2][0] == "▁"  # the one beyond the axis is counted at its end
    assert histogram_title([0, 0, 200_000, 0], 100_000) == "phase, 75 % of 4 within ±100 µs"


@given(
    st.lists(st.tuples(st.integers(-(10**15), 10**15), st.integers(0, 10**9)), max_size=30),
    st.integers(0, 90),
    st.integers(0, 40),
)
def test_plots_keep_to_their_room(samples: list[tuple[int, int]], width: int, height: int) -> None:
    errors = [offset for offset, _ in samples]
    for rows in (wedge_rows(samples, width, height), histogram_rows(errors, 100_000, width, height)):
        assert len(rows) <= max(height, 1)
        assert all(row.cell_length <= max(width, 52) for row in rows)
