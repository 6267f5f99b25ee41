"""Image index: the images of each camera, and the time of every image in index.json."""

import json
from pathlib import Path

from capture_app import ExportedBurst, Exporter


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write CAMERA/INSTANT.jpg and index.json, with times in ns of the leader's clock."""
    index = []
    for camera in burst.cameras:
        for image in burst.images_of(camera):
            file = f"{camera}/{image.instant:06d}.jpg"
            # Refuses an image that is not the one that was saved; frames.csv lists it for an import.
            burst.write_image(image, folder, file)
            index.append({"file": file, "leader_ns": image.leader_ns})
    (folder / "index.json").write_text(json.dumps(index))


EXPORTER = Exporter(write=write, help="images and index.json with their times", program="Image index")
