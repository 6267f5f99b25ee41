"""Measure of `capture-app cameras calibrate-time`: each camera's delay against another by a panel."""

from typing import TYPE_CHECKING

from capture_app.common.camera_facts import StampSource
from capture_app.common.errors import NotApplicableError

if TYPE_CHECKING:
    from capture_app.rig.camera_times import MeasuredTimes
    from capture_app.session.reading.reader import Session

HELP = "Measure with a panel that all cameras see (capture-app panel), instead of motion."
TODO = "all cameras must see the panel"


def measure(session: "Session", reference: str | None = None) -> "MeasuredTimes":
    """Measure each camera's delay against a reference camera by a panel. Raises NotApplicableError."""
    from capture_app.companions.panel.pair_errors import rig_errors
    from capture_app.companions.panel.session_times import read_session
    from capture_app.companions.panel.time_reading import SIGMAS_95
    from capture_app.rig.camera_times import MeasuredTime, MeasuredTimes, choose_reference

    records = {record.name: record for record in session.manifest.cameras}
    reference = reference or choose_reference(records) or next(iter(records))
    times = read_session(session)
    if not times.exposures_known:
        raise NotApplicableError(
            f"{session.folder} lacks exposures or row times", hint="measure by motion: leave out --panel"
        )
    unseen = MeasuredTime(
        reason=f"it and {reference} never see the panel at once, or the panel repeats too soon"
    )
    delays = dict.fromkeys(times.cameras, unseen) | {reference: MeasuredTime(offset_ms=0.0, sd_ms=0.0)}
    errors = rig_errors(times)
    for pair in errors.pairs:
        of_pair = [error for error in errors.errors if (error.first, error.second) == pair.cameras]
        unsure_ns = max(error.session_uncertainty_ns or 0.0 for error in of_pair)
        if reference in pair.cameras and unsure_ns <= times.panel.cycle_ns / 2.0:
            sign, name = (1.0, pair.cameras[1]) if pair.cameras[0] == reference else (-1.0, pair.cameras[0])
            delays[name] = MeasuredTime(
                offset_ms=sign * pair.clock.bias_ns / 1e6,
                sd_ms=pair.reading_uncertainty_ns / SIGMAS_95 / 1e6,
                source=StampSource.LIGHT,
            )
    return MeasuredTimes(reference=reference, cameras=delays)
