"""Sound with numbers that a camera's machine made up: an export leaves it out, and takes no memory for it."""

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.plugins.cameras.sound.image_sound import SoundPart, add_segments, sound_segments
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts

JPEG = cv2.imencode(".jpg", np.full((24, 32, 3), 90, np.uint8))[1].tobytes()
PERIOD_NS = 33_333_333
BEGIN_NS = 10**12
SECOND = b"\1\0" * 8_000
MAX_BYTES = 200_000_000


@pytest.mark.parametrize(
    ("rate_hz", "firsts", "apart_ns"),
    [
        (192_000, (0, 86_399 * 192_000), PERIOD_NS),
        (8_000, (0, 2**53 - 1), PERIOD_NS),
        (8_000, (0, 8_000 * 600), PERIOD_NS),
        (8_000, (0, 8_000 * 5), 0),
        (8_000, (8_000 * 5, 0), PERIOD_NS),
        (8_000, (0, 8_000 * 86_000), 86_000 * 10**9),
    ],
    ids=[
        "a day apart",
        "the largest number",
        "ten minutes apart",
        "a clock at rest",
        "backwards",
        "a day apart by a clock that says so",
    ],
)
def test_it_is_left_out_and_said(
    tmp_path: Path, rate_hz: int, firsts: tuple[int, ...], apart_ns: int
) -> None:
    writer, warnings = SessionWriter.create(tmp_path / "sessions", "take"), list[str]()
    instants = tuple(BEGIN_NS + number * PERIOD_NS for number in range(len(firsts)))
    for number, first in enumerate(firsts):
        part = SoundPart(1, first, rate_hz, 1, instants[0] + number * apart_ns, SECOND)
        data = add_segments(JPEG, sound_segments([part]))
        writer.add_image(data, camera="a", instant=number, leader_ns=instants[number], local_ns=part.local_ns)
    burst = BurstRecord(instants_ns=instants, period_ns=PERIOD_NS)
    camera = CameraRecord(name="a", facts=make_facts(width=32, height=24))
    session = writer.finish([camera], burst, [], origin="simulated")
    tracemalloc.start()
    try:
        export_session(session, "mp4", tmp_path / "out", on_warning=warnings.append)
        assert tracemalloc.get_traced_memory()[1] < MAX_BYTES
    finally:
        tracemalloc.stop()
    assert (tmp_path / "out" / "a.mp4").is_file() or list((tmp_path / "out").rglob("*.mp4"))
    assert any("contradict" in line for line in warnings), warnings
