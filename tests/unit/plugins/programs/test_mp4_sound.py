"""Sound in exported MP4s: on the rig's time at both ends, from a clock that is off."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.exporting.export_session import export_session
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from tests.imported import import_one

LATE_S = 1.25
CLICKS = (0.015, 0.25, 0.5, 0.75, 0.98)
"""Times of the clicks since the burst's earliest image, which is `early`'s, as fractions of the length."""
RATE_HZ = 44_100


def record(path: Path, times_s: np.ndarray, clicks_s: np.ndarray) -> None:
    """A video of grey frames with a sound track that clicks, both at the recording's own times."""
    samples = np.zeros((1, round((times_s[-1] + 1) * RATE_HZ)), np.int16)
    for click_s in clicks_s:
        first = round(click_s * RATE_HZ)
        samples[:, first : first + 20] = 20_000
    with av.open(str(path), "w", options={"movie_timescale": "1000000"}) as container:
        video = container.add_stream("libx264", rate=1, width=64, height=48, pix_fmt="yuv420p")
        video.time_base = video.codec_context.time_base = Fraction(1, 1_000_000)
        audio = container.add_stream("pcm_s16le", rate=RATE_HZ, layout="mono")
        for at_s in times_s:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 90, np.uint8), format="bgr24")
            frame.pts, frame.time_base = round(at_s * 1e6), video.time_base
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        sound = av.AudioFrame.from_ndarray(samples, format="s16", layout="mono")
        sound.sample_rate, sound.pts = RATE_HZ, 0
        container.mux(audio.encode(sound))
        container.mux(audio.encode(None))


def takes(folder: Path, length_s: int, ppm_of_late: float) -> tuple[Session, Path]:
    """Two recordings, and a folder with one of them, `late`. Times jitter by 1 ms.

    `late` starts later, and its clock is fast.
    """
    (given := folder / "given").mkdir()
    rng = np.random.default_rng(4)
    rows = ["camera,frame,time"]
    paths = {"early": folder / "early.mov", "late": given / "late.mov"}
    for name, begin_s, ppm in (("early", 0.0, 0), ("late", LATE_S, ppm_of_late)):
        since_s = np.arange(0, length_s - begin_s, 4)
        since_s[1:] += rng.uniform(-1e-3, 1e-3, len(since_s) - 1)
        fast = 1 + ppm * 1e-6
        record(paths[name], since_s * fast, (np.array(CLICKS) * length_s - begin_s) * fast)
        rows += [f"{name},{n},{begin_s + at_s:.6f}" for n, at_s in enumerate(since_s)]
    (table := folder / "times.csv").write_text("\n".join(rows))
    sources = [f"{name}={path}" for name, path in paths.items()]
    return import_one(sources, folder, "take", ImportOptions(timestamps=[("", table)])), given


def test_a_recording_of_another_take_is_refused(tmp_path: Path) -> None:
    session, given = takes(tmp_path, 12, 100)
    record(given / "late.mov", np.arange(2) / 2, np.array([1.0]))
    with pytest.raises(BadInputError, match="was not imported from"):
        export_session(session, "mp4", tmp_path / "out", sound=given)
    assert not (tmp_path / "out").exists()
