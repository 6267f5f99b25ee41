"""The offsets of a session's cameras, by a small drawn lamp, and what is refused before it is measured."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError, SimulshotError
from capture_app.console.terminal import Progress
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets import motion_alignment, session_offsets
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.lamp import LIGHT, NO_LAMP
from reconstruction.time_offsets.motion_alignment import align_cameras
from reconstruction.time_offsets.rig_offsets import MOTION
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


def camera(late_ms: float, source: str = LIGHT, **fields: Any) -> CameraTime:
    return CameraTime(offset_ms=late_ms, sd_ms=0.1, source=source, **fields)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The steps that are shown."""
    texts: list[str] = []

    def step(self: Progress, text: str) -> None:
        self.done += 1
        texts.append(text)

    monkeypatch.setattr(Progress, "step", step)
    return texts


@pytest.mark.parametrize("asked", [None, "a"])
def test_cameras_that_see_no_lamp_are_measured_by_motion_against_the_lamps_reference(
    lit: Session, monkeypatch: pytest.MonkeyPatch, steps: list[str], asked: str | None
) -> None:
    scene = Scene(Dataset(lit))
    by_light = {
        "a": camera(0, REFERENCE),
        "b": camera(7),
        "c": CameraTime(reason=NO_LAMP),
        "d": CameraTime(reason="the lamp is slow"),
        "e": CameraTime(reason="nothing moves"),
    }
    by_motion = {
        "a": camera(0, REFERENCE),
        "b": camera(6, MOTION),
        "c": camera(3, MOTION),
        "d": CameraTime(reason="nothing moves"),
        "e": CameraTime(reason="nothing moves"),
    }
    references: list[str | None] = []

    def measured(scene: Scene, reference: str | None, progress: Progress) -> dict[str, CameraTime]:
        references.append(reference)
        return by_motion

    calibrated: list[Scene] = []
    monkeypatch.setattr(Scene, "calibration", property(calibrated.append))
    monkeypatch.setattr(session_offsets, "measure_light_offsets", lambda dataset, reference: dict(by_light))
    monkeypatch.setattr(session_offsets, "measure_rig_offsets", measured)
    monkeypatch.setattr(Scene, "source", "a board")
    cameras, calibration = session_offsets._common_times(scene, asked, Progress(9))
    assert (references, calibration, steps) == (["a"], "a board", ["lamp", "calibration"])
    assert calibrated == [scene]
    assert (cameras["b"], cameras["c"]) == (by_light["b"], by_motion["c"])
    assert cameras["d"].reason == "nothing moves; the lamp is slow"
    assert cameras["e"].reason == "nothing moves"
    # If nobody sees it, motion chooses the reference.
    dark = {name: CameraTime(reason=NO_LAMP) for name in by_motion}
    monkeypatch.setattr(session_offsets, "measure_light_offsets", lambda dataset, reference: dict(dark))
    assert session_offsets._common_times(scene, None, Progress(9))[0] == by_motion
    assert references == ["a", None]


