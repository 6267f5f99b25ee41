"""What this machine has to offer at the start: its cameras, its sessions, the samples."""

from dataclasses import dataclass
from pathlib import Path

from textual.content import Content
from textual.widgets.option_list import Option

from capture_app.camera_facts import SIMULATED
from capture_app.cameras.base import CameraListing
from capture_app.cameras.catalog import DRIVERS
from capture_app.node.leader.local.local_nodes import VIEWS
from capture_app.text import printable

SAMPLES = "sample_sessions"
SCENES = {scene: len(views) for scene, views in VIEWS.items()}
"""What simulated cameras can look at, and how many of them at once."""


TITLE_WIDTH = 26
"""Leaves room for the code beside the list in a narrow terminal."""


@dataclass(frozen=True, slots=True)
class Offers:
    """What was found."""

    cameras: tuple[CameraListing, ...]
    sessions: int
    """How many sessions are in the folder."""
    samples: Path | None
    """The folder of sample sessions, where there is one."""


def find_offers(sessions: Path, *, local: bool) -> Offers:
    """Look around; opens camera devices, so it may take a second. `local`: cameras here can be the rig's."""
    cameras: list[CameraListing] = []
    if local:
        for kind, driver in DRIVERS.items():
            if kind != SIMULATED:
                cameras += driver.load().list_cameras()
    places = (Path(SAMPLES), Path(__file__).resolve().parents[3] / SAMPLES)
    samples = next((place for place in places if _count(place)), None)
    return Offers(tuple(cameras), _count(sessions), samples)


def _count(folder: Path) -> int:
    try:
        return sum((place / "session.json").is_file() for place in folder.iterdir())
    except OSError:
        return 0


@dataclass(frozen=True, slots=True)
class Offer:
    """A line of the list of what can be chosen."""

    id: str
    key: str
    title: str
    usable: bool = True

    def option(self, *, again: bool) -> Option:
        """Draw it; `again`: it was chosen last time."""
        words = Content.assemble(
            (f" {self.key} ", "bold $primary"),
            f" {_cut(printable(self.title))}",
            ("  last time" if again else "", "italic $secondary"),
        )
        return Option(words, id=self.id, disabled=not self.usable)


def _cut(text: str) -> str:
    return text if len(text) <= TITLE_WIDTH else text[: TITLE_WIDTH - 1] + "…"
