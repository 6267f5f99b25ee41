"""All commands: the total of steps that is announced first is the last one; their pages fit a phone."""

import re
from pathlib import Path

import pytest

from reconstruction import cli
from tests.browser import CHROMIUM, Browser
from tests.project import JUMPER
from tests.system.reconstruction.methods.people.labels import write_csv
from tests.unit.reconstruction.conftest import Scene, make_view
from tests.unit.reconstruction.time_offsets.cut_apart import Recorder, write_cut_apart

NAIVE = JUMPER.parent / "naive"
WITH_PAGES = ("people", "tolerance")
QUICK = ("--instant", "1", "--quick")
COMMANDS = {
    "stereo": ("stereo", NAIVE),
    "multiview": ("multiview", NAIVE, *QUICK, "--page"),
    "multiview, several": ("multiview", NAIVE, "--instants", "1,2", "--width", "160", "--no-mesh"),
    "view": ("view", NAIVE, *QUICK, "--page"),
    "view, several": ("view", NAIVE, "--instants", "1,2", "--quick"),
    "splat": ("splat", NAIVE, *QUICK, "--iterations", "5", "--page"),
    "splat, several": ("splat", NAIVE, "--instants", "1,2", "--quick", "--iterations", "5"),
    "trajectory": ("trajectory", NAIVE),
    "panorama": ("panorama", NAIVE),
    "people": ("people", JUMPER, "--film"),
    "time": ("time", JUMPER),
    "tolerance": ("tolerance", NAIVE, "--max-instants", "1"),
    "movers": ("movers", NAIVE),
}


def fit_a_phone(folder: Path, pages: list[Path]) -> None:
    """No page is wider than 390 px, whatever is unfolded on it."""
    if not pages or CHROMIUM is None:
        return
    browser = Browser(folder / "profile", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    browser.start()
    try:
        for page in pages:
            browser.open(page, width=390)
            browser.ask("document.querySelectorAll('details').forEach(part => part.open = true)")
            assert browser.ask("document.documentElement.scrollWidth") <= 390, page
    finally:
        browser.close()


def check(lines: str) -> None:
    """The steps that these lines announce are numbered up to the total that the first one says."""
    steps = [(int(done), int(total)) for done, total in re.findall(r"^\[(\d+)/(\d+)\]", lines, re.MULTILINE)]
    totals = {total for _, total in steps}
    assert len(totals) <= 1, lines
    numbers = [done for done, _ in steps]
    assert numbers == sorted(set(numbers)), lines
    assert set(numbers[-1:]) == totals, lines


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_each_command_announces_its_last_step_first(
    words: tuple[str | Path, ...], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = [] if words[0] == "time" else ["--out", str(tmp_path / "out")]
    labels = ["--keypoints", str(write_csv(tmp_path / "labels"))] if words[0] == "people" else []
    code = cli.run([*map(str, words), *labels, *target])
    lines = capfd.readouterr().err
    assert code == 0 or words[0] in ("trajectory", "panorama"), lines
    check(lines)
    pages = [*(tmp_path / "out").rglob("*.html")]
    assert bool(pages) == ("--page" in words or words[0] in WITH_PAGES)
    fit_a_phone(tmp_path, pages)


def test_the_alignment_of_a_recording_announces_its_last_step_first(
    scene: Scene, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    cameras = {
        "left": Recorder(make_view((-0.1, 0.0, 0.0), yaw=1.5), ppm=20),
        "right": Recorder(make_view((0.1, 0.01, 0.0), yaw=-1.5), start_s=0.4621),
    }
    session = write_cut_apart(tmp_path, scene, cameras, 1.6)
    assert cli.run(["time", str(session.folder)]) == 0
    check(capfd.readouterr().err)
