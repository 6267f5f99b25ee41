"""Opens the cameras of a recording that a user named on the command line."""

from collections.abc import Sequence
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.names import check_name, is_name, natural_order
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importers.phones import PhoneVideo, is_phone, phone, table_of
from capture_app.session.importers.sources import ImageFolder, Source, Video, images_in, videos_in


def open_sources(paths: Sequence[str], *, png: bool = False, recording: str | None = None) -> list[Source]:
    """The cameras of `NAME=PATH` arguments, or of one folder whose subfolders or videos are cameras.

    `recording` is part of the name of one of several recordings of RecSync on each phone.
    Raises BadInputError for what is missing, empty, doubled or badly named.
    """
    sources: list[Source] = []
    for text in paths:
        name, path = split_name(text)
        if not path.exists():
            raise BadInputError(f"nothing at {path}")
        if name:
            sources.append(_source(name, path, png, recording))
        elif is_phone(path):
            sources.append(_source(path.resolve().name, path, png, recording))
        elif path.is_dir():
            sources.extend(_sources_in(path, png, recording))
        else:
            sources.append(_source(path.stem, path, png, recording))
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
    if is_phone(path):
        return phone(name, path, png=png, recording=recording)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageFolder(name, path)
    return PhoneVideo(name, path, png=png) if table_of(path) else Video(name, path, png=png)


def _sources_in(folder: Path, png: bool, recording: str | None) -> list[Source]:
    videos = videos_in(folder)
    folders = [path for path in folder.iterdir() if path.is_dir() and (images_in(path) or is_phone(path))]
    if not videos and not folders:
        hint = "it needs a subfolder of images or a video file for each camera"
        if images_in(folder):
            hint = f"its images are of one camera: cam0={folder}"
        raise BadInputError(f"no cameras in {folder}", hint=hint)
    if videos and folders:
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    named = [(path.stem, path) for path in videos] + [(path.name, path) for path in folders]
    return [_source(name, path, png, recording) for name, path in named]
