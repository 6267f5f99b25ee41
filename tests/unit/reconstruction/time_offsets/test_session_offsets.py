"""The offsets of a session's cameras, by a small drawn lamp, and what is refused before it is measured."""

from typing import Any

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError, SimulshotError
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.session_offsets import measure_times
from tests.unit.reconstruction.conftest import texture
from tests.unit.reconstruction.time_offsets.blinking import BlinkCamera, Lamp, blink_times, write_blinks

ROWS, COLUMNS, LATE_NS = 120, 40, 9_300_000
SLOW_ROWS_NS, FAST_ROWS_NS = 230_000, 140_000


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Two walls that a lamp lights four times, with a camera each; b is late."""
    walls = [(texture(seed)[:ROWS, :COLUMNS] / 255.0) ** 2.2 for seed in (1, 2)]
    cameras = {
        "a": BlinkCamera(walls[:1], SLOW_ROWS_NS, 3_000_000),
        "b": BlinkCamera(walls[1:], FAST_ROWS_NS, 8_000_000, LATE_NS, period_share=0.3),
    }
    lamp = Lamp(blink_times(np.random.default_rng(3), 4))
    return write_blinks(tmp_path_factory.mktemp("lamp"), "lamp", cameras, lamp, seed=5)


@pytest.mark.parametrize(
    ("reference", "other", "late_ms", "row_ns"),
    [(None, "b", LATE_NS / 1e6, FAST_ROWS_NS), ("b", "a", -LATE_NS / 1e6, SLOW_ROWS_NS)],
)
def test_a_lamp_tells_how_late_a_camera_is(
    lit: Session, reference: str | None, other: str, late_ms: float, row_ns: int
) -> None:
    result = measure_times(lit.folder, reference)
    assert result.reference == (reference or "a")
    assert (result.cameras[result.reference].offset_ms, result.calibration) == (0.0, "")
    offset = result.cameras[other]
    assert (offset.source, result.applied, result.repaired) == ("light", False, False)
    assert offset.offset_ms is not None
    assert offset.sd_ms is not None
    assert offset.sd_ms < 0.5
    assert abs(offset.offset_ms - late_ms) < 2.5 * offset.sd_ms
    assert offset.row_time_ns == pytest.approx(row_ns, rel=0.1)


@pytest.mark.parametrize(
    ("options", "kind", "said"),
    [
        ({"apply": True}, NotApplicableError, "already have common times"),
        ({"repair_drops": True}, NotApplicableError, "no dropped or repeated frame is found in lamp"),
        ({"reference": "c"}, BadInputError, "--reference"),
    ],
)
def test_what_a_session_with_common_times_does_not_need_is_refused(
    lit: Session, options: dict[str, Any], kind: type[SimulshotError], said: str
) -> None:
    before = (lit.folder / "session.json").read_bytes()
    with pytest.raises(kind, match=said):
        measure_times(lit.folder, **options)
    assert (lit.folder / "session.json").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "kind", "said"),
    [
        ({"repair_drops": True}, NotApplicableError, "have no common times yet"),
        ({"reference": "b"}, BadInputError, "are measured against a"),
    ],
)
def test_recordings_without_common_times_are_aligned_first_and_to_the_first_camera(
    lit: Session,
    monkeypatch: pytest.MonkeyPatch,
    options: dict[str, Any],
    kind: type[SimulshotError],
    said: str,
) -> None:
    manifest = lit.stored_manifest
    times = CommonTimes(state="unknown", reason="each video counts from its own beginning")
    burst = msgspec.structs.replace(manifest.burst, common_times=times)
    session = Session(lit.folder, msgspec.structs.replace(manifest, burst=burst))

    monkeypatch.setattr(Dataset, "open", lambda *_: Dataset(session))
    with pytest.raises(kind, match=said):
        measure_times(lit.folder, **options)
