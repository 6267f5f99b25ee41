"""Where the sample sessions are that come with the program."""

from pathlib import Path

import capture_app

SAMPLES = "sample_sessions"


def bundled_folders() -> list[Path]:
    """The folders that may hold them and are there: here, then beside the program."""
    places = (Path(SAMPLES), Path(capture_app.__file__).resolve().parents[1] / SAMPLES)
    return [place for place in places if place.is_dir()]
