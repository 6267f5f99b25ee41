"""The paper's applications: which command shows the same of a bundled session, and what of its result."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec

BURST, SWEEP_STEP = "burst", "what moves, from picture to picture in the sweep"


class Measure(msgspec.Struct, frozen=True):
    """A number of synchronized pictures, and of those that are some time apart."""

    label: str
    unit: str
    synced: float | None
    offset: float | None


class Application(msgspec.Struct, frozen=True, kw_only=True):
    """What the paper shows, the command that shows the same, and what that command found."""

    key: str
    place: str
    title: str
    command: str
    measures: tuple[Measure, ...] = ()
    files: tuple[str, ...] = ()
    """Of both conditions, synchronized first; one alone is of synchronized pictures."""


@dataclass(frozen=True, slots=True)
class Showing:
    """An application, and what of the results of `reconstruct compare` it is."""

    application: Application
    session: str
    study: str
    """Its name in `metrics.json`."""
    picture: str = ""
    measures: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Label and unit by name."""


_COMPARE = "reconstruct compare sample_sessions"
_DEPTH = {
    "mover_within_2pct": ("what moves, its distance within 2 % of the truth", "%"),
    "static_within_2pct": ("what stands still (control)", "%"),
}
APPLICATIONS = (
    Showing(
        Application(
            key="figures-1-2-10",
            place="Figures 1, 2 and 10",
            title="A burst of five views (a row for each camera), and collages of one instant",
            command=f"{_COMPARE}/jumper",
        ),
        "jumper",
        BURST,
    ),
    Showing(
        Application(
            key="figure-8",
            place="Figure 8",
            title="Depth of a jumping person from a pair of cameras, and 66 ms apart",
            command=f"{_COMPARE}/jumper --offset-ms 66",
        ),
        "jumper",
        "stereo",
        "stereo_depth",
        _DEPTH,
    ),
    Showing(
        Application(
            key="five-views",
            place="Applications",
            title="Depth from five views, and at offsets from -66 to 66 ms",
            command=f"{_COMPARE}/jumper",
        ),
        "jumper",
        "multiview",
        "multiview_depth",
        _DEPTH,
    ),
    Showing(
        Application(
            key="figure-9",
            place="Figure 9",
            title="Where two pictures of a panorama overlap, laid over each other, and 66 ms apart",
            command=f"{_COMPARE}/crossing --offset-ms 66",
        ),
        "crossing",
        "stitch",
        "panorama_overlap",
        {
            "mover_misfit_px": ("what moves, misfit", "px"),
            "static_misfit_px": ("what stands still (control)", "px"),
        },
    ),
    Showing(
        Application(
            key="pinwheel",
            place="Supplement",
            title="A rotating pinwheel, where poses found from single instants fail",
            command=f"{_COMPARE}/pinwheel",
        ),
        "pinwheel",
        "poses",
        "",
        {
            "correct_pairs": ("pairs of cameras placed right", "%"),
            "rotation_deg": ("error of the rotation between two cameras", "degrees"),
        },
    ),
)
"""In the order of the page."""
