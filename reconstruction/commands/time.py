"""`reconstruct time`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import session_argument

if TYPE_CHECKING:
    from reconstruction.time_offsets.camera_time import CameraTime
    from reconstruction.time_offsets.session_offsets import TimeResult


@click.command(
    "time",
    epilog=examples(
        "reconstruct time sessions/burst-001",
        "reconstruct time sessions/videos --apply",
        "reconstruct time sessions/videos --repair-drops",
    ),
)
@session_argument
@click.option(
    "--reference",
    metavar="CAMERA",
    show_default="chosen automatically",
    help="Camera against which the others are measured.",
)
@click.option(
    "--apply",
    is_flag=True,
    help="Set the measured times of a recording without common times, and pair its images again.",
)
@click.option(
    "--repair-drops",
    is_flag=True,
    help="Pair the images of an imported session again where a camera dropped or repeated frames.",
)
@json_option
def time_command(
    session: Path, reference: str | None, apply: bool, repair_drops: bool, as_json: bool
) -> None:
    """Measure the time offset of each camera of SESSION, by a blinking lamp or by motion in its pictures.

    Pass an offset to --time-shift-ms of other commands to correct it. In a recording without common times,
    offsets of any size and clock rates are measured. A torch that blinks eight times in front of all cameras
    also gives the time between their rows.
    """
    from reconstruction.time_offsets.session_offsets import measure_times

    result = measure_times(session, reference, apply=apply, repair_drops=repair_drops)
    aligned = f"{session}: aligned by motion" if result.applied else ""
    repaired = f"{session}: images paired again" if result.repaired else _advice(result)
    changes = change_lines(result.reference, result.cameras)
    answer(as_json, result, filter(None, (*time_lines(result), *changes, aligned, repaired)))


def change_lines(reference: str, cameras: Mapping[str, "CameraTime"]) -> Iterator[str]:
    """Yield what changes over the take: dropped frames, other rates, and single images."""
    for name, camera_time in cameras.items():
        others = "the others" if name == reference else reference
        if camera_time.change:
            yield camera_time.change.describe(name, others)
        if camera_time.jitter_ms is not None:
            yield f"{name}'s frames wander by ± {2 * camera_time.jitter_ms:.1f} ms (95 %) about this offset"
        yield from camera_time.images.describe(name, others)


def _advice(result: "TimeResult") -> str:
    dropped = any(camera.change and camera.change.steps for camera in result.cameras.values())
    return f"pair them again: reconstruct time {result.session} --repair-drops" if dropped else ""


def time_lines(result: "TimeResult") -> Iterator[str]:
    """Yield each camera's offset, or why it is unknown."""
    for name, camera in result.cameras.items():
        if camera.offset_ms is None or camera.sd_ms is None:
            yield f"{name}: unknown: {camera.reason}"
        elif name == result.reference:
            yield f"{name}: the reference"
        else:
            more = " at first" if camera.change and camera.change.steps else ""
            if camera.misfit_px is not None:
                more += f", with the calibration corrected: its lines are {camera.misfit_px:.1f} px off"
            if camera.rate_ppm is not None and camera.rate_sd_ppm is not None:
                more += f", rate {camera.rate_ppm:+.1f} ± {2 * camera.rate_sd_ppm:.1f} ppm"
            if camera.row_time_ns is not None and camera.row_time_sd_ns is not None:
                more += f", rows {camera.row_time_ns / 1e3:.2f} ± {2 * camera.row_time_sd_ns / 1e3:.2f} us"
            plan = f", beyond the {camera.planned_ms:+.2f} ms by which it is staggered on purpose"
            said = f"{camera.offset_ms:+.2f} ± {2 * camera.sd_ms:.2f} ms{more} (95 %)"
            yield f"{name}: {said}{plan if camera.planned_ms else ''}"
