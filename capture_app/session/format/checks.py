"""Checks of paths, JSON files and manifests that may come from anywhere, and of what is written."""

import re
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import msgspec

from capture_app.errors import BadInputError, reading
from capture_app.names import check_name
from capture_app.session.files.strangers import read_regular
from capture_app.session.format.manifest import MANIFEST, Manifest
from capture_app.text import UNREADABLE

_T = TypeVar("_T")
MOST_INTEGER, MOST_REAL = 2**63, 1e15
"""Numbers of a manifest are smaller: sums and products of them then stay numbers everywhere."""


def inside(folder: Path, path: str) -> Path:
    """The file of a path that a manifest gives, which need not be there.

    Raises BadInputError where it leads out of the folder, or is a pipe or a device.
    """
    parts = PurePosixPath(path).parts
    odd = not parts or path.startswith("/") or ".." in parts or "\\" in path or "\0" in path
    file, waits = folder / path, False
    try:
        safe = not odd and file.resolve().is_relative_to(folder.resolve())
        if safe:
            with suppress(FileNotFoundError, NotADirectoryError):
                # From Python 3.13 on a loop of links resolves, and fails only here.
                mode = file.stat().st_mode
                waits = not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))
    except (OSError, RuntimeError):
        safe = False
    if not safe:
        raise BadInputError(f"{folder / MANIFEST} names {path!r}, which lies outside the session")
    if waits:
        raise BadInputError(f"{folder / MANIFEST} names {path!r}, which is not a regular file")
    return file


def read_struct(path: Path, kind: type[_T], newest: int | None = None) -> _T:
    """Read a JSON file into a struct; `newest` is the highest schema_version that is understood.

    Raises BadInputError where the file cannot be read, is no JSON, is of a newer version, or does not
    fit the struct; the message says where.
    """
    with reading(path):
        data = read_regular(path)
    return decode_struct(path, data, kind, newest)


def decode_struct(path: Path, data: bytes, kind: type[_T], newest: int | None = None) -> _T:
    """Decode JSON as `read_struct` does; `path` is where it is from."""
    try:
        if newest is not None:
            fields = msgspec.json.decode(data, type=dict[str, msgspec.Raw])
            version = msgspec.json.decode(fields.get("schema_version", b"1"), type=int)
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
    """Check the names and numbers, and that images are of cameras and instants of the manifest at `path`.

    Raises BadInputError for the first that is not.
    """
    numbers = list(_numbers(msgspec.to_builtins(manifest)))
    if not all(abs(one) < (MOST_INTEGER if isinstance(one, int) else MOST_REAL) for one in numbers):
        raise BadInputError(f"{path} has a number that no session has, such as one of over 64 bits")
    if not manifest.burst.instants_ns:
        raise BadInputError(f"{path} has no instants")
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


def _numbers(value: Any) -> Iterator[int | float]:
    """Yield all numbers in plain data."""
    if isinstance(value, dict):
        value = value.values()
    elif isinstance(value, int | float):
        yield value
        return
    elif not isinstance(value, list | tuple):
        return
    for part in value:
        yield from _numbers(part)


def _line_of(data: bytes, message: str) -> str:
    """Line and column of msgspec's `(byte N)`, as editors count them."""
    found = re.search(r"\(byte (\d+)\)", message)
    if found is None:
        return ""
    lines = data[: int(found[1])].split(b"\n")
    return f", line {len(lines)} column {len(lines[-1]) + 1}"
