"""Importer interface: each entry point of the group `simulshot.importers` names an `Importer`.

Built-in ones are entry points, too. An importer declares what it recognizes of one program: recordings,
single cameras, calibrations. This module finds the importer of each path; folders and files that none
recognizes are plain images and videos.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import folder_names, is_name, label_of, natural_order
from capture_app.common.plugins import load_plugins
from capture_app.common.text import command_line, count
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importing.recording_sources import (
    ARCHIVE_SUFFIXES,
    CAMERA,
    Layout,
    Source,
    Video,
    folders_below,
    image_folder,
    images_in,
    videos_in,
)
from capture_app.session.importing.views import Views

GROUP = "simulshot.importers"
_DATE = re.compile(r"(19|20)\d{6}")
_Camera = tuple[str, Path, list[Path]]
"""Label and path of a camera, and its image files if the folder has those of other cameras."""


def _cannot_open(name: str, path: Path, *, png: bool, recording: str | None) -> Source:
    raise BadInputError(
        f"{path} is not a camera of a known program",
        hint="capture-app sessions import --help lists them",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Importer:
    """A program whose recordings or calibrations can be read. Features that it lacks keep their defaults."""

    program: str
    help: str
    """What it recognizes, for its line in `capture-app sessions import --help`."""
    open_recording: Callable[..., Layout | None] = lambda path, *, png, recording: None
    """`open_recording(path, png=, recording=)`: open a recording; None if it is not the program's.

    `png`: store frames of videos as PNG. `recording`: one of `recordings_in`, or None if there are none.
    """
    recordings_in: Callable[[Path], Sequence[str]] = lambda folder: ()
    """Return the names of the recordings in a folder that may have several."""
    is_camera: Callable[[Path], bool] = lambda path: False
    """Return whether a path is one camera with times in the program's own format."""
    open_camera: Callable[..., Source] = _cannot_open
    """`open_camera(name, path, png=, recording=)`: open the camera at a path that `is_camera` accepts."""
    read_calibration: Callable[[Sequence[tuple[str, Path]], Sequence[str]], Views | None] = (
        lambda paths, cameras: None
    )
    """`read_calibration(paths, cameras)`: return the views in files or folders, or None for foreign formats.

    Each path has the name of its camera, or ''; the first path decides whether the format matches.
    """
    calibration_files: Sequence[str] = ()
    """Name patterns of calibrations that are used if they are beside a recording."""
    calibration_per_camera: bool = False
    """Whether a calibration file covers one camera or a pair instead of all cameras."""
    priority: int = 0
    """Importers are tried from highest to lowest; below 0 are formats that other programs write, too."""


@cache
def load_importers() -> tuple[Importer, ...]:
    """Import all importers in order of priority; one that fails is reported and skipped."""
    loaded = load_plugins(GROUP, *(field.name for field in fields(Importer)))
    return tuple(sorted(loaded.values(), key=lambda one: -one.priority))


def recognize_recording(path: Path, *, png: bool = False, recording: str | None = None) -> Layout | None:
    """Return another program's recording at a path, or None; see `Importer.open_recording`."""
    if not path.exists():
        return None
    for importer in load_importers():
        if (layout := importer.open_recording(path, png=png, recording=recording)) is not None:
            return replace(layout, program=layout.program or importer.program)
    return None


def recordings_in(folder: Path) -> list[str]:
    """Return the names of the recordings in a program's folder with several; otherwise none."""
    return sorted({name for importer in load_importers() for name in importer.recordings_in(folder)})


def camera_importer(path: Path) -> Importer | None:
    """Return the importer of a path that is one camera of a program which stores times beside it, or None."""
    return next((importer for importer in load_importers() if importer.is_camera(path)), None)


def open_sources(paths: Sequence[str], *, png: bool = False, recording: str | None = None) -> list[Source]:
    """Open the cameras of `NAME=PATH` arguments, or of one folder with a subfolder or video for each camera.

    `recording` selects one of several recordings of each camera. Raises BadInputError for missing, empty,
    duplicate or badly named cameras.
    """
    cameras: list[_Camera] = []
    for text in paths:
        name, path = split_name(text)
        if not path.exists():
            raise BadInputError(f"nothing at {path}", hint="check the path")
        if not name and path.is_dir() and not camera_importer(path):
            cameras += _cameras_in(path)
        else:
            own = path.resolve().name if path.is_dir() else path.stem
            cameras.append((name or label_of(own), path, []))
    if not cameras:
        raise BadInputError("nothing to import", hint="give a folder, or NAME=PATH for each camera")
    labels = [label for label, *_ in cameras]
    names = dict(zip(folder_names(labels, "camera", "cam"), cameras, strict=True))
    sources = []
    for name, (label, path, files) in sorted(names.items(), key=lambda one: natural_order(one[0])):
        source = image_folder(name, path, files) if files else _source(name, path, png, recording)
        source.label = label
        sources.append(source)
    return sources


def split_name(text: str) -> tuple[str, Path]:
    """Split `NAME=PATH`; the label NAME is empty if there is none.

    Raises BadInputError for a pipe or a device.
    """
    name, _, rest = text.partition("=")
    named = bool(rest and name.strip()) and not re.search(r"[/\\]", name) and not Path(text).exists()
    path = Path(rest if named else text)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise BadInputError(
            f"{path} is neither a file nor a folder", hint="copy what it delivers into a file"
        )
    return label_of(name) if named else "", path


