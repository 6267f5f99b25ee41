"""Time errors of simulated cameras' images against the leader, by the truth in their sessions.

The bursts are taken by real processes in network namespaces.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from benchmarks.emulated_link.network import CAPTURE_APP, read_output
from capture_app.session.reading.reader import Session


def take_burst(namespace: str, leader: str, *, nodes: int, frames: int, wait_s: int) -> dict[str, Any]:
    """Take a burst with the command, once this many nodes are ready; return its output."""
    ask = ("burst", "--leader", leader, "--frames", str(frames), "--wait-s", str(wait_s), "--json")
    return dict(json.loads(read_output(namespace, *CAPTURE_APP, *ask, "--min-nodes", str(nodes))))


class ClockError(NamedTuple):
    """Error of one image's time and its stated bounds, in us."""

    off_us: float
    sure_us: float
    bound_us: float
    late_us: float
    """From the requested instant to the true start of its exposure."""


def read_clock_errors(folders: Iterable[Path]) -> dict[str, list[ClockError]]:
    """Return the errors of all images of these sessions, by camera."""
    found: dict[str, list[ClockError]] = {}
    for folder in folders:
        session = Session.open(folder)
        truth = session.true_times()
        assert truth is not None
        exposed_ns = {(image.camera, image.instant): image.true_ns for image in truth.images}
        for image in session.manifest.images:
            assert image.local_ns is not None
            off_ns = image.leader_ns - truth.clocks[image.camera].true_from_local(image.local_ns)
            stated_ns = image.uncertainty_ns or 0, image.hard_bound_ns or 0
            instant_ns = session.manifest.burst.instants_ns[image.instant]
            late_ns = exposed_ns[image.camera, image.instant] - instant_ns
            error = ClockError(*(one / 1000 for one in (off_ns, *stated_ns, late_ns)))
            found.setdefault(image.camera, []).append(error)
    return found


def error_figures(errors: Sequence[ClockError]) -> dict[str, float]:
    """Return the figures that a table shows; its columns are COLUMNS."""
    return {
        "images": len(errors),
        "mean_abs_us": fmean(abs(error.off_us) for error in errors),
        "max_us": max(abs(error.off_us) for error in errors),
        "stated_95_us": fmean(error.sure_us for error in errors),
        "stated_95_held": sum(abs(error.off_us) <= error.sure_us for error in errors),
        "bound_us": fmean(error.bound_us for error in errors),
        "bound_held": sum(abs(error.off_us) <= error.bound_us for error in errors),
    }


COLUMNS = {
    "images": ("images", ""),
    "mean_abs_us": ("mean", ".1f"),
    "max_us": ("largest", ".1f"),
    "stated_95_us": ("95 %", ".1f"),
    "stated_95_held": ("held", ""),
    "bound_us": ("bound", ".1f"),
    "bound_held": ("held", ""),
}
