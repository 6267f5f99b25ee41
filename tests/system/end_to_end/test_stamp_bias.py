"""A rig with a camera whose stamps are late, which nobody knows: what session and rig say of it, by truth."""

import asyncio
import json
from pathlib import Path

from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import burst, join, join_ready, lead, output

from .conftest import Start


async def test_a_late_camera_that_nobody_has_measured_is_sure_to_tens_of_milliseconds(
    start: Start, tmp_path: Path
) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    late, _ = await asyncio.gather(
        join(start, "late", address, model="phone-a,stamp_bias_ms=15"), join_ready(start, address, "true")
    )
    await late.says("ready")
    rig = json.loads(await output(await start("status", "--leader", address, "--json")))
    assert "stamp error of late not measured" in rig["advice"]
    session = Session.open(Path((await burst(start, address, "--frames", "3"))["session"]))
    assert verify(session) == []
    truth = session.true_times()
    assert truth is not None
    true_ns = {(one.camera, one.instant): one.true_ns for one in truth.images}
    verdict = judge(session.manifest)
    assert verdict.grade == "poor"
    assert "not measured" in verdict.stamps
    assert verdict.spread_ns is not None
    assert verdict.spread_error_ns is not None
    for instant in range(3):
        spread_ns = abs(true_ns["late", instant] - true_ns["true", instant])
        assert abs(spread_ns - verdict.spread_ns) < verdict.spread_error_ns
    for image in session.manifest.images:
        assert image.uncertainty_ns is not None
        if image.camera == "late":
            assert 10_000_000 < image.uncertainty_ns < 60_000_000
            assert image.hard_bound_ns is None
        else:
            assert image.uncertainty_ns < 10_000_000
            assert image.hard_bound_ns is not None
