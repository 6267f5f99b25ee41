"""Fast listing of many sessions, with thumbnails: it reads only what a list shows, and only what changed."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from stat import S_ISDIR
from typing import TYPE_CHECKING, Literal

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common import system
from capture_app.common.errors import BadInputError
from capture_app.session.format.burst_plan import PLAN
from capture_app.session.format.manifest import (
    GROUND_TRUTH,
    JOURNAL,
    MANIFEST,
    ImageRecord,
    VideoRecord,
    inside,
)
from capture_app.session.format.stored_manifest import read_manifest
from capture_app.session.reading.decoding import decode_image, encode_image
from capture_app.session.reading.reader import writing_state
from capture_app.session.reading.take_sheet import fit
from capture_app.session.reading.verdict import frames_lost

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

WIDTH_PX = 160
"""Width of the thumbnails."""
MAX_BYTES = 1 << 26
"""Number of bytes read of an image, or of a video for its first frame."""
MAX_FILES = 4000
"""Maximum number of cached thumbnails, about 20 MB; above it the oldest half is removed."""
_Stamp = tuple[int, int, int]
"""Key of a manifest's file that changes whenever the file does: time, size and inode."""
SessionState = Literal["complete", "being saved", "interrupted", "unreadable"]
"""Whether a session can be used."""


class SessionCard(Struct, frozen=True, kw_only=True):
    """A session's entry in a list; times in ns, None if unknown."""

    folder: Path
    state: SessionState = "complete"
    created: str = ""
    """RFC 3339, UTC; for an incomplete session, the time of its last change."""
    origin: str = ""
    cameras: tuple[str, ...] = ()
    """What their owner calls them."""
    instants: int = 0
    images: int = 0
    size_bytes: int = 0
    """Size of its images and videos; without a simulated take's ground truth."""
    missing: int = 0
    """Number of missing images, including absent cameras'."""
    loss: float = 0.0
    """Fraction of its frames that the camera lacks which lacks most, 0 to 1."""
    arriving: bool = False
    """Whether the missing images arrive at last."""
    absent: str = ""
    """The cameras of the rig that took no part, in words."""
    spread_ns: int | None = None
    """Largest peak-to-peak time of any instant; None without a common clock, or without two images."""
    unsynchronized: bool = False
    """Whether the offsets between the cameras' times are unknown."""
    uncertainty_ns: int | None = None
    """95 % uncertainty of the worst image's time."""
    late: int = 0
    note: str = ""
    label: str = ""
    """What its owner calls it, if not its name."""
    first_image: Path | None = None
    """The first image, or a video."""
    problem: str = ""
    """Why the session cannot be used."""
    remedy: str = ""
    """What the user can do about the problem."""

    @property
    def name(self) -> str:
        """Name of its folder, which identifies it in commands."""
        return self.folder.name

    @property
    def shown(self) -> str:
        """Its name, with what its owner calls it."""
        return f"{self.name} ({self.label})" if self.label else self.name

    @property
    def worst_ns(self) -> int | None:
        """Upper limit (95 %) of the time between two images of an instant, ns, with both images' errors."""
        known = self.spread_ns is not None and self.uncertainty_ns is not None
        return (self.spread_ns or 0) + 2 * (self.uncertainty_ns or 0) if known else None


