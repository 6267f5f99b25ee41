"""A camera that moves while it records is noticed by what should stand still."""

from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import measure_camera_motion


def test_cameras_on_tripods_stand_still_however_much_moves_before_them(boards: Session) -> None:
    data = Dataset.open(boards.folder)
    for camera in data.cameras:
        found = measure_camera_motion(data, camera)
        assert found is not None
        still_fraction, *_ = found
        assert still_fraction > 0.6
