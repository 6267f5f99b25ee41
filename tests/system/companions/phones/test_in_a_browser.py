"""The page in a real browser with a fake camera: joins by the code, is killed, comes back; what it says."""

import re
from pathlib import Path

import pytest

from capture_app.common.camera_facts import Control
from capture_app.common.node_state import NodeState
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest
from capture_app.rig.rig_link import ask_leader
from capture_app.session.reading.verify import verify
from tests.browser import CHROMIUM
from tests.unit.companions.phones.places import Place, burst, measured
from tests.unit.companions.phones.test_in_a_browser import (
    PhoneBrowser,
    place,  # noqa: F401 - a fixture
)
from tests.waiting import until

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")]
ALLOW = "--use-fake-ui-for-media-stream"
WITHOUT_PROCESSOR = "delete self.MediaStreamTrackProcessor"
SLOW_FRAMES = """
const ask = HTMLVideoElement.prototype.requestVideoFrameCallback;
HTMLVideoElement.prototype.requestVideoFrameCallback = function (shown) {
  return ask.call(this, () => setTimeout(() => ask.call(this, shown), 1500));
};"""


async def join(phone: PhoneBrowser, place: Place) -> None:
    """Open the page of the code and start the camera, as a user does."""
    await phone.open(place.url)
    await phone.shows("Start the camera")
    await phone.ask("document.getElementById('wish').value = 'window'")
    await phone.ask("document.getElementById('go').click()")
    await measured(place, "window")
    await phone.shows("known to ±")


def pictures_sent(text: str) -> int:
    """How many pictures the page says that it has sent."""
    said = re.search(r"(\d+) pictures?", text)
    return int(said[1]) if said else 0


async def test_a_camera_that_begins_slowly_is_waited_for(place: Place, tmp_path: Path) -> None:
    """Two frames in three seconds, as WebKit gave on a busy machine, were 'no picture'."""
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await phone.open(place.url, before=f"{WITHOUT_PROCESSOR}; {SLOW_FRAMES}")
        await phone.shows("Start the camera")
        await phone.ask("document.getElementById('go').click()")
        await phone.shows("320×240")
        assert "gave no picture" not in await phone.text()
    finally:
        phone.kill()


async def test_a_browser_joins_by_the_code_and_takes_a_burst(
    place: Place, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await join(phone, place)
        assert not await phone.ask("location.hash")
        session = await burst(place, 3, wait_ready_s=0)
        assert verify(session) == []
        assert len(session.manifest.images) == 3
        (camera,) = session.manifest.cameras
        assert (camera.facts.width, camera.facts.height) == (320, 240)
        assert camera.clock is not None
        assert camera.clock.device_uncertainty_ns
        # Pictures of spare instants are fetched, too, before the leader knows that a burst is whole.
        await phone.shows_what(lambda text: pictures_sent(text) >= 3, "3 pictures sent or more")
    finally:
        phone.kill()
    await until(lambda: place.state("window") is NodeState.FAILED)
    assert [record.getMessage() for record in caplog.records if record.exc_info] == []


async def test_a_browser_that_was_hidden_or_killed_comes_back(place: Place, tmp_path: Path) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await join(phone, place)
        request = ControlsRequest(camera="window", values={Control.EXPOSURE: 4_000.0})
        set_to = (await ask_leader(place.leader.own_address, request, ControlsAnswer)).state
        assert set_to.problems == {}
        exposure = set_to.state(Control.EXPOSURE)
        assert exposure is not None
        assert exposure.value == 4_000.0
        await phone.hide()
        await until(lambda: place.state("window") is NodeState.FAILED)
        await phone.show()
        await measured(place, "window")
    finally:
        phone.kill()
    await until(lambda: place.state("window") is NodeState.FAILED)

    # The phone's system starts it again at the address that it had, which holds no secret.
    again = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await again.open(place.base)
        await measured(place, "window")
        assert len((await burst(place, 2, wait_ready_s=0)).manifest.images) == 2
    finally:
        again.kill()


async def test_a_browser_that_shows_frames_to_nobody_is_read_by_its_video(
    place: Place, tmp_path: Path
) -> None:
    phone = PhoneBrowser(tmp_path / "profile", ALLOW)
    try:
        await phone.open(place.url, before=WITHOUT_PROCESSOR)
        await phone.ask("document.getElementById('go').click()")
        await measured(place, "phone")
        assert len((await burst(place, 1, wait_ready_s=0)).manifest.images) == 1
    finally:
        phone.kill()
