"""Roles of the pieces of files' names: which piece names the camera, which the take, and which the instant.

A name consists of words and numbers, and each folder above it is a further piece. The pieces at one place of
all names form a column. A parse makes one column the camera's; its score is the evidence for that.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os.path import commonpath
from pathlib import Path
from unicodedata import normalize

from capture_app.common.grouping import grouped

_DEVICE = (
    r"cam|kamera|cámara|caméra|камера|カメラ|相机|相機|كاميرا|view|angle|"
    r"gopro|phone|pixel|ipad|galaxy|canon|sony|^(c|ch|pi)\d{0,2}$"
)
"""Words before the number of a camera; C001 is a clip of a cinema camera."""
CAMERA = re.compile(f"{_DEVICE}|left|right|front|back|side|top", re.IGNORECASE)
"""Words in the names of cameras."""
TAKE = re.compile(
    r"(?<![^\W\d_])(take|trial|run|scene|shot|day|session|try|attempt|walk|jump|drive|seq|clip)|(?<!\d)20\d\d",
    re.IGNORECASE,
)
"""Words in the names of takes, and years."""
_INSTANT = re.compile(r"(frame|time|step|shot|t)s?", re.IGNORECASE)
"""Words before the number of an instant."""
_SERIAL = re.compile(r"(?!(19|20)\d{6}$|([01]\d|2[0-3])[0-5]\d[0-5]\d{4}$)[1-9]\d{6,8}")
"""A camera's serial number, which is neither a date nor a time of day in ms."""
_AROUND = re.compile(r"(.*?)[\s_.-]*(\d+)[\s_.-]*(\D*)")
"""The last number of a name, and what is before and after it."""
_DIGIT = re.compile(r"\d")
_MAX_CAMERAS = 1000
_MARGIN = 2
"""Least score of a parse that is taken, and its least distance from every other one."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A word or a number of a name, or a folder above it."""

    text: str
    label: str = ""
    """The word before a number."""
    name: str = ""
    """What a camera or a take with this piece is called."""
    is_folder: bool = False


Row = tuple[Piece, ...]


@dataclass(frozen=True, slots=True)
class Parse:
    """One reading of names: the files of each camera in each take, and the evidence for it."""

    score: int
    takes: Mapping[str, Mapping[str, Sequence[Path]]]
    """By the name of the take, which is empty if there is only one, and by camera."""
    others: Sequence[str] = ()
    """Words that name neither cameras nor takes, such as `depth`."""

    @property
    def cameras(self) -> dict[str, list[Path]]:
        """The files of each camera in all takes."""
        return grouped(
            (name, file) for take in self.takes.values() for name, files in take.items() for file in files
        )

    def __str__(self) -> str:
        cameras = [*self.cameras]
        takes = f"; take = {', '.join(self.takes)}" if len(self.takes) > 1 else ""
        instants = max(len(files) for of in self.takes.values() for files in of.values())
        some = ", ".join([*cameras[:6], *["..."] * (len(cameras) > 6)])
        return f"camera = {some}{takes}; {'one instant' if instants == 1 else f'{instants} instants'}"


def parse_names(files: Sequence[Path], root: Path, *, stills: bool = True) -> list[Parse]:
    """Return the readings of the names of files below a folder, the likeliest first.

    `stills`: the files are images, whose numbers may count instants; all that videos' names have beside the
    camera is of takes.
    """
    columns = _columns(files, root)
    varying = [column for column in columns if len({piece.text for piece in column}) > 1]
    # A counter that stands still: one instant of what is counted before it.
    still = [n for n, one in enumerate(columns) if one not in varying and re.match(r"0\d", one[0].text)]
    parses = [
        _parse(files, varying, column, stills=stills, still=any(n > columns.index(column) for n in still))
        for column in reversed(varying)
        if len({piece.text for piece in column}) <= _MAX_CAMERAS
    ]
    # Columns that part the files in the same way are one reading, by the outermost of the best.
    found = sorted(filter(None, parses), key=lambda parse: parse.score)
    unique = {frozenset(map(tuple, one.cameras.values())): one for one in found}
    return sorted(unique.values(), key=lambda parse: -parse.score)


def choose(parses: Sequence[Parse]) -> Parse | None:
    """Return the first reading if there is evidence for it, and more than for the second; otherwise None."""
    first, second = [*(parse.score for parse in parses), 0, 0][:2]
    return parses[0] if first >= max(_MARGIN, second + _MARGIN) else None


