"""What `time` says of cameras that are staggered on purpose, and of a take with images a frame late."""

from pathlib import Path

import pytest

from benchmarks.reconstruction.verdict_takes import Take, session_of
from reconstruction.method.timing import measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.session_offsets import measure_times
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, write_session


def test_a_planned_delay_is_not_taken_for_an_offset(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    session = write_session(
        tmp_path, scene, pair, instants=8, truth=False, steps={"right": 0.5}, late={"right": 0.2}
    )
    right = measure_times(session.folder, "left").cameras["right"]
    assert right.planned_ms == pytest.approx(PERIOD_NS / 2e6)
    assert right.offset_ms is not None
    assert right.sd_ms is not None
    assert right.offset_ms == pytest.approx(0.2 * PERIOD_NS / 1e6, abs=3 * right.sd_ms)
    said = reconstruct("time", session.folder, "--reference", "left").out
    assert f"(95 %), beyond the +{PERIOD_NS / 2e6:.2f} ms by which it is staggered on purpose" in said


def test_a_take_with_a_third_of_its_images_a_frame_late_is_not_certified(tmp_path: Path) -> None:
    """The others are on time, so that the offset of most is `0.0 ± 0.8 ms`."""
    late = (2, 5, 8, 10, 13, 15, 17, 20, 23, 26, 28)
    session = session_of(Take("boards", 0, frames=30, glitches=late), tmp_path, None)
    timing = measure_pair_timing(PairOffsets(OpenScene(Dataset.open(session))), ("left", "right"))
    assert not timing.synchronized
    assert timing.same_frame_ms is None
    # The last one's next image is the last of the take.
    assert timing.images.stalled == tuple(k + 1 for k in late[:-1])
