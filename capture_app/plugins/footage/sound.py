"""Alignment by sound, by cross-correlation.

Sound is matched roughly first, by its rises in loudness (as of a clap or speech) over the whole length. Short
windows of the waveforms then refine the offset (generalized cross-correlation with phase transform, Knapp and
Carter 1976).
"""

from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.alignment.clock_line import fit_clock_line
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.format.lens import Array
from capture_app.session.importing.recording_sources import chapter_shifts_ns, later_chapters
from capture_app.session.importing.video_tracks import read_track, video_times_ns

RATE_HZ = 16_000
BIN_S = 0.004
"""Length of a loudness bin, s."""
WINDOW_S = 1.0
WINDOWS = 80
"""Maximum number of windows; they are the loudest ones, distributed over the common recording time."""
MAX_ERROR_S = 0.08
"""Maximum error of the rough offset, including clock drift."""
DISTINCT = 1.4
"""Minimum ratio of the best rough correlation to the second best."""
PROMINENT = 8.0
"""Minimum height of a correlation peak in standard deviations of chance, also in each window."""
WINDOW_SD_S = 5e-5
MIN_JUMP_S = 0.004
"""Minimum change of the offset within a recording; half a frame at 120 frames/s."""
MIN_SIDE = 3
"""Minimum number of windows before and after a jump."""
CLEARER = 4.0
"""Minimum factor by which a jump fits the offsets better than a constant rate does."""
Samples = NDArray[np.float32]


Sound = tuple[Samples, float]
"""The channels (1 or 2, n) of a sound track at `RATE_HZ`, and its beginning in the video's own times, s."""


def read_sound(path: Path) -> Sound:
    """Return the sound of a recording, whose later chapters are beside the video.

    Raises BadInputError with a short reason if there is none.
    """
    chapters = [path, *later_chapters(path)]
    sounds = [_read_file(chapter) for chapter in chapters]
    if len(sounds) == 1:
        return sounds[0]
    times_ns = [video_times_ns(chapter) for chapter in chapters]
    if not all(times_ns):
        raise BadInputError("a chapter has no times of its own")
    starts_s = [
        own_s + shift_ns / 1e9
        for (_, own_s), shift_ns in zip(sounds, chapter_shifts_ns(times_ns), strict=True)
    ]
    start_s = min(starts_s)
    places = [
        (round((begin_s - start_s) * RATE_HZ), samples)
        for begin_s, (samples, _) in zip(starts_s, sounds, strict=True)
    ]
    size = max(place + samples.shape[1] for place, samples in places)
    joined = np.zeros((len(places[0][1]), size), np.float32)
    # An encoder adds some silence to the begin and to the end of each file.
    for place, samples in places:
        joined[:, place : place + samples.shape[1]] = samples
    return joined, start_s


def _read_file(path: Path) -> Sound:
    samples, start_s = read_track(path, RATE_HZ, "fltp", 2)
    if not samples.any():
        raise BadInputError("it has no sound")
    return samples, start_s


def match_sounds(reference: Sound, camera: Sound, error_s: float) -> CameraTimes:
    """Return the camera's times against the reference's; without an offset, the reason.

    `error_s` (95 %): possible offset between the cameras' sounds while their images are simultaneous.
    """
    (_, reference_start_s), (_, start_s) = reference, camera
    reason = ""
    for reference_samples, samples in product(_tracks(reference[0]), _tracks(camera[0])):
        rough_s = _rough_offset((reference_samples, reference_start_s), (samples, start_s))
        if not isinstance(rough_s, str):
            break
        reason = reason or rough_s
    else:
        return CameraTimes(reason=reason)
    blocks = []
    size = round(WINDOW_S * RATE_HZ)
    for at in _loud_windows(samples, size):
        centre_s = start_s + (at + size / 2) / RATE_HZ
        expected = round((centre_s + rough_s - reference_start_s) * RATE_HZ - size / 2)
        # A window beyond either end of the reference is too short.
        window = reference_samples[max(0, expected) : max(0, expected + size)]
        if len(window) == size and (lag := _lag(window, samples[at : at + size])) is not None:
            blocks.append((centre_s, reference_start_s + (expected + lag + size / 2) / RATE_HZ))
    if not blocks:
        return CameraTimes(reason="their sounds are loud at the same moments, but are not alike")
    camera_s, reference_s = np.array(blocks).T
    jump = find_jump(camera_s, reference_s - camera_s)
    wrong_s = 0.0 if jump is None else abs(jump.by_s)
    times = fit_clock_line(
        camera_s, reference_s, np.full(len(blocks), WINDOW_SD_S), "sound", systematic_s=error_s + wrong_s
    )
    return times if jump is None else structs.replace(times, reason=str(jump))


def _tracks(channels: Samples) -> list[Samples]:
    """Return the mean of the channels, then each: one may have a timecode instead of the room."""
    rows = np.atleast_2d(channels)
    return [rows.mean(0), *(rows if len(rows) > 1 else ())]