def take_names(cameras: Mapping[str, Sequence[Path]]) -> dict[Path, str]:
    """Return what each file's path has beside its camera's own words: equal for files of one take.

    The files are in one folder, or each camera's in one of its own, at any depth.
    """
    files = [*chain.from_iterable(cameras.values())]
    texts = [name for name, own in cameras.items() for _ in own]
    columns = _columns(files, Path(commonpath([file.parent for file in files])))
    # The outermost folders that differ as the cameras do are theirs; what is in them may be takes.
    own = next((one for one in columns if one[0].is_folder and _parts_equal(one, texts)), None)
    rest = [column for column in columns if column is not own and _is_free(column, texts)]
    names = [name.casefold() for name in _take_names(rest, len(files))]
    # Where these do not distinguish a camera's files, their types do, or nothing.
    for other in ([file.suffix.casefold() for file in files], [*map(str, files)]):
        twice = {own[1] for own, n in Counter(zip(texts, names, strict=True)).items() if n > 1}
        names = [name + more * (name in twice) for name, more in zip(names, other, strict=True)]
    return dict(zip(files, names, strict=True))


def _parts_equal(column: Row, cameras: Sequence[str]) -> bool:
    """Return whether a column has one text for each camera, and another one for each other camera."""
    pairs = {*zip(cameras, (piece.text for piece in column), strict=True)}
    return len(pairs) == len({*cameras}) == len({piece.text for piece in column})


def _take_names(columns: Sequence[Row], count: int) -> list[str]:
    """Return each name's pieces in columns, with the word before them if that is the same in all names."""
    equal = [len({piece.label for piece in column}) == 1 for column in columns]
    named = [[p.name if own else p.text for p in column] for own, column in zip(equal, columns, strict=True)]
    return ["-".join(own) for own in zip(*named, strict=True)] or [""] * count


def _columns(files: Sequence[Path], root: Path) -> list[Row]:
    """Return the columns of the names below a folder; none if folders of unequal depth have equal rows."""
    above = [file.relative_to(root).parts[:-1] for file in files]
    depth = min(map(len, above), default=0)
    levels = map(_folder_pieces, zip(*(parts[:depth] for parts in above), strict=True))
    rows = [tuple(chain(*own)) for own in zip(*levels, _stems(files), strict=True)]
    return [*zip(*rows, strict=True)] if len({*rows}) == len({file.with_suffix("") for file in files}) else []


def _folder_pieces(names: Sequence[str]) -> list[Row]:
    """Return each folder's name as one piece, or its pieces if they are of a camera and more: `walk_left`."""
    stems = [_pieces(normalize("NFC", name)) for name in names]
    columns = [*zip(*stems, strict=False)] if len({*map(len, stems)}) == 1 else []
    varying = [column for column in columns if len({piece.text for piece in column}) > 1]
    of_cameras = any(CAMERA.search(piece.label or piece.text) for column in varying for piece in column)
    if of_cameras and all(len({piece.text for piece in column}) < len({*names}) for column in varying):
        return [tuple(replace(piece, is_folder=True) for piece in stem) for stem in stems]
    return [(Piece(name, "", name, is_folder=True),) for name in names]


def _stems(files: Sequence[Path]) -> list[Row]:
    """Return as many pieces of each name: words and numbers, or the last number with its sides, or all."""
    names = [normalize("NFC", file.stem) for file in files]
    stems = [_pieces(name) for name in names]
    if len({tuple(piece.text.isdecimal() for piece in stem) for stem in stems}) == 1:
        return stems
    parted = [match.groups() for name in names if (match := _AROUND.fullmatch(name))]
    if len(parted) < len(names) or len({(not head, not tail) for head, _, tail in parted}) > 1:
        parted = [(name,) for name in names]
    return [tuple(Piece(text, "", text) for text in parts if text) for parts in parted]


def _pieces(stem: str) -> Row:
    pieces, begin, end, word = list[Piece](), 0, 0, ""
    for match in re.finditer(r"\d+|[^\d\s_.,+=()\[\]-]+", stem):
        label = word if match[0].isdecimal() else ""
        joined = label and (end == match.start() or CAMERA.search(label))
        pieces.append(Piece(match[0], label, stem[begin if joined else match.start() : match.end()]))
        begin, end, word = *match.span(), "" if match[0].isdecimal() else match[0]
    return tuple(pieces)


