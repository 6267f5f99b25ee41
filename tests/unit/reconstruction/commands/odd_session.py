"""A small sound session, and a copy of it that can be broken in any way: calibration, pictures, manifest."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from tests.unit.reconstruction.conftest import Board, Scene, jump, make_view, texture, write_session

INSTANTS = 3
VIEWS = {
    "left": make_view((-0.15, 0.0, 0.0), yaw=2),
    "middle": make_view((0.0, 0.02, 0.0)),
    "right": make_view((0.15, 0.01, 0.0), yaw=-2),
}


def sound_session(root: Path) -> Path:
    """A wall, three boards and one that moves, seen by three calibrated cameras at three instants."""
    boards = [
        Board((-9, -9, 9, 9), 4.0, texture(1)),
        Board((-1.6, 0.2, -0.9, 1.4), 3.0, texture(2)),
        Board((0.9, -0.2, 1.5, 1.3), 2.6, texture(3)),
        Board((-0.7, -1.2, 0.2, -0.75), 3.4, texture(4)),
        Board((-0.3, -0.3, 0.3, 0.3), 2.2, texture(5), jump),
    ]
    return write_session(root, Scene(boards), VIEWS, instants=INSTANTS, truth=False).folder


class OddSession:
    """A copy of a session: `manifest` and `calibration` are plain data that `save` writes."""

    def __init__(self, sound: Path, folder: Path) -> None:
        shutil.copytree(sound, folder)
        self.folder = folder
        self.manifest: Any = json.loads((folder / "session.json").read_text())
        self.calibration: Any = json.loads((folder / "calibration.json").read_text())

    def save(self) -> None:
        """Write both files; numbers may be NaN or Infinity, which no JSON has."""
        (self.folder / "session.json").write_text(json.dumps(self.manifest))
        if self.calibration is None:
            (self.folder / "calibration.json").unlink(missing_ok=True)
        elif isinstance(self.calibration, bytes):
            (self.folder / "calibration.json").write_bytes(self.calibration)
        else:
            (self.folder / "calibration.json").write_text(json.dumps(self.calibration))

    def camera(self, name: str) -> dict[str, Any]:
        """A camera's calibration."""
        found: dict[str, Any] = self.calibration["cameras"][name]
        return found

    def facts(self, name: str) -> dict[str, Any]:
        """A camera's facts in the manifest."""
        return next(camera["facts"] for camera in self.manifest["cameras"] if camera["name"] == name)

    def records(self, camera: str | None = None) -> Iterator[dict[str, Any]]:
        """The records of all images, or of one camera's."""
        for record in self.manifest["images"]:
            if camera in (None, record["camera"]):
                yield record

    def picture(self, record: dict[str, Any]) -> Array:
        """An image's pixels, grey."""
        image = cv2.imread(str(self.folder / record["path"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        return image

    def put_bytes(self, record: dict[str, Any], data: bytes) -> None:
        """Put a file in an image's place; the manifest knows it."""
        (self.folder / record["path"]).write_bytes(data)
        record["bytes"], record["sha256"] = len(data), hashlib.sha256(data).hexdigest()

    def put(self, record: dict[str, Any], image: Array) -> None:
        """Put a picture in an image's place."""
        self.put_bytes(record, cv2.imencode(".png", image)[1].tobytes())

    def change(self, how: Callable[[Array], Array], camera: str | None = None) -> None:
        """Change all pictures, or one camera's, and its facts' size with them."""
        for record in self.records(camera):
            image = np.ascontiguousarray(how(self.picture(record)))
            self.put(record, image)
            facts = self.facts(record["camera"])
            facts["height"], facts["width"] = image.shape[:2]

    def drop(self, lacks: Callable[[str, int], bool]) -> None:
        """Leave out the images of these cameras and instants."""
        kept = []
        for record in self.manifest["images"]:
            if lacks(record["camera"], record["instant"]):
                (self.folder / record["path"]).unlink()
            else:
                kept.append(record)
        self.manifest["images"] = kept
