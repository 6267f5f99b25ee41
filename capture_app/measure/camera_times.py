"""How late each camera's stamps are, from what its pictures and the others' tell of their times."""

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path

import msgspec

from capture_app.camera_facts import CameraFacts, StampAccuracy, StampSource
from capture_app.errors import NotApplicableError
from capture_app.node.child import Child
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.reading.stamp_words import UNMEASURED
from capture_app.text import UNREADABLE

COVERAGE = 1.96
"""Standard deviations of a 95 % error."""


class MeasuredTime(msgspec.Struct, frozen=True, kw_only=True):
    """What `reconstruct time --json` says: how much later than told its images are, or why not."""

    offset_ms: float | None = None
    sd_ms: float | None = None
    source: str = ""
    reason: str = ""
    row_time_ns: float | None = None
    row_time_sd_ns: float | None = None


class MeasuredTimes(msgspec.Struct, frozen=True, kw_only=True):
    """What it says of a session."""

    reference: str
    cameras: dict[str, MeasuredTime]


def choose_reference(cameras: Mapping[str, CameraFacts]) -> str | None:
    """The camera whose own stamps are known best; None where nothing tells any camera's."""
    known = {
        name: camera.stamp_accuracy.uncertainty_ns
        for name, camera in cameras.items()
        if camera.stamp_accuracy.source not in UNMEASURED
    }
    return min(known, key=lambda name: known[name], default=None)


async def measure_session(session: Path, reference: str | None) -> MeasuredTimes:
    """Run `reconstruct time` on a session, at the lowest priority.

    Raises what it ends with: NotAvailableError where it is not installed, BadInputError where it cannot.
    """
    arguments = ["reconstruction.cli", "time", str(session), "--json"]
    arguments += [] if reference is None else ["--reference", reference]
    child = await Child.start("reconstruct time", arguments, background=True)
    try:
        assert child.process.stdout is not None
        printed = await child.process.stdout.read()
        if await child.process.wait():
            raise await child.failure()
        await asyncio.wait((child.listening,), timeout=1.0)
    finally:
        await child.stop()
    try:
        return msgspec.json.decode(printed, type=MeasuredTimes)
    except UNREADABLE as error:
        raise NotApplicableError(f"what reconstruct time says is not understood: {error}") from error


def measured_stamps(records: Mapping[str, CameraRecord], measured: MeasuredTimes) -> dict[str, StampAccuracy]:
    """How late each camera's stamps are now known to be, of those that were not known better before.

    What was measured is one camera against the reference. Where nothing tells how late the reference's own
    stamps are, they are taken for what they were, and the others' are right against it only.
    """
    own = records[measured.reference].facts.stamp_accuracy
    is_known = own.source not in UNMEASURED
    against = own.against if is_known else measured.reference
    base_ns = own.uncertainty_ns if is_known else 0
    common_ns = records[measured.reference].facts.shared_uncertainty_ns if is_known else own.uncertainty_ns
    found = {}
    for name, time in measured.cameras.items():
        if time.offset_ms is None or time.sd_ms is None or name not in records:
            continue
        facts, known = records[name].facts, records[name].facts.stamp_accuracy
        parts_ns = [COVERAGE * time.sd_ms * 1e6, base_ns]
        if name != measured.reference:
            clocks = (records[one].clock for one in (name, measured.reference))
            parts_ns += [clock.uncertainty_ns for clock in clocks if clock is not None]
        error_ns = round(math.hypot(*parts_ns))
        if known.source not in UNMEASURED:
            alike = known.against == against
            before_ns = known.uncertainty_ns + (0 if alike else facts.shared_uncertainty_ns)
            if before_ns <= error_ns + (0 if alike else common_ns):
                continue
        found[name] = StampAccuracy(
            # Light that was later than told had stamps that were less late than was taken off them.
            bias_ns=known.bias_ns - round(time.offset_ms * 1e6),
            uncertainty_ns=error_ns,
            source=StampSource.LIGHT if _by_light(measured, name) else StampSource.MOTION,
            exposure_ns=facts.exposure_ns,
            against=against,
            against_uncertainty_ns=common_ns if against else None,
        )
    return found


def _by_light(measured: MeasuredTimes, name: str) -> bool:
    sources = {time.source for time in measured.cameras.values()}
    return measured.cameras[name].source == StampSource.LIGHT or (
        name == measured.reference and StampSource.LIGHT in sources
    )
