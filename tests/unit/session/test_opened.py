"""A session as Python code reads it: pictures when they are asked for, and what is missing says so."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app import SimulshotError, open_session
from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.session.format.manifest import EVENTS, BurstRecord
from capture_app.session.format.marks import Mark
from capture_app.session.reading.array_access import CameraMatrices
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.project import JUMPER
from tests.unit.session.recorded import record

from .conftest import HEIGHT, INSTANTS, WIDTH, calibration_of, camera_record, edit_manifest, jpeg

SAMPLE = JUMPER


def test_frames_are_found_by_camera_and_by_instant(session: Session) -> None:
    opened = open_session(session.folder)
    frame = opened.cameras["left"].frames[1]
    assert frame is opened.instants[1].frames["left"]
    assert (frame.leader_ns, frame.uncertainty_ns, frame.hard_bound_ns) == (
        INSTANTS[1] + 4_000,
        20_000,
        250_000,
    )
    assert (frame.exposure_ns, frame.is_substitute, frame.missing, frame.true_ns) == (
        100_000,
        False,
        "",
        None,
    )
    assert [instant.leader_ns for instant in opened.instants] == list(INSTANTS)
    assert opened.cameras["left"].frames[0].true_ns == 77


def test_pictures_are_in_the_order_that_is_asked_for(session: Session) -> None:
    expected = cv2.imdecode(np.frombuffer(jpeg(1), np.uint8), cv2.IMREAD_COLOR)
    instant = open_session(str(session.folder)).instants[1]
    np.testing.assert_array_equal(instant.frames["left"].bgr(), expected)
    np.testing.assert_array_equal(instant.frames["left"].rgb(), expected[..., ::-1])
    assert instant.bgr().shape == (2, HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(instant.rgb()[1], expected[..., ::-1])


def test_nothing_is_read_before_it_is_asked_for(session: Session) -> None:
    for image in session.manifest.images[1:]:
        session.image_file(image).unlink()
    opened = open_session(session.folder)
    first, *rest = opened.cameras["left"].frames[:3]
    assert first.bgr().shape == (HEIGHT, WIDTH, 3)
    assert [frame.instant for frame in rest] == [1, 2]
    assert opened.times().shape == (2, 3)
    with pytest.raises(BadInputError, match="cannot read images/rig1/left"):
        rest[0].bgr()


def test_what_is_no_picture_is_an_error_of_ours(session: Session) -> None:
    session.image_file(session.manifest.images[0]).write_bytes(b"no picture")
    with pytest.raises(SimulshotError, match="is not a picture"):
        open_session(session.folder).instants[0].bgr()


def test_a_missing_frame_says_why(session: Session) -> None:
    opened = open_session(session.folder)
    gone = opened.instants[2].frames["right"]
    assert gone.missing == "the node left"
    for ask in (gone.rgb, lambda: gone.leader_ns, opened.instants[2].rgb, gone.truth):
        with pytest.raises(IncompleteError, match="right has no frame of instant 2: the node left"):
            ask()


def test_a_substitute_is_called_one(session: Session) -> None:
    edit_manifest(session, lambda manifest: manifest["images"][0].update(substitute=True))
    frames = [frame for instant in open_session(session.folder).instants for frame in instant.frames.values()]
    assert [
        (frame.camera, frame.instant) for frame in frames if not frame.missing and frame.is_substitute
    ] == [("left", 0)]


def test_times_are_arrays_that_hide_what_nobody_knows(session: Session) -> None:
    opened = open_session(session.folder)
    times = opened.times()
    assert times.dtype == np.int64
    assert times.mask.tolist() == [[False, False, False], [False, False, True]]
    assert (times - np.array(INSTANTS)).max() == 4_000
    assert opened.times("residual_ns")[1].compressed().tolist() == [-9_000, -9_000]
    assert opened.times("exposure_start_ns").mask.all()
    assert opened.times("true_ns").compressed().tolist() == [77]
    with pytest.raises(BadInputError, match="frames have no time 'foo'"):
        opened.times("foo")  # type: ignore[arg-type]


def test_a_recording_is_read_alike(tmp_path: Path) -> None:
    recording = record(SessionWriter.create(tmp_path, "recording"))
    opened = open_session(recording.folder)
    expected = cv2.imdecode(np.frombuffer(jpeg(1, 32, 24), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(opened.cameras["left"].frames[1].bgr(), expected)
    assert opened.cameras["right"].frames[2].missing


def test_matrices_are_those_of_the_pictures(session: Session) -> None:
    opened = open_session(session.folder)
    assert not opened.cameras["left"].is_calibrated
    (session.folder / "calibration.json").write_bytes(_json(calibration_of("left")))
    calibrated = open_session(session.folder).cameras
    found = calibrated["left"].calibration
    assert found.camera_matrix.tolist() == [[21, 0, 3], [0, 22, 4], [0, 0, 1]]
    assert (found.cam_from_rig @ [0, 0, 0, 1]).tolist() == [0.1, 0.2, 0.3, 1]
    assert (found.distortion.shape, found.unit) == ((5,), "m")
    assert not calibrated["right"].is_calibrated


def test_pictures_of_several_sizes_are_not_stacked(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "sizes")
    for camera, width in (("left", 16), ("right", 32)):
        writer.add_image(jpeg(0, width), camera=camera, instant=0, leader_ns=1_000, local_ns=1_000)
    records = [camera_record("left"), camera_record("right", width=32)]
    made = writer.finish(records, BurstRecord(instants_ns=(1_000,), period_ns=1), [], origin="imported")
    instant = open_session(made.folder).instants[0]
    assert instant.frames["right"].rgb().shape == (HEIGHT, 32, 3)
    with pytest.raises(BadInputError, match="several sizes"):
        instant.rgb()


def _json(value: object) -> bytes:
    import msgspec

    return msgspec.json.encode(value)


def test_points_are_projected_and_triangulated_back() -> None:
    cameras = open_session(SAMPLE).cameras
    points = np.array([[0.1, 0.2, 2.0], [-0.3, 0.1, 3.0]])
    pixels = {name: camera.calibration.project(points) for name, camera in cameras.items()}
    np.testing.assert_allclose(open_session(SAMPLE).triangulate(pixels), points, atol=1e-6)
    assert np.isnan(cameras["cam01"].calibration.project([0, 0, -1])).all()
    with pytest.raises(BadInputError, match="cam01"):
        open_session(SAMPLE).triangulate({"cam01": pixels["cam01"]})


def test_a_frame_that_is_not_there_is_named() -> None:
    session = open_session(SAMPLE)
    with pytest.raises(BadInputError, match="no instant 99"):
        session.frame("cam01", 99)
    with pytest.raises(BadInputError, match="no camera 'cam99'"):
        session.frame("cam99", 0)
    assert "5 cameras, 5 instants" in repr(session)
    assert "cam01, instant 2" in repr(session.frame("cam01", 2))


def test_pixels_at_the_border_of_a_wide_lens_are_undistorted() -> None:
    matrix = np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]])
    lens = CameraMatrices(matrix, np.array([-0.3, 0.1, 0, 0, -0.01]), np.eye(4), "m")
    rays = np.array([[1.0, 0.75]])
    pixels = lens.project(np.column_stack([rays, [1.0]]))
    np.testing.assert_allclose(lens.undistort_points(pixels), rays, atol=1e-6)
    image = np.zeros((480, 640, 3), np.uint8)
    image[90:94, 120:124] = 255
    spot = np.argwhere(lens.undistort(image)[..., 0] > 128).mean(0)[::-1]
    ((x, y),) = lens.undistort_points([[121.5, 91.5]])
    np.testing.assert_allclose(spot, (300 * x + 320, 300 * y + 240), atol=1.0)


def test_marks_are_in_the_order_of_their_times(session: Session) -> None:
    assert open_session(session.folder).marks == ()
    early, late = (
        Mark(text=text, leader_ns=ns, uncertainty_ns=5) for text, ns in (("flash", 1), ("clap", 2))
    )
    events = ({"event": "joined", "leader_ns": 0}, late.as_event(), early.as_event())
    (session.folder / EVENTS).write_text("".join(f"{json.dumps(event)}\n" for event in events) + "{torn")
    assert open_session(session.folder).marks == (early, late)


def test_a_camera_or_instant_that_is_not_there_is_answered_with_those_that_are(session: Session) -> None:
    opened = open_session(session.folder)
    names = ", ".join(opened.cameras)
    with pytest.raises(BadInputError, match=f"no camera 'cam9'.*{names}"):
        opened.cameras["cam9"]
    with pytest.raises(BadInputError, match=f"no camera 'cam9'.*{names}"):
        opened.instants[0].frames["cam9"]
    with pytest.raises(
        IndexError, match=f"no instant 9999: the instants are 0 to {len(opened.instants) - 1}"
    ):
        opened.instants[9999]
    assert opened.instants[:1] == (opened.instants[0],)
    assert opened.instants[-1] is opened.instants[len(opened.instants) - 1]
