"""Checks of paths, JSON files and manifests that may come from anywhere, and of what is written."""

import re
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TypeVar

import msgspec

from capture_app.errors import BadInputError
from capture_app.names import check_name
from capture_app.session.format.manifest import MANIFEST, Manifest
from capture_app.text import UNREADABLE

_T = TypeVar("_T")


class _Version(msgspec.Struct):
    """The one field that is read before all others."""

    schema_version: int = 1


def inside(folder: Path, path: str) -> Path:
    """The file of a path that a manifest gives. Raises BadInputError where it leads out of the folder."""
    parts = PurePosixPath(path).parts
    odd = not parts or path.startswith("/") or ".." in parts or "\\" in path or "\0" in path
    file = folder / path
    try:
        safe = not odd and file.resolve().is_relative_to(folder.resolve())
        if safe:
            with suppress(FileNotFoundError, NotADirectoryError):
                file.stat()  # from Python 3.13 on a loop of links resolves, and fails only here
    except (OSError, RuntimeError):
        safe = False
    if not safe:
        raise BadInputError(f"{folder / MANIFEST} names {path!r}, which lies outside the session")
    return file


def read_struct(path: Path, kind: type[_T], newest: int | None = None) -> _T:
    """Read a JSON file into a struct; `newest` is the highest schema_version that is understood.

    Raises BadInputError where the file cannot be read, is no JSON, is of a newer version, or does not
    fit the struct; the message says where.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    try:
        if newest is not None:
            version = msgspec.json.decode(data, type=_Version).schema_version
            if version > newest:
                raise BadInputError(
                    f"{path} is of schema version {version}; this simulshot reads up to {newest}",
                    hint="a newer simulshot wrote it: update this one",
                )
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{path} does not fit its schema: {error}") from error
    except UNREADABLE as error:
        raise BadInputError(f"{path} is not valid JSON: {error}{_line_of(data, str(error))}") from error


def encode_checked(value: msgspec.Struct, kind: type[msgspec.Struct]) -> bytes:
    """Encode a struct. Raises BadInputError where its values break its schema: constructors check nothing."""
    data = msgspec.json.encode(value)
    try:
        msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"a {kind.__name__} that breaks its schema: {error}") from error
    return data


def indented(data: bytes) -> bytes:
    """Indent JSON, one value a line."""
    return msgspec.json.format(data, indent=1) + b"\n"


def check_references(path: Path, manifest: Manifest) -> None:
    """Check the names, and that images are of cameras and instants that the manifest at `path` has.

    Raises BadInputError for the first that is not.
    """
    names = [camera.name for camera in manifest.cameras]
    if len(set(names)) != len(names):
        raise BadInputError(f"{path} lists a camera twice")
    for name in (*names, manifest.name, manifest.rig):
        check_name(name, "camera, a rig or a session")
    named = [(f"images[{i}]", image.camera, image.instant) for i, image in enumerate(manifest.images)]
    named += [(f"missing[{i}]", gone.camera, gone.instant) for i, gone in enumerate(manifest.missing)]
    for where, camera, instant in named:
        if camera not in names:
            raise BadInputError(f"{path}: {where} is of an unknown camera, {camera}")
        if instant >= len(manifest.burst.instants_ns):
            raise BadInputError(f"{path}: {where} is of an unknown instant, {instant}")


def _line_of(data: bytes, message: str) -> str:
    """Line and column of msgspec's `(byte N)`, as editors count them."""
    found = re.search(r"\(byte (\d+)\)", message)
    if found is None:
        return ""
    lines = data[: int(found[1])].split(b"\n")
    return f", line {len(lines)} column {len(lines[-1]) + 1}"
