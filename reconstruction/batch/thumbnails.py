"""The depth pictures of a batch as a page shows them: small, each leading to the whole one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import BadInputError
from reconstruction.batch.rows import Row
from reconstruction.report.embedding import EmbeddedImage, embed_image
from reconstruction.session.frame_offset import evenly_spread

THUMBNAIL_PX = 160
MAX_COLUMNS = 12
"""Instants that a sheet shows, spread evenly: more do not fit a page."""
MAX_SHEETS = 20
"""Sessions whose pictures a page shows; the tables list them all."""


@dataclass(frozen=True)
class Thumbnail:
    """A small picture, and where the whole one lies beside the page."""

    image: EmbeddedImage
    path: str


@dataclass(frozen=True)
class Sheet:
    """A session's pictures: a row for each condition, a column for each instant; None = none there."""

    session: str
    instants: Sequence[int]
    rows: Sequence[tuple[str, Sequence[Thumbnail | None]]]


def depth_sheets(root: Path, rows: Sequence[Row]) -> list[Sheet]:
    """One for each session that has a picture, up to `MAX_SHEETS`."""
    pictured = [row for row in rows if row.picture]
    sessions = list(dict.fromkeys(row.session for row in pictured))[:MAX_SHEETS]
    return [_sheet(root, name, [row for row in pictured if row.session == name]) for name in sessions]


def _sheet(root: Path, session: str, rows: Sequence[Row]) -> Sheet:
    instants = sorted({row.instant for row in rows if row.instant is not None})
    instants = evenly_spread(instants, MAX_COLUMNS)
    found = {(row.condition, row.instant): row.picture for row in rows}
    conditions = dict.fromkeys(row.condition for row in rows)
    return Sheet(
        session,
        instants,
        [(one, [_thumbnail(root, found.get((one, now), "")) for now in instants]) for one in conditions],
    )


def _thumbnail(root: Path, path: str) -> Thumbnail | None:
    """None also where the picture was deleted or spoilt since: the figures stand without it."""
    if not path:
        return None
    try:
        return Thumbnail(embed_image(root / path, most_px=THUMBNAIL_PX), path)
    except BadInputError:
        return None
