"""Calibration of camera times from images: the delay of each camera's timestamps, or its clock error."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import msgspec

from capture_app.common.address import Address
from capture_app.common.camera_facts import UNMEASURED, StampAccuracy, StampSource
from capture_app.common.child import LOWEST_PRIORITY, ask_reconstruct
from capture_app.protocol.orders import SaveStamp, StampSaved
from capture_app.rig.rig_link import ask_leader
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.sync.clock.clock_filter import PathAsymmetry
from capture_app.sync.clock.time_map import SIGMAS_95


class MeasuredTime(msgspec.Struct, frozen=True, kw_only=True):
    """One camera in the output of `reconstruct time --json`: its time offset, or why that is unknown."""

    offset_ms: float | None = None
    sd_ms: float | None = None
    source: str = ""
    reason: str = ""
    row_time_ns: float | None = None
    row_time_sd_ns: float | None = None


class MeasuredTimes(msgspec.Struct, frozen=True, kw_only=True):
    """Output of `reconstruct time --json` for a session."""

    reference: str
    cameras: dict[str, MeasuredTime]


async def calibrate(
    leader: Address, session: Session, measured: MeasuredTimes | None = None
) -> tuple[MeasuredTimes, dict[str, SaveStamp], dict[str, bool]]:
    """Measure the camera times of a session, unless `measured` has them, and have each node store its own.

    Return the measurements, the timestamp delay or path asymmetry by which each camera's node now corrects
    its times, and by camera whether the node saved it.
    Raises the error of `reconstruct time`: NotAvailableError where it is not installed, BadInputError where
    it cannot measure; NetworkError, and the leader's own errors.
    """
    records = {record.name: record for record in session.manifest.cameras}
    if measured is None:
        reference = choose_reference(records)
        arguments = ["time", str(session.folder), *([] if reference is None else ["--reference", reference])]
        measured = await ask_reconstruct(arguments, MeasuredTimes, niceness=LOWEST_PRIORITY)
    stamps = measured_stamps(records, measured)
    asymmetries = measured_asymmetries(records, measured, stamps)
    given = {
        name: SaveStamp(camera=name, stamp=stamps.get(name), asymmetry=asymmetries.get(name))
        for name in (*stamps, *asymmetries)
    }
    saved: dict[str, bool] = {}
    for name, order in given.items():
        answer = await ask_leader(leader, order, StampSaved)
        saved[name] = answer.is_stored
        if order.asymmetry is not None and answer.asymmetry_uncertainty_ns is not None:
            path = replace(order.asymmetry, uncertainty_ns=answer.asymmetry_uncertainty_ns)
            given[name] = msgspec.structs.replace(order, asymmetry=path)
    return measured, given, saved


def choose_reference(records: Mapping[str, CameraRecord]) -> str | None:
    """Return the camera with the smallest time uncertainty; None if no camera's timestamps are calibrated."""
    known_ns = {
        name: math.hypot(record.facts.stamp_accuracy.uncertainty_ns, _clock_error_ns(record))
        for name, record in records.items()
        if record.facts.stamp_accuracy.source not in UNMEASURED
    }
    return min(known_ns, key=known_ns.__getitem__, default=None)


def measured_stamps(records: Mapping[str, CameraRecord], measured: MeasuredTimes) -> dict[str, StampAccuracy]:
    """Return the newly measured timestamp accuracy of each camera that was not known better before.

    Each measurement is relative to the reference camera. If the reference's own timestamp delay is
    unmeasured, its assumed delay is used, and the other cameras are accurate only relative to it.
    """
    own = records[measured.reference].facts.stamp_accuracy
    is_known = own.source not in UNMEASURED
    against = own.against if is_known else measured.reference
    base_ns = own.uncertainty_ns if is_known else 0
    common_ns = records[measured.reference].facts.shared_uncertainty_ns if is_known else own.uncertainty_ns
    by_light = {name for name, time in measured.cameras.items() if time.source == StampSource.LIGHT}
    by_light |= {measured.reference} if by_light else set()
    times = {}
    for name, time in measured.cameras.items():
        if time.offset_ms is None or time.sd_ms is None or name not in records:
            continue
        facts, known = records[name].facts, records[name].facts.stamp_accuracy
        parts_ns = [SIGMAS_95 * time.sd_ms * 1e6, base_ns]
        if name != measured.reference:
            parts_ns += [_clock_error_ns(records[camera]) for camera in (name, measured.reference)]
        error_ns = round(math.hypot(*parts_ns))
        if known.source not in UNMEASURED:
            same_reference = known.against == against
            before_ns = known.uncertainty_ns + (0 if same_reference else facts.shared_uncertainty_ns)
            if before_ns <= error_ns + (0 if same_reference else common_ns):
                continue
        times[name] = StampAccuracy(
            # Light later than its timestamp means a smaller timestamp delay than the one subtracted.
            bias_ns=known.bias_ns - round(time.offset_ms * 1e6),
            uncertainty_ns=error_ns,
            source=StampSource.LIGHT if name in by_light else StampSource.MOTION,
            exposure_ns=facts.exposure_ns,
            against=against,
            against_uncertainty_ns=common_ns if against else None,
        )
    return times


def measured_asymmetries(
    records: Mapping[str, CameraRecord], measured: MeasuredTimes, stamps: Collection[str]
) -> dict[str, PathAsymmetry]:
    """Return the path asymmetry that explains each camera's clock error, for cameras not in `stamps`.

    Unequal path delays shift a clock, and messages cannot reveal that. Measurements that are no better than
    the typical symmetry of two paths are left out.
    """
    reference, times = records[measured.reference], {}
    for name, time in measured.cameras.items():
        if time.offset_ms is None or time.sd_ms is None or name not in records or name in stamps:
            continue
        record = records[name]
        shared = record.facts.stamp_accuracy.against == reference.facts.stamp_accuracy.against
        if record.clock is None or not shared or record.facts.stamp_accuracy.source in UNMEASURED:
            continue
        error_ns = math.hypot(
            SIGMAS_95 * time.sd_ms * 1e6,
            _clock_error_ns(reference),
            reference.facts.stamp_accuracy.uncertainty_ns,
            record.facts.stamp_accuracy.uncertainty_ns,
        )
        asymmetry = PathAsymmetry(time.offset_ms * 1e6, error_ns, record.clock.round_trip_ns)
        if name != measured.reference and asymmetry.sigma(asymmetry.round_trip_ns) is not None:
            times[name] = asymmetry
    return times


def _clock_error_ns(record: CameraRecord) -> int:
    return 0 if record.clock is None else record.clock.uncertainty_ns
