"""Correction of an imported session's times by the panel that its images show: `panel read --apply`."""

from functools import partial

from capture_app.common.errors import BadInputError
from capture_app.companions.panel.panel_alignment import match_panels
from capture_app.companions.panel.panel_track import PanelTrack, TrackReading, make_track
from capture_app.companions.panel.session_times import SessionTimes
from capture_app.session.alignment.clock_line import chain_cameras
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.importing.realigning import realign_session
from capture_app.session.reading.reader import Session


def apply_panel(session: Session, times: SessionTimes) -> dict[str, CameraTimes]:
    """Change an imported session's times to those of its panel, and pair its images again.

    Returns each camera's correction of its present times. Raises NotApplicableError if the session was not
    imported, or if a camera did not see the panel with its turn code; see `realign_session`.
    """
    tracks = {name: _track(times, name) for name in times.cameras}
    cameras = chain_cameras(times.cameras, partial(_match, tracks))
    realign_session(session, cameras, "panel")
    return cameras


def _track(times: SessionTimes, camera: str) -> PanelTrack | str:
    """Return a camera's readings, by the session's present times; or why they do not tell its time."""
    seen = [
        TrackReading(picture.stamp_ns / 1e9, picture.reading, picture.row)
        for picture in times.pictures
        if picture.image.camera == camera
    ]
    try:
        return make_track(seen) if seen else "none of its images shows a readable panel"
    except BadInputError as error:
        return error.what


def _match(tracks: dict[str, PanelTrack | str], first: str, second: str) -> CameraTimes:
    one, other = tracks[first], tracks[second]
    if isinstance(one, str):
        return CameraTimes(reason=f"{first}: {one}")
    return CameraTimes(reason=other) if isinstance(other, str) else match_panels(one, other)
