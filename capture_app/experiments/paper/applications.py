"""The paper's applications: pictures that other commands make of bundled sessions, not measured here."""

import msgspec


class Application(msgspec.Struct, frozen=True):
    """What the paper shows, and the command that shows the same of a session that comes with the project."""

    place: str
    title: str
    command: str
    shows: str


JUMPER = "sample_sessions/jumper"
APPLICATIONS = (
    Application(
        "Figures 1, 2 and 10",
        "collages of five views at one instant, and bursts of five frames",
        f"reconstruct compare {JUMPER}",
        "its report has the burst as a grid of views and instants, and the sweep from camera to camera",
    ),
    Application(
        "Figure 8",
        "depth of a jumping person from a pair of cameras, against 66 ms",
        f"reconstruct compare {JUMPER} --offset-ms 66",
        "depth of both conditions, and how much of what moves is right",
    ),
    Application(
        "Figure 9",
        "a panorama of two pictures, against 66 ms",
        "reconstruct compare sample_sessions/crossing --offset-ms 66",
        "both panoramas, and how well the two pictures fit where they overlap",
    ),
    Application(
        "applications",
        "depth from five views, their offsets drawn from -66 to 66 ms",
        f"reconstruct compare {JUMPER}",
        "depth from all five cameras, synchronized and at distinct offsets",
    ),
    Application(
        "supplement",
        "a rotating pinwheel, where the cameras' poses fail offset",
        "reconstruct compare sample_sessions/pinwheel",
        "the rotation between cameras found from one instant alone",
    ),
)
