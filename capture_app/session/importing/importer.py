"""Importer interface: each entry point of the group `simulshot.importers` names an `Importer`.

Built-in ones are entry points, too. An importer declares what it recognizes of one program: recordings,
single cameras, calibrations. This module finds the importer of each path; folders and files that none
recognizes are plain images and videos.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import takewhile
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import IMAGE_SUFFIXES, VIDEO_SUFFIXES, folder_names, label_of, natural_order
from capture_app.common.plugins import load_plugins
from capture_app.common.text import command_line, count
from capture_app.session.importing.name_roles import Parse, choose, parse_names
from capture_app.session.importing.recording_sources import (
    ARCHIVE_SUFFIXES,
    Layout,
    Source,
    Video,
    folders_below,
    image_folder,
    images_in,
    numbers_in,
    videos_in,
)
from capture_app.session.importing.views import Views

GROUP = "simulshot.importers"
CALIBRATION = re.compile(
    r"calib|intrinsic|extrinsic|board|checker|charuco|camera_(parameters|matrix)", re.IGNORECASE
)
_SMALLER = re.compile(r"images_(2|4|8|16)")
"""Folders of smaller copies beside `images`, as LLFF, nerfstudio and COLMAP's users have them."""
_COPIES = re.compile(r"(^|/)(@eadir|thumb(nail)?s?|previews?|prox(y|ies))(/|$)", re.IGNORECASE)
CameraFiles = tuple[str, Path, list[Path]]
"""Label and path of a camera, and its files if the folder has other cameras' too."""
UNREAD = {
    "": "it needs a subfolder of images or a video file for each camera",
    ".heic": "convert it to JPEG: heif-convert {file} FILE.jpg",
    ".heif": "convert it to JPEG: heif-convert {file} FILE.jpg",
    ".gif": "convert it: ffmpeg -i {file} FILE.mp4",
    ".mcap": "name the file: capture-app sessions import {file}",
    ".db3": "a bag of ROS 2 needs its metadata.yaml: ros2 bag reindex {folder}",
}
"""What to do with files, by their suffix, where a folder has nothing that is read."""
MAX_NAMED = 8
"""Number of files, folders and cameras that are named one by one."""
_ONE_AT_A_TIME = "capture-app sessions import makes a session of each"


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

    A PATH with `*` is of all files that match: images of a camera NAME, or parts of its video; without NAME,
    a camera each. `recording` selects one of several recordings of each camera. Raises BadInputError for
    missing, empty, duplicate or badly named cameras, and for a folder of several takes.
    """
    cameras: list[CameraFiles] = []
    for text in paths:
        name, path = split_name(text)
        place, some = _matching(path)
        if not path.exists() and not some:
            hint = f"a network's camera joins a rig: capture-app node --camera {text}"
            raise BadInputError(f"nothing at {path}", hint=hint if "://" in text else "check the path")
        if not name and path.is_dir() and not camera_importer(path):
            takes, _ = takes_in(path)
            if len(takes) > 1:
                raise BadInputError(f"{path} has several takes: {', '.join(takes)}", hint=_ONE_AT_A_TIME)
            cameras += next(iter(takes.values()))
        else:
            # Without a name, it is what a shell makes of it: files of their own.
            whole = [(place, some)] if name or not some else [(file, []) for file in some]
            cameras += [
                (name or label_of(at.resolve().name if at.is_dir() else at.stem), at, of) for at, of in whole
            ]
    if not cameras:
        raise BadInputError("nothing to import", hint="give a folder, or NAME=PATH for each camera")
    return open_cameras(cameras, png=png, recording=recording)


def open_cameras(
    cameras: Sequence[CameraFiles], *, png: bool = False, recording: str | None = None
) -> list[Source]:
    """Open cameras, sorted by name; see `open_sources`."""
    labels = [label for label, *_ in cameras]
    names = dict(zip(folder_names(labels, "camera", "cam"), cameras, strict=True))
    sources = []
    for name, (label, path, files) in sorted(names.items(), key=lambda one: natural_order(one[0])):
        source = _source(name, path, files, png, recording)
        source.label = label
        sources.append(source)
    return sources


def open_images(folder: Path) -> list[Source]:
    """Open the images of a folder as cameras of one instant, named as they are; see `open_cameras`."""
    return open_cameras([(label_of(file.stem), file, []) for file in sorted(images_in(folder))])


def _matching(path: Path) -> tuple[Path, list[Path]]:
    """Return the folder and the files of a path with `*` in it; of any other path, itself and no files."""
    first = 0 if path.exists() else next((n for n, part in enumerate(path.parts) if "*" in part), 0)
    place = Path(*path.parts[:first]) if first else path
    found = place.glob("/".join(path.parts[first:])) if first else ()
    return place, sorted(found, key=lambda file: natural_order(str(file)))


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


def _archive(path: Path) -> BadInputError:
    folder = path.with_suffix("")
    return BadInputError(
        f"{path} is an archive",
        hint=f"unpack it into {folder}, then: capture-app sessions import {command_line(str(folder))}",
    )


def _source(name: str, path: Path, files: Sequence[Path], png: bool, recording: str | None) -> Source:
    if files:
        is_video = files[0].suffix.lower() in VIDEO_SUFFIXES
        return Video(name, files[0], files[1:], png=png) if is_video else image_folder(name, path, files)
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


def takes_in(folder: Path) -> tuple[dict[str, list[CameraFiles]], list[str]]:
    """Return the cameras of each take in a folder by the names in it, and what the names were taken for.

    Raises BadInputError, with the possible readings, if the names leave it open.
    """
    videos = videos_in(folder)
    recorded = {path: path.name for path in folder.iterdir() if path.is_dir() and camera_importer(path)}
    places = [place for place in folders_below(folder) if place != folder and images_in(place)]
    places = [
        place
        for place in places
        if not _COPIES.search(place.relative_to(folder).as_posix())
        and not (_SMALLER.fullmatch(place.name) and place.with_name("images") in places)
    ]
    boards = [place for place in places if CALIBRATION.search(str(place.relative_to(folder)))]
    if len(boards) < len(places) or images_in(folder):
        places = [place for place in places if place not in boards]
    if videos and (recorded or places):
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    if videos or recorded:
        named = [(path.stem, path) for path in videos] or [(name, path) for path, name in recorded.items()]
        return {"": [(label_of(name), path, []) for name, path in named]}, []
    files = sorted(file for place in places or [folder] for file in images_in(place))
    # A picture of the set beside the cameras' has no number, or more.
    counts = Counter(len(numbers_in(file.stem)) for file in files)
    numbered = [file for file in files if 4 * counts[len(numbers_in(file.stem))] > 3 * len(files)]
    parses = parse_names(numbered or files, folder)
    if (parse := choose(parses)) is None and len(places) == 1:
        alone = label_of(places[0].relative_to(folder).parts[0])
        return {"": [(alone, places[0], [])]}, []
    if parse is None or parse.others:
        raise _undecided(folder, files, places, parses)
    takes = {
        take: [
            (
                label_of(name),
                parent if {parent := own[0].parent} == {file.parent for file in own} else folder,
                [*own],
            )
            for name, own in cameras.items()
        ]
        for take, cameras in parse.takes.items()
    }
    apart = {path for cameras in takes.values() for _, path, _ in cameras}
    # A folder a camera needs no words.
    return takes, [f"by their names: {parse}"] * (len(takes) > 1 or len(apart) < len(takes[""]))


def _undecided(
    folder: Path, files: Sequence[Path], places: Sequence[Path], parses: Sequence[Parse]
) -> BadInputError:
    """Return the question which of the possible readings of names is right, with the command of each."""
    archives = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in ARCHIVE_SUFFIXES]
    if not files and archives:
        return _archive(archives[0])
    if not files:
        below = (path for place in folders_below(folder) for path in sorted(place.iterdir()))
        other = next((path for path in below if path.suffix.lower() in UNREAD), folder)
        return BadInputError(
            f"no cameras in {folder}{'' if other == folder else f': {other.name} is not read there'}",
            hint=UNREAD.get(other.suffix.lower(), UNREAD[""]).format(
                file=command_line(str(other)), folder=command_line(str(other.parent))
            ),
        )
    likely = [parse for parse in parses if not parse.others][:2]
    options = "".join(f"; or {parse}: {_command(next(iter(parse.takes.values())))}" for parse in likely)
    some = ", ".join(str(place.relative_to(folder)) for place in places[:3])
    alone = f"capture-app sessions import cam0={command_line(str(folder))} --fps RATE"
    what, hint = (
        (
            f"{count(len(places), 'folder')} of images, of several takes or kinds: {some} ...",
            f"import one take at a time, or name the cameras: NAME=PATH{options}",
        )
        if places
        else (
            f"{count(len(files), 'image')}, whose names tell no cameras apart",
            f"put each camera's into a folder{options}; or one camera: {alone}",
        )
    )
    return BadInputError(f"{folder} has {what}", hint=hint)


def _command(cameras: Mapping[str, Sequence[Path]]) -> str:
    """Return the command that imports these cameras, with `*` for what differs in their files' names."""
    given = []
    # Files of one picture each are cameras by themselves, in one word that the shell takes apart.
    if all(len(files) == 1 for files in cameras.values()):
        cameras = {"": [file for files in cameras.values() for file in files]}
    for name, files in cameras.items():
        begin = _common_begin([str(file) for file in files])
        end = _common_begin([str(file)[len(begin) :][::-1] for file in files])[::-1]
        given.append(f"{name and f'{label_of(name)}='}{begin}{'*' * (len(files) > 1)}{end}")
    return (
        f"capture-app sessions import {command_line(*given[:MAX_NAMED])}{' ...' * (len(given) > MAX_NAMED)}"
    )


def _common_begin(texts: Sequence[str]) -> str:
    return "".join(own[0] for own in takewhile(lambda own: len({*own}) == 1, zip(*texts, strict=False)))
