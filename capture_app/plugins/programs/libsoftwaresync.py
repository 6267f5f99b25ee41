"""libsoftwaresync: the shots of a phone, by the leader's clock.

For each shot it writes a folder with sync_metadata_TIME.txt (leader_sensor_timestamp_ns and
local_sensor_timestamp_ns), and img_TIME.jpg or img_TIME.nv21 with nv21_metadata_TIME.txt.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_text
from capture_app.session.importing.frame_matching import TimedFrame
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Images, upright
from capture_app.session.reading.decoding import encode_image

_METADATA = "sync_metadata_"
_LEADER, _LOCAL = "leader_sensor_timestamp_ns", "local_sensor_timestamp_ns"

_Shot = tuple[Path, int, int | None]
"""An image, and its capture time by the leader's clock and by the phone's, ns."""


def is_camera(path: Path) -> bool:
    """Return whether a path is a folder with one phone's shots."""
    return path.is_dir() and next(_metadata_in(path), None) is not None


def open_camera(name: str, path: Path, *, png: bool, recording: str | None) -> Images:
    """Open one phone's shots; JPEG bytes stay unchanged. Raises BadInputError if there are none."""
    shots = [shot for file in _metadata_in(path) if (shot := _shot(file)) is not None]
    if not shots:
        raise BadInputError(
            f"no image in {path} belongs to its sync_metadata files",
            hint="copy img_* from the phone into the folder of its sync_metadata_*",
        )
    shots.sort(key=lambda shot: shot[1])
    source = Images(
        name,
        path,
        [image for image, _, _ in shots],
        "libsoftwaresync",
        read=lambda file: upright(file.read_bytes(), ".jpg") if file.suffix == ".jpg" else _from_nv21(file),
        times=[TimedFrame(n, leader_ns, local_ns) for n, (_, leader_ns, local_ns) in enumerate(shots)],
    )
    source.suffix = ".jpg"
    return source


def _metadata_in(folder: Path) -> Iterator[Path]:
    """Yield the metadata of all shots, in the folder or in one folder for each shot."""
    yield from sorted(folder.glob(f"{_METADATA}*.txt"))
    yield from sorted(folder.glob(f"*/{_METADATA}*.txt"))


def _shot(metadata: Path) -> _Shot | None:
    times = _values(metadata)
    if _LEADER not in times:
        raise BadInputError(f"{metadata} has no {_LEADER}", hint="copy it from the phone again, or remove it")
    time = metadata.stem.removeprefix(_METADATA)
    images = (metadata.with_name(f"img_{time}{suffix}") for suffix in (".jpg", ".nv21"))
    image = next(filter(Path.is_file, images), None)
    return (image, times[_LEADER], times.get(_LOCAL)) if image else None


def _values(path: Path) -> dict[str, int]:
    """Return the numbers of `name: number` lines."""
    lines = re.findall(r"^(\w+):\s*(-?\d+)\s*$", read_text(path), re.MULTILINE)
    return {key: int(value) for key, value in lines}


def _from_nv21(file: Path) -> bytes:
    """Convert raw NV21 (a luma plane, then interleaved V and U at half the size) to JPEG."""
    import cv2
    import numpy as np

    size = _values(file.with_name(f"nv21_metadata_{file.stem.removeprefix('img_')}.txt"))
    width, height = size.get("width", 0), size.get("height", 0)
    raw = np.frombuffer(file.read_bytes(), np.uint8)
    if width <= 0 or height <= 0 or width % 2 or height % 2 or raw.size != width * height * 3 // 2:
        raise BadInputError(
            f"{file} is not {width}x{height} pixels of NV21, as its metadata says",
            hint="copy it from the phone again, or remove it",
        )
    return encode_image(cv2.cvtColor(raw.reshape(height * 3 // 2, width), cv2.COLOR_YUV2BGR_NV21))


IMPORTER = Importer(
    program="libsoftwaresync",
    help="a folder a phone: sync_metadata_*.txt with img_*.jpg or .nv21",
    is_camera=is_camera,
    open_camera=open_camera,
    priority=-1,
)
