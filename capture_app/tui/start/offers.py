"""What this machine has to offer at the start: its cameras, its sessions, the samples."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.camera_facts import SIMULATED
from capture_app.cameras.base import CameraListing
from capture_app.cameras.catalog import DRIVERS
from capture_app.node.leader.local_nodes import VIEWS

SAMPLES = "sample_sessions"
SCENES = {scene: len(views) for scene, views in VIEWS.items()}
"""What simulated cameras can look at, and how many of them at once."""


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
