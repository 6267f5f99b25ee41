"""The key on the screen, the session on the disk: a leader and simulated cameras over loopback."""

import contextlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from capture_app.common.clock import HostClock
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim import simulation_driver
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.tui.app import SimulshotApp
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.shoot_view import ShootView
from capture_app.tui.shoot.takes import Take
from tests.cheap_rig import rig_of
from tests.waiting import SLOW_PATIENCE_S, until

SECOND_NS = 1_000_000_000
CAMERAS, BEFORE, FRAMES = 2, 3, 5
TAKES = 4


async def take_until_whole(app: SimulshotApp, view: ShootView) -> Take:
    """Take until a take has all images: a starved machine refuses one, loses a camera or drops frames."""

    def is_taken(before: int) -> bool:
        return len(view.takes) > before and is_over(view.takes[-1])

    for _ in range(TAKES):
        app.simulate_key("space")
        with contextlib.suppress(AssertionError):
            await until(partial(is_taken, len(view.takes)), seconds=SLOW_PATIENCE_S)
            take = view.takes[-1]
            manifest = None if take.sheet is None else take.sheet.session.manifest
            if manifest and not (manifest.missing or manifest.burst.absent):
                return take
    raise AssertionError(f"no take was whole: {view.takes}")


def is_over(take: Take) -> bool:
    return take.sheet is not None or bool(take.problem) or (take.status.done and take.status.session is None)


async def test_space_puts_a_named_take_with_frames_around_the_key_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A busy machine fetches frames late: the driver does not drop them for that, and the nodes keep them.
    monkeypatch.setattr(simulation_driver, "STALL_NS", 60 * SECOND_NS)
    plan: dict[str, str | int | float | bool] = {
        "shoot.frames": FRAMES,
        "shoot.before": BEFORE,
        "shoot.name": "jump",
    }
    async with rig_of(CAMERAS, tmp_path, ring_ns=60 * SECOND_NS) as leader:
        app = SimulshotApp(RigLink(leader.own_address), settings=Settings(choices=plan), sessions=tmp_path)
        async with app.run_test(size=(120, 40)) as pilot:
            await pilot.press("2")
            view = app.screen.query_one(ShootView)
            # Clocks of one busy process may stay less accurate than requested.
            good = {NodeState.READY, NodeState.DEGRADED}
            await until(
                lambda: [node.state in good for node in leader.status().nodes] == [True] * CAMERAS,
                seconds=SLOW_PATIENCE_S,
            )
            await until(lambda: all(tile.picture.cells is not None for tile in view.stage.grid.tiles))
            assert len(view.stage.grid.tiles) == CAMERAS, "each camera shows what it sees"
            view.plan_panel.change(replace(view.plan_panel.settings, note="first try"))
            key_ns = HostClock().now_ns()
            take = await take_until_whole(app, view)
            await until(lambda: view.stage.is_sheet)
            assert view.take_panel.plain.startswith(f"{take.status.name}\n")
    session = Session.open(tmp_path / take.status.name)
    manifest = session.manifest
    assert take.status.name.startswith("jump-")
    assert manifest.note.startswith("first try")
    assert verify(session) == []
    assert len(manifest.images) == CAMERAS * FRAMES
    instants_ns, period_ns = manifest.burst.instants_ns, manifest.burst.period_ns
    assert len(instants_ns) == FRAMES
    assert instants_ns[BEFORE] > key_ns - period_ns, "what comes after the key is not before it"
    assert instants_ns[0] <= instants_ns[BEFORE] - BEFORE * period_ns
