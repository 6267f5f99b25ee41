"""What a session's record says of its timing, where nobody knows how late a camera's stamps are."""

from pathlib import Path

import cv2
import numpy as np

from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, finish_session
from tests.unit.session.conftest import edit_manifest


def test_pictures_are_no_nearer_to_their_instants_than_their_stamps_are_known(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "small")
    data = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()
    for camera, residual_ns in (("left", 4_000), ("right", -9_000)):
        writer.add_image(
            data,
            camera=camera,
            instant=0,
            suffix=".png",
            uncertainty_ns=20_000,
            hard_bound_ns=250_000,
            leader_ns=residual_ns,
            residual_ns=residual_ns,
        )
    session = finish_session(writer, ("left", "right"), 1)
    known = Dataset.open(session.folder)
    assert (known.worst_residual_us(), known.worst_hard_bound_us()) == (9, 250)
    stamp = {"bias_ns": 21_000_000, "uncertainty_ns": 21_000_000, "source": "assumed"}
    edit_manifest(session, lambda manifest: manifest["cameras"][0]["facts"].update(stamp=stamp))
    edit_manifest(session, lambda manifest: manifest["images"][0].update(hard_bound_ns=None))
    unsure = Dataset.open(session.folder)
    assert (unsure.worst_residual_us(), unsure.worst_hard_bound_us()) == (21_004, None)
    # Of images that are all of other instants, nothing is known.
    edit_manifest(session, lambda manifest: [image.update(substitute=True) for image in manifest["images"]])
    none = Dataset.open(session.folder)
    assert (none.worst_residual_us(), none.worst_hard_bound_us()) == (None, None)


def test_an_imported_session_says_its_error_and_how_it_was_measured(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "small")
    data = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()
    for camera, error_ns in (("left", 0), ("right", 22_950_000)):
        writer.add_image(data, camera=camera, instant=0, suffix=".png", uncertainty_ns=error_ns, leader_ns=0)
    session = finish_session(writer, ("left", "right"), 1)
    assert Dataset.open(session.folder).imported_error is None
    sound = {"offset_ns": 5, "uncertainty_ns": 22_950_000, "source": "sound"}
    times = {
        "state": "aligned",
        "reference": "left",
        "cameras": {"left": {"source": "reference"}, "right": sound},
    }
    edit_manifest(session, lambda manifest: manifest.update(origin="imported"))
    edit_manifest(session, lambda manifest: manifest["burst"].update(common_times=times))
    assert Dataset.open(session.folder).imported_error == (22_950.0, "by sound")
    edit_manifest(session, lambda manifest: manifest["burst"].update(common_times={"state": "unknown"}))
    assert Dataset.open(session.folder).imported_error is None