class Jump(NamedTuple):
    """A change of the offset (s) between two of the camera's own times (s)."""

    by_s: float
    after_s: float
    before_s: float

    def __str__(self) -> str:
        """Report which recording lost frames, their number and place."""
        who, lost_ms = "it" if self.by_s > 0 else "the other camera", 1000 * abs(self.by_s)
        where = f"between {self.after_s:.1f} and {self.before_s:.1f} s"
        return f"{where} {who} loses {lost_ms:.0f} ms of sound, so frames may be lost there"


def find_jump(camera_s: Array, late_s: Array) -> Jump | None:
    """Return where a camera's offsets `late_s` (n,) at its ascending times (n,) jump; None if they do not."""
    places = range(MIN_SIDE, len(late_s) + 1 - MIN_SIDE)
    if not places:
        return None

    def residual(place: int) -> float:
        return sum(float(np.abs(side - np.median(side)).sum()) for side in np.split(late_s, [place]))

    best = min(places, key=residual)
    by_s = float(np.median(late_s[best:]) - np.median(late_s[:best]))
    steady = np.polynomial.Polynomial.fit(camera_s, late_s, 1)
    drifting = float(np.abs(late_s - steady(camera_s)).sum())
    if abs(by_s) < MIN_JUMP_S or drifting < CLEARER * residual(best):
        return None
    return Jump(by_s, float(camera_s[best - 1]), float(camera_s[best]))


def _rough_offset(reference: tuple[Samples, float], camera: tuple[Samples, float]) -> float | str:
    """Return the approximate offset (s) to add to the camera's times, or the reason why it is unknown."""
    a, b = (_onsets(samples) for samples, _ in (reference, camera))
    if min(len(a), len(b)) < 2 / BIN_S or not a.any() or not b.any():
        return "a sound track is too short or silent"
    size = 1 << (len(a) + len(b)).bit_length()
    fits = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    noise = 1.4826 * float(np.median(np.abs(fits - np.median(fits)))) + 1e-12
    best = int(fits.argmax())
    near = round(MAX_ERROR_S / BIN_S)
    second = np.roll(fits, -best)[near : size - near].max()
    if fits[best] < max(PROMINENT * noise, DISTINCT * second):
        return "their sounds do not agree on one offset"
    return reference[1] - camera[1] + (best if best < len(a) else best - size) * BIN_S


def _onsets(samples: Samples) -> NDArray[np.float64]:
    """Return the rise of each bin's log loudness over the previous bin, with low tones weighted less."""
    size = round(BIN_S * RATE_HZ)
    bright = np.diff(samples, prepend=samples[:1])
    energy = (bright[: len(bright) // size * size].reshape(-1, size) ** 2).mean(1).astype(np.float64)
    loud = np.log(energy + 1e-3 * energy.mean() + 1e-15)
    rises = np.clip(np.diff(loud, prepend=loud[:1]), 0, None)
    return np.asarray(rises - rises.mean())


def _loud_windows(samples: Samples, size: int) -> list[int]:
    """Return the starts of the windows: the loudest one in each of many equal parts."""
    starts = np.arange(0, max(1, len(samples) - size + 1), size // 2)
    sums = np.concatenate([[0.0], np.cumsum(np.diff(samples, prepend=samples[:1]).astype(np.float64) ** 2)])
    energies = sums[np.minimum(starts + size, len(samples))] - sums[starts]
    parts = np.array_split(np.arange(len(starts)), min(WINDOWS, len(starts)))
    return [int(starts[part[energies[part].argmax()]]) for part in parts if energies[part].max() > 0]


def _lag(reference: Samples, camera: Samples) -> float | None:
    """Return the delay of the reference in samples, with a fraction; None if the two do not correlate."""
    size = 2 * len(reference)
    taper = np.hanning(len(reference))
    spectrum = np.fft.rfft(reference * taper, size) * np.conj(np.fft.rfft(camera * taper, size))
    strength = np.abs(spectrum)
    # The phase of very weak frequencies is noise.
    weight = np.where(strength > 1e-3 * strength.max(), 1 / np.maximum(strength, 1e-20) ** 0.8, 0.0)
    fits = np.fft.fftshift(np.fft.irfft(spectrum * weight, size))
    middle, max_lag = size // 2, round(MAX_ERROR_S * RATE_HZ)
    near = fits[middle - max_lag : middle + max_lag + 1]
    best = int(near.argmax())
    noise = 1.4826 * float(np.median(np.abs(near - np.median(near)))) + 1e-20
    if not 0 < best < len(near) - 1 or near[best] < PROMINENT * noise:
        return None
    before, now, after = near[best - 1 : best + 2]
    return best - max_lag + 0.5 * float((before - after) / (before - 2 * now + after))


METHOD: AlignmentMethod[Sound] = AlignmentMethod(
    priority=4, of_video_times=True, read=lambda path, first_s: read_sound(path), match=match_sounds
)
