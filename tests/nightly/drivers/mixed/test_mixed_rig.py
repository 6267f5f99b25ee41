"""Cameras of five kinds in one run: ready, a complete burst, and an honest error bar on every frame."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from capture_app.common.camera_facts import StampSource
from tests.browser import CHROMIUM
from tests.nightly.drivers.mixed.rig import MixedRig, mixed_rig

KINDS = {"gige": "aravis", "pi": "libcamera", "replay": "replay", "sim": "sim", "phone": "phone"}
FRAMES = 5


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[MixedRig]:
    if CHROMIUM is None:
        pytest.skip("no Chromium here; apt-get install chromium")
    with mixed_rig(tmp_path) as running:
        yield running


def test_five_kinds_of_cameras_take_a_burst_together(rig: MixedRig) -> None:
    browser = rig.browser()
    try:
        browser.start()
        browser.open(rig.invitation(), width=390, height=844)
        browser.ask("document.getElementById('go').click()")
        rig.wait_until_ready(len(KINDS))
        session = rig.burst("--frames", str(FRAMES))
    finally:
        browser.kill()
    facts = {camera.name: camera.facts for camera in session.manifest.cameras}
    assert {name: of.kind for name, of in facts.items()} == KINDS
    assert len(session.manifest.images) == FRAMES * len(KINDS)
    verified = rig.run("sessions", "verify", str(session.folder))
    assert verified.returncode == 0, verified.stderr

    truth = session.true_times()
    assert truth is not None
    true_ns = {(one.camera, one.instant): one.true_ns for one in truth.images}
    errors_us: dict[str, list[float]] = {}
    for image in session.manifest.images:
        stamp = facts[image.camera].stamp
        assert stamp is not None
        assert image.uncertainty_ns is not None
        assert image.uncertainty_ns >= stamp.uncertainty_ns
        if stamp.source is not StampSource.CONSTRUCTION:
            assert image.hard_bound_ns is None, "nobody bounds what a device does before its stamp"
        if image.camera in rig.true_starts:
            error_ns = rig.true_error_ns(image)
        elif image.camera == "sim":
            error_ns = true_ns["sim", image.instant] - image.leader_ns
        else:
            continue
        assert abs(error_ns) <= image.uncertainty_ns, (image.camera, error_ns, image.uncertainty_ns)
        errors_us.setdefault(image.camera, []).append(abs(error_ns) / 1000)
    assert {len(errors) for errors in errors_us.values()} == {FRAMES}
    # Nobody knows when the light of a browser's picture fell to better than milliseconds.
    assert min(i.uncertainty_ns or 0 for i in session.manifest.images if i.camera == "phone") > 1_000_000
    sync = session.manifest.sync
    assert sync is not None
    for name, of in facts.items():
        bars = [image.uncertainty_ns or 0 for image in session.manifest.images if image.camera == name]
        at_most = f", off by {max(errors_us[name]):.1f} us at most by the truth" if name in errors_us else ""
        print(f"{name} ({of.kind}): sure to {max(bars) / 1000:.1f} us{at_most}")
    print(f"spread by stamps {max(sync.spread_ns) / 1000:.1f} us")
