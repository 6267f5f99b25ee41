"""Reading of manifests: the images of a large one are read in pieces, and stay packed in memory."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.common.text import UNREADABLE
from capture_app.session.files.untrusted_files import MAX_BYTES, decode_struct, open_regular, read_struct
from capture_app.session.format.manifest import SCHEMA_VERSION, ImageRecord, Manifest, check_references

LARGE_BYTES = 1 << 25
"""Size from which a manifest's images stay packed, at some 60,000 images: 0.4 kB instead of 0.9 each."""
_PIECE_BYTES = 1 << 22
_BEGIN = re.compile(rb'(?<!\\)"images"\s*:\s*\[')
_END = re.compile(rb"\}\s*\]")
_parse = msgspec.json.Decoder(tuple[ImageRecord, ...]).decode
_unpack = msgspec.msgpack.Decoder(tuple[ImageRecord, ...]).decode


class PackedImages(Sequence[ImageRecord]):
    """The images of a large manifest; each pass over them unpacks them again, some thousands at a time."""

    def __init__(self) -> None:
        self._packs: list[bytes] = []
        self._length, self.max_instant = 0, 0
        self.cameras = set[str]()

    def add(self, data: bytes) -> None:
        """Add records, JSON objects between commas. Raises msgspec.MsgspecError if they are malformed."""
        records = _parse(b"[%b]" % data.lstrip().removeprefix(b","))
        self._packs.append(msgspec.msgpack.encode(records))
        self._length += len(records)
        self.max_instant = max([self.max_instant, *(record.instant for record in records)])
        self.cameras.update(record.camera for record in records)

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[ImageRecord]:
        return chain.from_iterable(map(_unpack, self._packs))

    def __getitem__(self, index: Any) -> Any:
        """Return an image or a slice of them; this takes as long as a pass."""
        return tuple(self)[index]


def read_manifest(path: Path) -> Manifest:
    """Read a session's manifest. Raises BadInputError as `read_struct` and `check_references` do."""
    # What is malformed, or unusual, is read again whole: its error names the place.
    with suppress(BadInputError, OSError, StopIteration, *UNREADABLE):
        if LARGE_BYTES < path.stat().st_size <= MAX_BYTES:
            return _read_in_pieces(path)
    manifest = read_struct(path, Manifest, SCHEMA_VERSION)
    check_references(path, manifest)
    return manifest


def _read_in_pieces(path: Path) -> Manifest:
    """Read a manifest. Raises StopIteration if it ends before its images do."""
    images = PackedImages()
    with open_regular(path) as file:
        # Twice as much each time, where nothing is found: else each search would begin anew.
        text = b""
        pieces = iter(lambda: file.read(max(1, len(text) // _PIECE_BYTES) * _PIECE_BYTES), b"")
        while (begin := _BEGIN.search(text)) is None:
            text += next(pieces)
        head, text = text[: begin.end()], text[begin.end() :]
        while (end := _END.search(text)) is None:
            cut = text.rfind(b"}", 0, max(text.rfind(b"}"), 0)) + 1  # this record may be the last of all
            images.add(text[:cut])
            text = text[cut:] + next(pieces)
        images.add(text[: end.start() + 1])
        rest = decode_struct(path, head + text[end.end() - 1 :] + file.read(), Manifest, SCHEMA_VERSION)
    check_references(path, rest)
    if not (
        images.cameras <= {camera.name for camera in rest.cameras}
        and images.max_instant < len(rest.burst.instants_ns)
    ):
        raise BadInputError(f"{path} has images of unknown cameras or instants")
    return msgspec.structs.replace(rest, images=images)
