"""What people call cameras."""

from capture_app.common.names import titles_of


def test_cameras_of_one_label_are_told_apart_by_their_names() -> None:
    labels = {"cam-1": "左", "cam-2": "左", "right": "Rechts"}
    assert titles_of(labels) == {"cam-1": "左 (cam-1)", "cam-2": "左 (cam-2)", "right": "Rechts"}
