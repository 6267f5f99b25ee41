"""Correction of an imported session's times by the panel that its images show: `panel read --apply`."""

from functools import partial

from capture_app.common.errors import BadInputError
from capture_app.companions.panel.panel_alignment import match_panels
from capture_app.companions.panel.panel_track import PanelTrack, TrackReading, make_track
from capture_app.companions.panel.session_times import SessionTimes
from capture_app.session.alignment.clock_line import chain_cameras, measure_pairs
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.importing.realigning import realign_session
from capture_app.session.reading.reader import Session


def apply_panel(session: Session, times: SessionTimes) -> dict[str, CameraTimes]:
    """Change an imported session's times to those of its panel, and pair its images again.

    Returns each camera's correction of its present times. Raises NotApplicableError if the session was not
    imported, or if a camera did not see the panel with its cycle code; see `realign_session`.
    """
    cameras = chain_cameras(times.cameras, measure_pairs(partial(_track, times), match_panels))
    realign_session(session, cameras, "panel")
    return cameras


def _track(times: SessionTimes, camera: str) -> PanelTrack:
    """Return a camera's readings, by the session's present times. Raises BadInputError without any."""
    seen = [
        TrackReading(picture.stamp_ns / 1e9, picture.reading, picture.row)
        for picture in times.pictures
        if picture.image.camera == camera
    ]
    if not seen:
        raise BadInputError("none of its images shows a readable panel")
    return make_track(seen)