def _by_label(images: Sequence[Path]) -> dict[str, list[Path]]:
    """Return a folder's images by the camera that their names have beside a number; none if they have one.

    Cameras have a word and several images each, and share most numbers; other names count within a second.
    """
    parted = {path: re.fullmatch(r"(.*?)[_\-. ]?(\d+)[_\-. ]?(\D*)", path.stem) for path in images}
    words = {path: (match[1], match[3], int(match[2])) for path, match in parted.items() if match}
    varying = [k for k in (0, 1) if len({of[k] for of in words.values()}) > 1]
    cameras: dict[str, dict[int, Path]] = {}
    for path, of in words.items():
        cameras.setdefault("-".join(str(of[k]) for k in varying if of[k]), {})[of[2]] = path
    counts = [len(numbered) for numbered in cameras.values()]
    named = all(is_name(name) and re.search("[A-Za-z]", name) for name in cameras)
    dated = any(_DATE.search(name) for name in cameras)
    # Of two numbers, the one of fewer values is the camera's: with as many, they do not tell.
    by_number = len({re.sub(r"\d+", "", name) for name in cameras}) == 1
    swapped = by_number and len(counts) >= min(counts) and not any(map(CAMERA.search, cameras))
    told = sum(counts) == len(images) and len(counts) > 1 < min(counts) and named
    if not told or dated or swapped or 2 * len(set.intersection(*map(set, cameras.values()))) < min(counts):
        return {}
    return {name: list(numbered.values()) for name, numbered in cameras.items()}


def _archive(path: Path) -> BadInputError:
    folder = path.with_suffix("")
    return BadInputError(
        f"{path} is an archive",
        hint=f"unpack it into {folder}, then: capture-app sessions import {command_line(str(folder))}",
    )


def _source(name: str, path: Path, png: bool, recording: str | None) -> Source:
    if (importer := camera_importer(path)) is not None:
        return importer.open_camera(name, path, png=png, recording=recording)
    if path.is_dir() and not images_in(path):
        path = _camera_below(path)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return image_folder(name, path)
    if path.suffix.lower() in ARCHIVE_SUFFIXES:
        raise _archive(path)
    return Video(name, path, png=png)


def _camera_below(folder: Path) -> Path:
    """Return the only folder of images, or the only video, below a camera's folder without images.

    Raises BadInputError if there are several; returns the folder itself if there is none.
    """
    places = [place for place in folders_below(folder) if place != folder and images_in(place)]
    places += [video for place in folders_below(folder) for video in videos_in(place)]
    if len(places) > 1:
        raise BadInputError(
            f"{folder} has several folders of images or videos: "
            f"{', '.join(str(place.relative_to(folder)) for place in places[:3])}",
            hint="name one of them: NAME=PATH",
        )
    return places[0] if places else folder


def _cameras_in(folder: Path) -> list[_Camera]:
    videos = videos_in(folder)
    recorded = {path: path.name for path in folder.iterdir() if path.is_dir() and camera_importer(path)}
    folders = recorded or image_cameras(folder)
    places = () if recorded or videos else folders or [folder]
    flat = {place: cameras for place in places if (cameras := _by_label(images_in(place)))}
    if 1 < len(folders) == len(flat) and len({tuple(sorted(cameras)) for cameras in flat.values()}) == 1:
        raise BadInputError(
            f"{folder} has folders with images of several cameras: {', '.join(map(str, flat))}",
            hint=f"import one at a time: capture-app sessions import {command_line(str(next(iter(flat))))}",
        )
    if flat and len(folders) < 2:
        ((place, cameras),) = flat.items()
        return [(name, place, files) for name, files in cameras.items()]
    if not videos and not folders:
        if images := images_in(folder):
            raise BadInputError(
                f"{folder} has {count(len(images), 'image')}, whose names tell no cameras apart",
                hint="put each camera's into a folder; or as one camera: capture-app sessions import "
                f"cam0={command_line(str(folder))} --fps RATE",
            )
        if archives := sorted(path for path in folder.iterdir() if path.suffix.lower() in ARCHIVE_SUFFIXES):
            raise _archive(archives[0])
        raise BadInputError(
            f"no cameras in {folder}", hint="it needs a subfolder of images or a video file for each camera"
        )
    if videos and folders:
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    named = [(path.stem, path) for path in videos] + [(name, path) for path, name in folders.items()]
    return [(label_of(name), path, []) for name, path in named]


def image_cameras(folder: Path) -> dict[Path, str]:
    """Return the folders of images below a folder, each with its camera's part of the path.

    Raises BadInputError if no part of the paths tells all cameras apart, as in a folder of several takes.
    """
    paths = [path for path in folders_below(folder) if path != folder and images_in(path)]
    parts = [path.relative_to(folder).parts for path in paths]
    columns = [[own[k] for own in parts] for k in range(min(map(len, parts), default=0))]
    telling = next((column for column in columns if len(set(column)) == len(parts)), None)
    if paths and telling is None:
        some = ", ".join("/".join(own) for own in parts[:3])
        raise BadInputError(
            f"{folder} has {count(len(paths), 'folder')} of images, of several takes or kinds: {some} ...",
            hint="import one take at a time, or name the cameras: NAME=PATH",
        )
    return dict(zip(paths, telling or (), strict=True))
