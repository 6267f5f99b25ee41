"""The panel of LEDs that is to be built: its sketch lights what the reader expects, its frame is found."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app import cli
from capture_app.companions.panel.led_build import FILES
from capture_app.companions.panel.pattern import DICTIONARY, PANELS, Panel, corners_of_marker
from tests.unit.board.pages import PX_PER_MM, read_pdf, read_svg
from tests.unit.companions.panel.test_pattern import is_lit

HERE = Path(__file__).parent
COMPILER = shutil.which("g++") or shutil.which("clang++")
LED_PANELS = [panel for panel in PANELS.values() if not panel.is_screen]


def make(out: Path, *options: str) -> Path:
    assert cli.run(["panel", "sketch", "--out", str(out), *options]) == 0
    return out


def wired_outputs(text: str) -> dict[str, int]:
    """The bit of each thing that is driven, 8 to a register of the chain, as the wiring's table has it."""
    rows = re.findall(r"^\| ([\w ]+) \| ([A-F]) \| DRAIN(\d) \| \d+ \|$", text, re.MULTILINE)
    return {what: 8 * "ABCDEF".index(letter) + int(drain) for what, letter, drain in rows}


def lamp_names(panel: Panel) -> list[str]:
    """What drives each of a panel's lamps."""
    sides = ("left ", "right ") if len(panel.ticks) > 1 else ("",)
    first = [min(lamp.x for lamp in panel.lamps if lamp.group == 2 * n) for n in range(len(sides))]
    names = []
    for lamp in panel.lamps:
        array, is_row = divmod(lamp.group, 2)
        what = "row LED" if is_row else "column"
        names.append(f"{sides[array]}{what} {round(lamp.x - first[array]) + 1}")
    return names


@pytest.mark.skipif(COMPILER is None, reason="there is no C++ compiler here")
@pytest.mark.parametrize("panel", LED_PANELS, ids=lambda panel: panel.name)
def test_the_sketch_lights_what_the_panel_lights(panel: Panel, tmp_path: Path) -> None:
    made = make(tmp_path / "out", "--panel", panel.name, "--pitch-mm", "8")
    program = tmp_path / "run"
    warnings = ("-Wall", "-Wextra", "-std=c++11")
    places = ("-I", str(HERE), "-I", str(made / "panel"))
    source = str(HERE / "run_sketch.cpp")
    subprocess.run([str(COMPILER), *warnings, *places, source, "-o", str(program)], check=True)
    ticks = panel.cycle_ticks + 20
    ran = subprocess.run([str(program), str(ticks)], check=True, capture_output=True, text=True)
    setup, dark, *shown = ran.stdout.split("\n")[:-1]
    # Timer 1 runs at 2 MHz and counts from 0 to OCR1A.
    assert setup == f"1 0 {panel.tick_ns / 500 - 1:.0f}"
    assert int(dark, 16) == 0
    bits = wired_outputs((made / "WIRING.md").read_text())
    names = lamp_names(panel)
    assert len(shown) == ticks
    assert set(names) == set(bits)
    lamps = panel.lamps
    for tick, outputs in enumerate(shown):
        # Beyond the chain's end nothing is wired; spare outputs within it stay off.
        on = {bit for bit in range(24 * len(panel.ticks)) if int(outputs, 16) >> bit & 1}
        assert on == {bits[name] for name, lamp in zip(names, lamps, strict=True) if is_lit(lamp, tick)}


@pytest.mark.parametrize("panel", LED_PANELS, ids=lambda panel: panel.name)
def test_the_frame_is_found_at_its_true_size(panel: Panel, tmp_path: Path) -> None:
    made = make(tmp_path / "out", "--panel", panel.name, "--pitch-mm", "9")
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))
    for read, name in ((read_svg, "frame.svg"), (read_pdf, "frame.pdf")):
        _, picture = read((made / name).read_bytes())
        found, numbers, _ = cv2.aruco.ArucoDetector(words).detectMarkers(picture)
        corners = dict(
            zip(np.ravel(numbers).tolist(), (np.reshape(one, (4, 2)) for one in found), strict=True)
        )
        assert sorted(corners) == [number for number, _, _ in panel.markers]
        first, *place = panel.markers[0]
        for number, left, top in panel.markers:
            measured = (corners[number] - corners[first][0]) / PX_PER_MM
            expected = (np.array(corners_of_marker(left, top)) - place) * 9
            # Corners are found to a pixel, of which there are six a millimetre.
            assert np.abs(measured - expected).max() < 0.5
        left, top = corners[first][0]
        scale = 9 * PX_PER_MM
        for lamp in panel.lamps:
            x, y = left + (lamp.x - place[0]) * scale, top + (lamp.y - place[1]) * scale
            around = picture[round(y) - 3 : round(y) + 4, round(x) - 3 : round(x) + 4]
            assert around.max() > 200, "a cross on the dark ground"


def test_the_folder_has_all_that_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "out", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["panel"] == "led-200us"
    assert printed["files"] == [str(tmp_path / "out" / name) for name in FILES]
    assert all(Path(file).stat().st_size for file in printed["files"])
    for file in printed["files"]:
        assert not re.search(r"@\w+@", Path(file).read_bytes().decode("latin-1")), file
    svg = Path(printed["files"][2]).read_text()
    for what in ("D11", "column 10", "row LED 10", "TPIC6B595"):
        assert what in svg
    # It may be made anew, but takes nobody else's place.
    make(tmp_path / "out", "--panel", "led-10ms")
    (tmp_path / "out" / "mine.txt").touch()
    assert cli.run(["panel", "sketch", "--out", str(tmp_path / "out")]) == 3
    assert "holds other files (mine.txt)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--panel", "led-1us"], "'led-1us' is not one of 'led-200us', 'led-10ms', 'led-pair'"),
        (["--panel", "screen-60hz-down"], "'screen-60hz-down' is not one of"),
        (["--panel", "led-pair"], "a frame of 305 x 130 mm does not fit A4"),
        (["--pitch-mm", "nan"], "--pitch-mm"),
    ],
)
def test_panels_that_cannot_be_built_are_refused(
    options: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["panel", "sketch", "--out", str(tmp_path / "out"), *options]) in (2, 3)
    (line,) = capsys.readouterr().err.splitlines()
    assert problem in line
    assert not (tmp_path / "out").exists()


def test_pins_are_those_of_the_panel_named(tmp_path: Path) -> None:
    text = (make(tmp_path / "out") / "WIRING.md").read_text()
    assert len(wired_outputs(text)) == 20
    assert f"{len(PANELS['led-200us'].lamps)} red LEDs" in text