class SessionListing:
    """The sessions in a folder; `read` may be called from one thread at a time."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[str, tuple[_Stamp | None, SessionCard]] = {}

    def read(self) -> list[SessionCard]:
        """Return all current sessions, by name; a folder that does not exist has none."""
        before, self._known = self._known, {}
        for folder, stamp in sorted(self._folders(), key=lambda pair: pair[0]):
            known = before.get(folder)
            if known is None or stamp is None or known[0] != stamp:
                known = stamp, read_card(Path(folder)) if stamp else _card_without_manifest(Path(folder))
            if known[1].missing:
                # Its images may arrive at last, which the manifest shows only afterwards.
                arriving = writing_state(Path(folder)) == "reopened"
                known = known[0], replace(known[1], arriving=arriving)
            self._known[folder] = known
        return [card for _, card in self._known.values()]

    def _folders(self) -> Iterator[tuple[str, _Stamp | None]]:
        """Yield each session's folder, with a key that changes whenever its manifest does.

        The key is None if the session has no manifest yet.
        """
        try:
            entries = list(os.scandir(self.root))
        except OSError:
            return
        for entry in entries:
            try:
                if entry.name.startswith(".") or not S_ISDIR(entry.stat().st_mode):
                    continue
                stat = os.stat(f"{entry.path}/{MANIFEST}")  # noqa: PTH116 - five times as quick for a list
                yield entry.path, (stat.st_mtime_ns, stat.st_size, stat.st_ino)
            except FileNotFoundError:
                if any(os.path.isfile(f"{entry.path}/{name}") for name in (JOURNAL, PLAN)):  # noqa: PTH113
                    yield entry.path, None
            except OSError:
                continue


def best_synchronized(cards: list[SessionCard]) -> SessionCard | None:
    """Return the best synchronized session, errors included; None if fewer than two are known.

    One without a missing image comes before all others.
    """
    known = [card for card in cards if card.worst_ns is not None and card.state == "complete"]
    return min(known, key=lambda card: (card.missing > 0, card.worst_ns)) if len(known) > 1 else None


def read_card(folder: Path) -> SessionCard:
    """Read the list entry of a session that has a manifest."""
    try:
        manifest = read_manifest(folder / MANIFEST)
        records = chain[ImageRecord | VideoRecord](
            manifest.images, (video for video in manifest.videos if video.frames)
        )
        first_image = next((inside(folder, record.path) for record in records), None)
    except BadInputError as error:
        return SessionCard(
            folder=folder,
            state="unreadable",
            problem=error.what,
            remedy=error.hint or f"capture-app sessions repair {folder}",
        )
    sync, times, instants = manifest.sync, manifest.burst.common_times, len(manifest.burst.instants_ns)
    unsynchronized = times is not None and times.unknown
    images = len(manifest.images) + sum(video.frames for video in manifest.videos)
    comparable = sync is not None and len(manifest.cameras) > 1 and not unsynchronized
    return SessionCard(
        folder=folder,
        created=manifest.created,
        origin=manifest.origin,
        cameras=tuple(manifest.labels.values()),
        instants=instants,
        images=images,
        size_bytes=sum(image.bytes for image in manifest.images)
        + sum(video.bytes for video in manifest.videos)
        + disk_bytes(folder / GROUND_TRUTH),
        missing=manifest.expected_images - images,
        loss=max(frames_lost(manifest).values(), default=0) / max(1, manifest.ordered_instants),
        absent=manifest.burst.absence,
        spread_ns=max(sync.spread_ns, default=None) if sync is not None and comparable else None,
        unsynchronized=unsynchronized,
        uncertainty_ns=None if sync is None else sync.uncertainty_ns,
        late=0 if sync is None else sync.late,
        note=manifest.note,
        label=manifest.label or "",
        first_image=first_image,
    )


def _card_without_manifest(folder: Path) -> SessionCard:
    try:
        writing = writing_state(folder) == "being written"
        changed_s = folder.stat().st_mtime
    except OSError as error:
        return SessionCard(folder=folder, state="unreadable", problem=f"{folder}: {error.strerror}")
    created = datetime.fromtimestamp(changed_s, UTC).isoformat(timespec="seconds")
    if writing:
        return SessionCard(
            folder=folder,
            created=created,
            state="being saved",
            problem="its images are still coming in",
            remedy="wait until the burst is saved",
        )
    return SessionCard(
        folder=folder,
        created=created,
        state="interrupted",
        problem="it is incomplete: its capture ended before it was saved; the images that came are safe",
        remedy=f"capture-app sessions repair {folder}",
    )


def list_sessions(root: Path) -> list[SessionCard]:
    """Return all sessions in a folder, oldest first. Raises BadInputError if the folder does not exist."""
    if not root.is_dir():
        raise BadInputError(f"no folder {root}", hint="sessions appear there once a burst is taken")
    return sorted(SessionListing(root).read(), key=lambda card: (card.created, card.name))


def disk_bytes(*folders: Path) -> int:
    """Return the size of all files below these folders; of one that does not exist 0. Blocks on the disk.

    Without the files of a folder that changes meanwhile.
    """
    total = 0
    for at, _, names in chain.from_iterable(map(os.walk, folders)):
        with suppress(OSError):
            total += sum(os.lstat(f"{at}/{name}").st_size for name in names)
    return total


def load_thumbnail(folder: Path, image: Path) -> "NDArray[np.uint8] | None":
    """Return a thumbnail (height x width x BGR, `WIDTH_PX` wide), cached in `folder`; None if unreadable.

    May be called from any thread. Blocks on the disk.
    """
    try:
        stat = image.stat()
    except OSError:
        return None
    key = f"{image.resolve()}\0{stat.st_mtime_ns}\0{stat.st_size}"
    cached = folder / f"{hashlib.sha256(os.fsencode(key)).hexdigest()[:32]}.jpg"
    small = _decode(cached)
    if small is None and (large := _decode(image)) is not None:
        small = _cache(cached, fit(large, WIDTH_PX, WIDTH_PX * large.shape[0]))
    return small


def _cache(path: Path, small: "NDArray[np.uint8]") -> "NDArray[np.uint8]":
    """Cache a thumbnail, and return it as it will be read back after lossy coding."""
    coded = encode_image(small, quality=85)
    # A cache that cannot be written only costs time.
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.part")
        aside.write_bytes(coded)
        system.replace(aside, path)
        # Only one write in 256 checks whether there are too many.
        files = [] if int(path.name[:2], 16) else list(path.parent.glob("*.jpg"))
        files.sort(key=lambda file: file.stat().st_mtime_ns)
        for file in files[: len(files) // 2] if len(files) > MAX_FILES else ():
            file.unlink(missing_ok=True)
    cached = decode_image(coded, colour=True)
    return small if cached is None else cached


def _decode(path: Path) -> "NDArray[np.uint8] | None":
    try:
        with path.open("rb") as file:
            # The first frame of a video is a complete JPEG.
            return decode_image(file.read(MAX_BYTES), colour=True, min_width=WIDTH_PX)
    except OSError:
        return None