def _is_free(column: Row, cameras: Sequence[str], *, alone: bool = False) -> bool:
    """Return whether a column is not the camera's, but varies within one, or names its take.

    `alone`: each camera has one file, so that a number may be another instant's.
    """
    own = {(camera, piece.text) for camera, piece in zip(cameras, column, strict=True)}
    number = column[0].text.isdecimal() and not column[0].is_folder
    named = any(CAMERA.search(piece.label) or _SERIAL.fullmatch(piece.text) for piece in column)
    # Two numbers of each camera, as a place and a serial number.
    named |= _parts_equal(column, cameras) and all(map(str.isdecimal, cameras))
    of_takes = len({piece.text for piece in column}) > 1 and _names_takes(column, [()])
    return len(own) > len({*cameras}) or of_takes or (number and (alone or not named))


def _parse(
    files: Sequence[Path], varying: Sequence[Row], camera: Row, *, stills: bool, still: bool
) -> Parse | None:
    """Return the reading in which a column is the camera's; None if each has one file, of its own number."""
    texts = [piece.text for piece in camera]
    cameras = {*texts}
    alone = not camera[0].is_folder and min(Counter(texts).values()) == 1
    rest = [column for column in varying if column is not camera and _is_free(column, texts, alone=alone)]
    keys = [tuple(column[n].text for column in rest) for n in range(len(files))]
    pairs, instants = {*zip(texts, keys, strict=True)}, {*keys}
    if alone and len(pairs) == len(instants) > 1:
        return None
    counters = [
        column
        for column in rest
        if column[0].text.isdecimal() or (not column[0].is_folder and _DIGIT.search(column[0].text))
    ]
    takes = [column for column in rest if not stills or _names_takes(column, counters)]
    found: dict[str, dict[str, list[Path]]] = {}
    for file, take, piece in zip(files, _take_names(takes, len(files)), camera, strict=True):
        found.setdefault(take, {}).setdefault(piece.name, []).append(file)
    full = len(pairs) == len(cameras) * len(instants)
    # Each camera has all instants, or most.
    points = 2 if full else int(len(pairs) > 0.6 * len(cameras) * len(instants))
    if len(instants) == 1 or (stills and camera[0].text.isdecimal() and not counters):
        points = 0
    # Words distinguish instants if no camera lacks one; in a camera's own folder they are of its frames.
    distinct = [
        column
        for column in ([] if full and not counters else rest)
        if (column[0].is_folder or not camera[0].is_folder) and column not in takes
    ]
    others = sorted({piece.text for piece in chain(*distinct) if not _DIGIT.search(piece.text)})
    # A long number may count, too, if nothing else does.
    counts = len(instants) > 1 and (counters != [] or not stills)
    return Parse(points + _evidence(camera, serials=counts, still=still), found, others)


def _names_takes(column: Row, counters: Sequence[Row] = ()) -> bool:
    """Return whether a column is of takes, by its words, or as a numbered folder; `counters` may be instants.

    A numbered folder without other counters holds an instant.
    """
    counted = any(one is not column for one in counters)
    numbered = all(_DIGIT.search(piece.text) for piece in column)
    # Years are of takes in the names of folders only.
    words = (p.label or ("" if _DIGIT.search(p.text) and not p.is_folder else p.text) for p in column)
    of_takes = any(map(TAKE.search, words))
    return (counted and numbered and column[0].is_folder) or (of_takes and (counted or not numbered))


def _evidence(camera: Row, *, serials: bool, still: bool) -> int:
    """Return the evidence in a column's words that it names cameras; `serials`: they may be theirs.

    It is 4 for words of cameras, -4 for words of takes and instants, and 2 each for a folder, for words
    without a digit, and for a number before a counter that stands `still`. It is -2 for another number
    with leading zeros.
    """
    texts, labels = ({getattr(piece, of) for piece in camera} for of in ("text", "label"))
    words = {piece.label + piece.text for piece in camera} if len(labels) == 1 else set[str]()
    number = all(map(str.isdecimal, texts))
    serial = serials and all(map(_SERIAL.fullmatch, texts))
    score = 2 * camera[0].is_folder + 2 * (not any(map(_DIGIT.search, texts)))
    # The number after a place, as in left1, is a frame's; so is one of four digits.
    words_of = re.compile(_DEVICE, re.IGNORECASE) if number else CAMERA
    if serial or (any(map(words_of.search, words)) and not (number and max(map(len, texts)) > 3)):
        return score + 4
    counts = any(TAKE.search(word) or _INSTANT.fullmatch(re.sub(r"[\W\d_]+$", "", word)) for word in words)
    padded = number and any(re.match(r"0\d\d", text) for text in texts)
    return score - 4 * counts + 2 * number * (still - (padded and not still))
