"""People in 3D on the monitor's page, as large as a phone and as a tablet: drawn, walked round, lost."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.child import Child
from capture_app.rig import live_pictures
from tests.browser import CHROMIUM
from tests.system.companions.monitor.test_in_a_browser import SIZES, MonitorBrowser
from tests.unit.companions.monitor.served import monitored
from tests.waiting import until

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")
DRAWN = "people.walk.draw(), seen('walk').toDataURL()"
ANGLE = "people.walk.eye.across * people.scene.path.half[0]"


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> list[Child]:
    """The processes that located people, of stand-ins."""
    started: list[Child] = []

    class Counted(Child):
        @classmethod
        async def start(cls, *arguments: Any, **options: Any) -> "Counted":
            started.append(child := await super().start(*arguments, **options))
            return child

    monkeypatch.setattr(live_pictures, "Child", Counted)
    monkeypatch.setattr(live_pictures, "COMMAND", ("tests.system.companions.monitor.stand_in_people",))
    return started


@pytest.mark.parametrize("device", SIZES)
async def test_people_move_and_are_walked_round(tmp_path: Path, processes: list[Child], device: str) -> None:
    width, _ = SIZES[device]
    async with monitored(tmp_path, 2) as served:
        browser = MonitorBrowser(tmp_path / "profile", SIZES[device])
        try:
            await browser.open(await served.url())
            await browser.shows("document.body.classList.contains('good')")
            assert processes == [], "nobody looks"
            await browser.tap("#in-3d")
            await browser.shows("people.walk && people.walk.count() > 3")
            await browser.shows(
                "seen('people-words').textContent.startsWith('2 people; 66 joints, 95 % error 0.055 m')"
            )
            before = await browser.ask(DRAWN)
            await browser.shows(f"({DRAWN}) !== {before!r}")
            assert await browser.ask("seen('walk').width === seen('walk').clientWidth"), "no pixel is coarser"
            assert await browser.ask("document.documentElement.scrollWidth") == width, "nothing is cut off"
            assert await browser.ask(
                "[...document.querySelectorAll('button, #people p')].filter(one => one.offsetParent)"
                ".map(one => one.getBoundingClientRect())"
                f".every(one => one.width > 0 && one.left >= 0 && one.right <= {width})"
            )
            for _ in range(3):
                await asyncio.to_thread(browser.drag, "#walk", 0.9, 0.1)
            assert await browser.ask(ANGLE) > 3.1416, "behind them"
            await browser.tap("#middle")
            assert await browser.ask(ANGLE) == 0
            assert await browser.ask("getComputedStyle(seen('walk')).filter") == "none"
            lose = "seen('walk').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
            await browser.ask(f"window.lost = people.walk, {lose}")
            await browser.shows("people.walk && people.walk !== lost && people.walk.count() > 0")
            await browser.ask("SHOW.lost({reason: 'The leader does not answer.'})")
            assert "grayscale(1)" in await browser.ask("getComputedStyle(seen('walk')).filter")
            (first,) = processes
            first.process.kill()
            await browser.shows("seen('people-words').textContent.includes('ended with code -9')")
            assert "grayscale(1)" in await browser.ask("getComputedStyle(seen('walk')).filter")
            count = await browser.ask("people.walk.count()")
            await browser.tap("#again")
            await browser.shows(f"people.walk.count() > {count} && seen('again').hidden")
            await browser.tap("#in-3d")
            await until(lambda: processes[1].process.returncode is not None)
            assert len(processes) == 2
            assert await browser.ask("seen('cameras').offsetParent !== null")
        finally:
            browser.kill()


async def test_a_browser_without_3d_says_so(tmp_path: Path, processes: list[Child]) -> None:
    async with monitored(tmp_path, 2) as served:
        browser = MonitorBrowser(tmp_path / "profile", SIZES["phone"], "--disable-3d-apis")
        try:
            await browser.open(await served.url())
            await browser.tap("#in-3d")
            await browser.shows("seen('people-words').textContent === 'This browser shows no 3D (WebGL 2).'")
        finally:
            browser.kill()
