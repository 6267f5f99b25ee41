"""The report in a real browser, where there is one: slider by keys and pointer, widths, no complaints."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from reconstruction.report.comparison_report import write_report
from tests.browser import CHROMIUM, Browser
from tests.unit.reconstruction.report.results import (
    CAMERAS,
    SHAPES,
    greys,
    unknown_rig_timing,
    whole_result,
    with_pictures,
)

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("profile"))
    try:
        browser.start()
        yield browser
    finally:
        browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compared")
    found = msgspec.structs.replace(whole_result(out), rig_timing=unknown_rig_timing(*CAMERAS))
    return write_report(found, out)


AT = "getComputedStyle(document.querySelector('.pair')).getPropertyValue('--at')"


def test_the_slider_moves_by_keys_and_says_where_it_is(browser: Browser, report: Path) -> None:
    browser.open(report)
    browser.ask("document.querySelector('.wipe').focus()")
    assert browser.ask(AT) == "50%"
    for _ in range(3):
        browser.press("ArrowRight", 39)
    assert browser.ask(AT) == "53%"
    assert (
        browser.ask("document.querySelector('.wipe').getAttribute('aria-valuetext')") == "53 % synchronized"
    )
    browser.press("Home", 36)
    assert browser.ask(AT) == "0%"
    assert (
        browser.ask("getComputedStyle(document.querySelector('.side.synced')).clipPath")
        == "inset(0px 100% 0px 0px)"
    )


@pytest.mark.parametrize("share", [0.01, 0.25, 0.9])
def test_the_slider_follows_the_pointer(browser: Browser, report: Path, share: float) -> None:
    browser.open(report)
    browser.ask("document.querySelector('.pair').scrollIntoView()")
    (at,) = browser.point(".pair img", share)
    browser.click(*at)
    assert browser.ask(AT) == f"{100 * share:.0f}%"


@pytest.mark.parametrize("width", [360, 400, 768, 870, 1400])
@pytest.mark.parametrize("view", ["over", "beside"])
def test_nothing_sticks_out_at_any_width(browser: Browser, report: Path, width: int, view: str) -> None:
    browser.open(report, width=width)
    browser.ask(f"document.querySelector('input[value={view}]').click()")
    browser.ask("document.querySelectorAll('details').forEach(part => part.open = true)")
    root = "document.documentElement"
    assert browser.ask(f"{root}.scrollWidth <= {root}.clientWidth")
    shapes = browser.ask(
        "[...document.querySelectorAll('[aria-labelledby=pictures] .pair img')]"
        ".map(i => i.getBoundingClientRect()).map(r => [r.width, r.height, r.right])"
    )
    wanted = [wide / high for high, wide in SHAPES.values() for _ in range(2)]
    for (wide, high, right), shape in zip(shapes, wanted, strict=True):
        assert wide / high == pytest.approx(shape, rel=0.02)
        assert right <= width
    overlaid = browser.ask(
        "(([a, b]) => a.left === b.left && a.top === b.top)"
        "([...document.querySelectorAll('.side img')].slice(0, 2).map(i => i.getBoundingClientRect()))"
    )
    assert overlaid == (view == "over")


def test_the_slider_is_dragged(browser: Browser, report: Path) -> None:
    browser.open(report)
    browser.ask("document.querySelector('.pair').scrollIntoView()")
    browser.drag(*browser.point(".pair img", 0.5, 0.2))
    assert browser.ask(AT) == "20%"


SHOWN = "[...document.querySelectorAll('.reel')].map(reel => reel.querySelector('.on').dataset.camera)"
PLAYING = "document.querySelector('.play').textContent"
SPOKEN = "document.querySelector('.sweep .at').getAttribute('aria-valuetext')"


@pytest.fixture
def still(browser: Browser, report: Path) -> Iterator[None]:
    """The report as somebody sees it who asked for less motion."""
    browser.prefer(**{"prefers-reduced-motion": "reduce"})
    browser.open(report)
    yield
    browser.prefer()


def test_the_sweep_plays_and_is_paused_by_a_key(browser: Browser, report: Path) -> None:
    browser.open(report)
    browser.ask("document.querySelector('.sweep').scrollIntoView()")
    assert browser.ask(PLAYING) == "Pause"
    browser.wait_until(f"{SHOWN}[0] !== '{CAMERAS[0]}'")
    browser.ask("document.querySelector('.play').focus()")
    browser.press(" ", 32, text=" ")
    assert browser.ask(PLAYING) == "Play"
    shown = browser.ask(SHOWN)
    assert shown[0] == shown[1]
    browser.ask("new Promise(done => setTimeout(done, 1000))", wait=True)
    assert browser.ask(SHOWN) == shown


@pytest.mark.usefixtures("still")
def test_who_asked_for_less_motion_sees_none_until_it_is_played(browser: Browser) -> None:
    assert browser.ask(PLAYING) == "Play"
    assert browser.ask("getComputedStyle(document.querySelector('.frame.on')).transitionDuration") == "0s"
    browser.ask("document.querySelector('.sweep').scrollIntoView()")
    browser.ask("document.querySelector('.play').click()")
    browser.wait_until(f"{SHOWN}[0] !== '{CAMERAS[0]}'")


@pytest.mark.usefixtures("still")
def test_the_sweep_goes_camera_by_camera_by_keys(browser: Browser) -> None:
    browser.ask("document.querySelector('.sweep .at').focus()")
    for camera in (*CAMERAS[1:], CAMERAS[-1]):
        browser.press("ArrowRight", 39)
        assert browser.ask(SHOWN) == [camera, camera]
    assert browser.ask(SPOKEN).replace("\u202f", " ") == f"{CAMERAS[-1]}; unsynchronized: 33 ms early"
    browser.press("Home", 36)
    assert browser.ask(SHOWN) == [CAMERAS[0]] * 2
    tag = browser.ask("document.querySelector('.sweep .offset > .tag').textContent")
    assert tag == "Unsynchronized: on time"


@pytest.mark.usefixtures("still")
def test_the_sweep_goes_camera_by_camera_by_pointer(browser: Browser) -> None:
    browser.ask("document.querySelector('.sweep').scrollIntoView()")
    (step,) = browser.point(".sweep [data-step='1']", 0.5)
    browser.click(*step)
    assert browser.ask(SHOWN) == [CAMERAS[1]] * 2
    browser.drag(*browser.point(".reel", 0.5, 0.95))
    assert browser.ask(SHOWN) == [CAMERAS[2]] * 2


FAINT = """
const light = c => {
  const [r, g, b] = c.map(v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const colour = text => {
  const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number);
  return {rgb: [r, g, b], a};
};
const ground = part => {
  for (; part; part = part.parentElement) {
    const {rgb, a} = colour(getComputedStyle(part).backgroundColor);
    if (a > 0.8) return rgb;
  }
};
const faint = [];
for (const part of document.querySelectorAll('body *')) {
  const words = [...part.childNodes].filter(n => n.nodeType === 3).map(n => n.data.trim()).join('');
  if (!words || part.closest('script, style') || !part.getClientRects().length) continue;
  const style = getComputedStyle(part);
  const ink = part.closest('svg') ? style.fill : style.color;
  const [a, b] = [light(colour(ink).rgb), light(ground(part))].sort((x, y) => y - x);
  const ratio = (a + 0.05) / (b + 0.05);
  if (ratio < 4.5) faint.push(`${words.slice(0, 30)}: ${ratio.toFixed(2)}`);
}
faint"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_word_stands_out_from_its_ground(browser: Browser, report: Path, scheme: str) -> None:
    browser.prefer(**{"prefers-color-scheme": scheme})
    browser.open(report)
    browser.ask("document.querySelectorAll('details').forEach(part => part.open = true)")
    dark = browser.ask("getComputedStyle(document.documentElement).backgroundColor") == "rgb(20, 22, 26)"
    assert dark == (scheme == "dark")
    assert browser.ask(FAINT) == []
    browser.prefer()


def test_print_shows_both_pictures_whole(browser: Browser, report: Path) -> None:
    browser.open(report)
    browser.do("Emulation.setEmulatedMedia", media="print")
    try:
        assert browser.ask("getComputedStyle(document.querySelector('.side.synced')).clipPath") == "none"
        assert browser.ask("getComputedStyle(document.querySelector('.wipe')).display") == "none"
        strip = browser.ask("[...document.querySelectorAll('.frame')].map(f => getComputedStyle(f).opacity)")
        assert strip == ["1"] * 2 * len(CAMERAS)
    finally:
        browser.do("Emulation.setEmulatedMedia", media="")


def test_the_browser_has_nothing_to_complain_about(browser: Browser, report: Path) -> None:
    browser.open(report)
    assert browser.complaints == []
    assert (
        browser.ask(
            "performance.getEntriesByType('resource').filter(r => !r.name.startsWith('data:')).length"
        )
        == 0
    )


DRAWN = "document.querySelector('.cloud canvas').dataset.drawn"
LIT = """(() => {
  const canvas = document.querySelector('.cloud canvas');
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', {willReadFrequently: true});
  copy.drawImage(canvas, 0, 0);
  const data = copy.getImageData(0, 0, canvas.width, canvas.height).data;
  let lit = 0;
  for (let k = 0; k < data.length; k += 4) lit += data[k] > 60;
  return lit / (data.length / 4);
})()"""


def test_the_cloud_is_turned_by_keys_and_by_hand(browser: Browser, report: Path, still: None) -> None:
    browser.ask("document.querySelector('.cloud').scrollIntoView()")
    assert browser.ask(DRAWN) == "synced 0.000 0.000 1.00"
    browser.ask("document.querySelector('.cloud canvas').focus()")
    browser.press("ArrowRight", 39)
    browser.wait_until(f"{DRAWN} === 'synced 0.100 0.000 1.00'")
    browser.press("+", 187, text="+")
    browser.wait_until(f"{DRAWN} === 'synced 0.100 0.000 1.15'")
    browser.drag(*browser.point(".cloud canvas", 0.3, 0.6))
    browser.wait_until(f"!{DRAWN}.startsWith('synced 0.100')")
    assert browser.complaints == []


def test_the_cloud_shows_either_side(browser: Browser, report: Path, still: None) -> None:
    both = []
    for side in ("synced", "offset"):
        browser.ask(f"document.querySelector('.cloud input[value={side}]').click()")
        browser.wait_until(f"{DRAWN}.startsWith('{side}')")
        both.append(browser.ask(LIT))
    assert both[0] > 0.3
    assert both[1] > 0.2
    assert both[0] != both[1]


@pytest.mark.parametrize("width", [400, 1280])
def test_the_first_screen_answers(browser: Browser, tmp_path: Path, width: int) -> None:
    result = whole_result(tmp_path)
    hero = greys(tmp_path, "stereo_depth", "Distance", (480, 640), 60, 180)
    browser.open(write_report(with_pictures(result, hero), tmp_path), width=width)
    for part in (".exactness", ".hero .handle"):
        bottom = browser.ask(f"document.querySelector('{part}').getBoundingClientRect().bottom")
        assert 0 < bottom <= 900, part
    assert browser.complaints == []
