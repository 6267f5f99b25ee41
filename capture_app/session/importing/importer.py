"""An importer is an `Importer` that an entry point of the group `simulshot.importers` names, ours included.

It states what it recognizes of one program: recordings, single cameras, calibrations. Here each path finds
its importer; folders and files that none recognizes are plain images and videos.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name, is_name, natural_order
from capture_app.common.plugins import load_plugins
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importing.sources import Layout, Source, Video, image_folder, images_in, videos_in
from capture_app.session.importing.views import Views

GROUP = "simulshot.importers"


def _cannot_open(name: str, path: Path, *, png: bool, recording: str | None) -> Source:
    raise BadInputError(f"{path} is not a camera of a known program")


@dataclass(frozen=True, slots=True, kw_only=True)
class Importer:
    """A program whose recordings or calibrations are read. What it does not have is left out."""

    program: str
    help: str
    """What of it is recognized: the line in `capture-app sessions import --help`."""
    open_recording: Callable[..., Layout | None] = lambda path, *, png, recording: None
    """`open_recording(path, png=, recording=)`: the recording at a path; None where it is not the program's.

    `png`: keep frames of videos as PNG. `recording`: which of several. Raises BadInputError where it has
    several and none is named.
    """
    recordings_in: Callable[[Path], Sequence[str]] = lambda folder: ()
    """The names of the recordings in a folder of several."""
    is_camera: Callable[[Path], bool] = lambda path: False
    """Whether a path is one camera's, with times of the program's own."""
    open_camera: Callable[..., Source] = _cannot_open
    """`open_camera(name, path, png=, recording=)`: the camera at a path that `is_camera` accepts."""
    read_calibration: Callable[[Sequence[tuple[str, Path]], Sequence[str]], Views | None] = (
        lambda paths, cameras: None
    )
    """`read_calibration(paths, cameras)`: the views in files or folders, or None where they are not its own.

    Each path comes with the camera that it is of, or ''; the first one tells whose it is.
    """
    calibration_files: Sequence[str] = ()
    """Patterns of the names of calibrations that are taken where they lie beside a recording."""
    calibration_per_camera: bool = False
    """Whether a calibration is of one camera or a pair, not of all cameras."""
    priority: int = 0
    """Importers are asked from the highest down; below 0 are those whose files others write, too."""


@cache
def load_importers() -> tuple[Importer, ...]:
    """Import all importers, in the order in which they are asked; a broken one is reported and skipped."""
    loaded = load_plugins(GROUP, *(one.name for one in fields(Importer)))
    return tuple(sorted(loaded.values(), key=lambda one: -one.priority))


def recognize_recording(path: Path, *, png: bool = False, recording: str | None = None) -> Layout | None:
    """The recording of another program at a path, or None; see `Importer.open_recording`."""
    if not path.exists():
        return None
    for importer in load_importers():
        layout = importer.open_recording(path, png=png, recording=recording)
        if layout is not None:
            return replace(layout, program=layout.program or importer.program)
    return None


def recordings_in(folder: Path) -> list[str]:
    """The names of the recordings in a program's folder of several; else none."""
    return sorted({name for importer in load_importers() for name in importer.recordings_in(folder)})


def is_program_camera(path: Path) -> bool:
    """Whether a path is one camera of a program that writes times beside it."""
    return any(importer.is_camera(path) for importer in load_importers())


def open_sources(paths: Sequence[str], *, png: bool = False, recording: str | None = None) -> list[Source]:
    """The cameras of `NAME=PATH` arguments, or of one folder whose subfolders or videos are cameras.

    `recording` tells which of several recordings of each camera.
    Raises BadInputError for what is missing, empty, doubled or badly named.
    """
    sources: list[Source] = []
    for text in paths:
        name, path = split_name(text)
        if not path.exists():
            raise BadInputError(f"nothing at {path}")
        if not name and path.is_dir() and not is_program_camera(path):
            sources += _sources_in(path, png, recording)
        else:
            own = path.resolve().name if path.is_dir() else path.stem
            sources.append(_source(name or own, path, png, recording))
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise BadInputError(f"two cameras are named {name}", hint="name them: NAME=PATH")
    if not sources:
        raise BadInputError("nothing to import", hint="give a folder, or NAME=PATH for each camera")
    return sorted(sources, key=lambda source: natural_order(source.name))


def split_name(text: str) -> tuple[str, Path]:
    """Split `NAME=PATH`; the name is empty where there is none."""
    name, separator, path = text.partition("=")
    if separator and is_name(name) and not Path(text).exists():
        return name, Path(path)
    return "", Path(text)


def _source(name: str, path: Path, png: bool, recording: str | None) -> Source:
    check_name(name, "camera")
    for importer in load_importers():
        if importer.is_camera(path):
            return importer.open_camera(name, path, png=png, recording=recording)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return image_folder(name, path)
    return Video(name, path, png=png)


def _sources_in(folder: Path, png: bool, recording: str | None) -> list[Source]:
    videos = videos_in(folder)
    folders = [
        path for path in folder.iterdir() if path.is_dir() and (images_in(path) or is_program_camera(path))
    ]
    if not videos and not folders:
        hint = "it needs a subfolder of images or a video file for each camera"
        if images_in(folder):
            hint = f"its images are of one camera: cam0={folder}"
        raise BadInputError(f"no cameras in {folder}", hint=hint)
    if videos and folders:
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    named = [(path.stem, path) for path in videos] + [(path.name, path) for path in folders]
    return [_source(name, path, png, recording) for name, path in named]