def test_dropped_frames_are_repaired_by_their_steps(lit: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    change = Change(steps=(Step(20, 1, 19, 21), Step(40, -2, 39, 41)))
    cameras = {"a": camera(0, REFERENCE), "b": camera(7, MOTION, change=change)}
    monkeypatch.setattr(session_offsets, "_common_times", lambda *_: (cameras, "a board"))
    asked: list[Any] = []
    monkeypatch.setattr(session_offsets, "repair_drops_of", lambda *repair: asked.append(repair))
    result = measure_times(lit.folder, repair_drops=True)
    assert [steps for _, steps in asked] == [{"b": [(20, 1), (40, -2)]}]
    assert (result.reference, result.calibration, result.repaired, result.applied) == (
        "a",
        "a board",
        True,
        False,
    )
    assert result.cameras["b"].change == change
    assert result.seconds > 0
    drift = cameras | {"b": camera(7, MOTION, change=Change(drift=0.1))}
    monkeypatch.setattr(session_offsets, "_common_times", lambda *_: (drift, "a board"))
    with pytest.raises(NotApplicableError, match="no dropped or repeated frame"):
        measure_times(lit.folder, repair_drops=True)
    assert len(asked) == 1


def test_recordings_are_aligned_by_motion_and_written_where_that_is_asked(
    lit: Session, monkeypatch: pytest.MonkeyPatch, steps: list[str]
) -> None:
    manifest = lit.stored_manifest
    times = CommonTimes(state="unknown", reason="each video counts from its own beginning")
    burst = msgspec.structs.replace(manifest.burst, common_times=times)
    session = Session(lit.folder, msgspec.structs.replace(manifest, burst=burst))
    monkeypatch.setattr(Dataset, "open", lambda *_: Dataset(session))
    aligned = {
        "a": CameraTimes(offset_ns=0, uncertainty_ns=0, source=REFERENCE),
        "b": CameraTimes(
            offset_ns=4_000_000,
            uncertainty_ns=600_000,
            rate_ppm=20.0,
            rate_uncertainty_ppm=9.0,
            epoch_local_ns=2_500_000_000,
            source=MOTION,
        ),
    }
    written: list[Any] = []
    monkeypatch.setattr(Scene, "calibration", None)
    monkeypatch.setattr(Scene, "source", "a board")
    monkeypatch.setattr(session_offsets, "align_cameras", lambda *_: aligned)
    monkeypatch.setattr(session_offsets, "realign_session", lambda *of: written.append(of))
    result = measure_times(lit.folder)
    assert (result.applied, written, result.calibration, result.reference) == (False, [], "a board", "a")
    assert steps == ["calibration", "offsets (1 planned step not needed)"]
    b = result.cameras["b"]
    assert (b.offset_ms, b.sd_ms, b.rate_ppm, b.rate_sd_ppm, b.at_ms) == (4, 0.3, 20, 4.5, 2500)
    assert (b.source, result.cameras["a"].rate_sd_ppm) == (MOTION, None)
    assert measure_times(lit.folder, "a", apply=True).applied
    assert written == [(session, aligned, MOTION)]
    aligned["b"] = CameraTimes(reason="nothing moves")
    unknown = measure_times(lit.folder).cameras["b"]
    assert (unknown.offset_ms, unknown.reason) == (None, "nothing moves")


def test_a_session_of_one_camera_has_no_offset_to_measure(tmp_path: Path) -> None:
    wall = [(texture(1)[:ROWS, :COLUMNS] / 255.0) ** 2.2]
    alone = {"a": BlinkCamera(wall, SLOW_ROWS_NS, 3_000_000)}
    session = write_blinks(tmp_path, "alone", alone, Lamp(blink_times(np.random.default_rng(3), 1)), seed=5)
    with pytest.raises(NotApplicableError, match="a time offset is measured between two"):
        measure_times(session.folder)


def pair_of(late_ms: float, rate_ppm: float = 0.0, instants: int = 30) -> OffsetFit:
    """A second camera that is late, and ever more, with the same error at all instants."""
    late = [late_ms + rate_ppm * 1e-3 * k / 10 for k in range(instants)]
    return OffsetFit(late_ms, 0.2, instants=tuple(InstantOffset(k, ms, 0.3, 20) for k, ms in enumerate(late)))


def test_recordings_are_chained_from_the_first_over_cameras_that_see_the_same(
    lit: Session, monkeypatch: pytest.MonkeyPatch, steps: list[str]
) -> None:
    scene = Scene(Dataset(lit))
    fits = {("a", "b"): pair_of(-40.0), ("b", "c"): pair_of(30.0)}
    monkeypatch.setattr(motion_alignment, "likely_pairs", lambda _: [("a", "b"), ("b", "c"), ("a", "d")])
    monkeypatch.setattr(scene.dataset, "cameras", ("a", "b", "c", "d", "e"))
    monkeypatch.setattr(motion_alignment, "ImageTimes", lambda dataset, _: FrameTimes())

    def measured(first: str, second: str) -> OffsetFit:
        return fits.get((first, second), OffsetFit(reason="nothing moves"))

    pairs = SimpleNamespace(measure_anywhere=measured)
    monkeypatch.setattr(motion_alignment, "PairOffsets", lambda _: pairs)
    times = align_cameras(scene, Progress(9))
    assert steps == ["b against a", "d against a", "c against b"]
    start_ns = scene.dataset.instants_ns[0]
    for name, late_ms in (("b", -40.0), ("c", -10.0)):
        at_ns = start_ns + 500_000_000
        assert times[name].leader_from_local(at_ns) - at_ns == pytest.approx(late_ms * 1e6, abs=1e3)
        assert times[name].source == MOTION
        assert times[name].uncertainty_ns is not None
        # Both the instants' errors and what all share.
        assert 500_000 < times[name].uncertainty_ns < 2_000_000
    assert times["a"].source == REFERENCE
    assert times["d"].reason == "nothing moves"
    assert times["e"].reason == "its view overlaps with no camera whose offset is known"


class FrameTimes:
    """Images every 100 ms, whose middle rows are 5 ms later."""

    def middle_ms(self, camera: str, instant: int) -> float:
        return 100.0 * instant + 5


def test_a_recording_whose_clock_is_fast_is_corrected_by_its_rate(
    lit: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read at the middle rows' times, on the camera's own clock."""
    dataset = Dataset(lit)
    monkeypatch.setattr(motion_alignment, "ImageTimes", lambda dataset, cameras: FrameTimes())
    line = motion_alignment._line(dataset, "a", "b", pair_of(12.0, rate_ppm=10_000.0, instants=400))
    start_ns = dataset.instants_ns[0]
    for k in (0, 390):
        leader_ns = start_ns + round((100 * k + 5) * 1e6)
        own_ns = leader_ns - round((12.0 + k) * 1e6)
        assert line.leader_from_local(own_ns) == pytest.approx(leader_ns, abs=3e6)
