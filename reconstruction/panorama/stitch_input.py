"""The pictures that `reconstruct stitch` is given: of a session's instant, of a folder, or single files."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import read_image
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import nearest_frame_offset
from reconstruction.session.mover_detection import SceneMotion

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}


@dataclass(frozen=True)
class StitchInput:
    """Pictures (BGR) by name; the same with every second camera late, by how much; and movers (bool)."""

    images: dict[str, Array]
    late_images: dict[str, Array] = field(default_factory=dict)
    """Empty where no offset is asked for."""
    offset_ms: float = 0.0
    movers: dict[str, Array] | None = None


def load_input(sources: Sequence[Path], instant: int, offset_ms: float | None) -> StitchInput:
    """Read the pictures; a session is a single source.

    Raises:
        BadInputError: there are none, they cannot be read, or not at this instant and offset.
    """
    if len(sources) == 1 and (sources[0] / MANIFEST).exists():
        return _session_input(sources[0], instant, offset_ms)
    if offset_ms is not None:
        raise BadInputError("--offset-ms needs a session: single pictures have no instants")
    paths: list[Path] = []
    for source in sources:
        if source.is_dir():
            paths += sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
        else:
            paths.append(source)
    if not paths:
        raise BadInputError(f"{sources[0]} is not a session and holds no pictures")
    images: dict[str, Array] = {}
    for path in paths:
        images[path.name if path.name not in images else str(path)] = read_image(path)
    return StitchInput(images)


def _session_input(folder: Path, instant: int, offset_ms: float | None) -> StitchInput:
    dataset = Dataset.open(folder)
    cameras = [name for name in dataset.nearest_instants(instant, ()) if dataset.has_image(name, instant)]
    images = {name: dataset.image(name, instant) for name in cameras}
    if len(dataset.instants_ns) < 2:
        return StitchInput(images)
    motion = SceneMotion(dataset, 1)
    movers = {name: motion.widened_movers(name, instant) for name in cameras}
    if offset_ms is None:
        return StitchInput(images, movers=movers)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, offset_ms)
    late_instant = dict(offset.pairs).get(instant)
    late = cameras[1::2]
    if late_instant is None or not dataset.has_images((name, late_instant) for name in late):
        raise BadInputError(
            f"{folder} has no pictures {offset.actual_ms:.0f} ms after instant {instant}",
            hint="choose an earlier --instant",
        )
    late_images = images | {name: dataset.image(name, late_instant) for name in late}
    return StitchInput(images, late_images, offset.actual_ms, movers)
