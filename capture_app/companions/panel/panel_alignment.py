"""Alignment of recordings by a panel that each camera saw: `sessions import --align panel`.

Both cameras read the refreshes of one screen, at their own times. What the screen adds (the delay until a
refresh is visible, its true rate) is equal for both, and one fit has it with the offset: least squares with
these unknowns, all relative to the panel's nominal time T of a reading:

    reference's time - T = start + stretch T + error of the reference's visit
    camera's time - T    = start + stretch T - offset - rate (camera's time - epoch) + error of its visit

A visit is a time in which a camera saw the panel. Its readings have errors in common, which their number does
not reduce: of the exposure and of the cells' response, as far as they depend on the place in a refresh.
"""

import numpy as np

from capture_app.companions.panel.finder import Floats
from capture_app.companions.panel.panel_track import PanelTrack
from capture_app.companions.panel.panel_video import read_panel_video
from capture_app.companions.panel.pattern import RATE_TOLERANCE
from capture_app.companions.panel.time_reading import SIGMAS_95
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.alignment.clock_line import CRYSTAL_PPM, fit_robustly
from capture_app.session.format.common_times import CameraTimes

COMMON_TICKS = 0.04
"""Standard deviation of a visit's common error, in refreshes, whatever the places in the refresh."""


def match_panels(reference: PanelTrack, camera: PanelTrack) -> CameraTimes:
    """Return the camera's times against the reference's; without an offset, the reason."""
    if reference.panel != camera.panel or reference.page != camera.page:
        one, other = (f"{track.panel.name}, page {track.page}" for track in (reference, camera))
        return CameraTimes(
            reason=f"they saw different panels ({one}; {other}): show one screen to all, and do not reload it"
        )
    tracks = reference, camera
    sizes = [len(track.own_s) for track in tracks]
    is_camera = np.repeat([0.0, 1.0], sizes)
    own, shown = (np.concatenate([getattr(track, name) for track in tracks]) for name in ("own_s", "shown_s"))
    sd = np.concatenate([_reading_sds(track) for track in tracks])
    epoch = float(np.average(camera.own_s, weights=camera.sd_s**-2))
    middle = float(shown.mean())
    visits, visit_sd = _visits(reference, camera)
    late = own - shown
    base = float(np.median(late[is_camera == 0])), float(np.median(late[is_camera == 1]))
    rows = np.column_stack(
        [np.ones(len(own)), (shown - middle), -is_camera, -is_camera * (own - epoch), visits]
    )
    prior_sd = np.concatenate([[np.inf, RATE_TOLERANCE, np.inf, CRYSTAL_PPM * 1e-6], visit_sd])
    target = late - np.where(is_camera > 0, base[1], base[0])
    # Missed refreshes weigh little.
    values, covariance = fit_robustly(rows, target, sd, prior_sd)
    offset_s, rate = base[0] - base[1] + float(values[2]), float(values[3])
    variance, shared, rate_variance = (float(covariance[place]) for place in ((2, 2), (2, 3), (3, 3)))
    # The epoch at which the rate's error does not count.
    shift = -shared / rate_variance
    return CameraTimes(
        offset_ns=round((offset_s + rate * shift) * 1e9),
        uncertainty_ns=round(SIGMAS_95 * float(np.sqrt(variance - shared**2 / rate_variance)) * 1e9),
        rate_ppm=round(rate * 1e6, 4),
        rate_uncertainty_ppm=round(SIGMAS_95 * float(np.sqrt(rate_variance)) * 1e6, 4),
        epoch_local_ns=round((epoch + shift) * 1e9),
        source="panel",
    )


def _reading_sds(track: PanelTrack) -> Floats:
    """Return each reading's standard deviation, s: as stated, or its visit's scatter if larger."""
    sd_s = track.sd_s.copy()
    for number in np.unique(track.visit):
        mine = track.visit == number
        late_s = track.own_s[mine] - track.shown_s[mine]
        scatter_s = 1.4826 * float(np.median(np.abs(late_s - np.median(late_s))))
        sd_s[mine] = np.maximum(sd_s[mine], scatter_s)
    return np.asarray(sd_s)


def _visits(*tracks: PanelTrack) -> tuple[Floats, Floats]:
    """Return a column (n,) for each visit, 1 for its readings, and each visit's common error (sd, s)."""
    columns, errors = [], []
    before, size = 0, sum(len(track.own_s) for track in tracks)
    for own_track in tracks:
        tick_s = own_track.panel.tick_ns / 1e9
        for number in np.unique(own_track.visit):
            mine = own_track.visit == number
            column = np.zeros(size)
            column[before : before + len(mine)] = mine
            columns.append(column)
            # 1 if all readings are at one place in the refresh, 0 if they are spread over all of it.
            same_place = float(abs(np.exp(2j * np.pi * own_track.shown_s[mine] / tick_s).mean()))
            errors.append(
                float(
                    np.hypot(
                        COMMON_TICKS * tick_s, own_track.alike * same_place * np.median(own_track.sd_s[mine])
                    )
                )
            )
        before += len(own_track.own_s)
    return np.column_stack(columns), np.array(errors)


METHOD: AlignmentMethod[PanelTrack] = AlignmentMethod(
    priority=5,
    of_video_times=True,
    read=lambda path, first_s: read_panel_video(path),
    match=lambda reference, camera, error_s: match_panels(reference, camera),
)
