"""`checksums.sha256`: checksums of the manifest and of the files that it does not cover.

The lines have the format of `sha256sum`, so `sha256sum --check checksums.sha256` verifies them.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from capture_app.session.files.durable import write_atomic
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.format.burst_plan import PLAN
from capture_app.session.format.journal import FRAMES_SUFFIX, TIMES, TRUE_TIMES_JOURNAL, is_frames_path
from capture_app.session.format.manifest import CALIBRATION, EVENTS, JOURNAL, MANIFEST, RECIPE, VIDEOS

CHECKSUMS = "checksums.sha256"
COVERED = (MANIFEST, JOURNAL, EVENTS, PLAN, CALIBRATION, TIMES, TRUE_TIMES_JOURNAL, RECIPE)

REPLACED = (MANIFEST, PLAN, CALIBRATION, TIMES)
"""Files that are written again while late images arrive or after that; the others only grow."""


def write_checksums(folder: Path, manifest: bytes) -> Path:
    """Write the checksums of a session's files and of `manifest`, which is written next.

    Returns the path of the checksum file. The caller syncs it and its folder.
    """
    sums = {MANIFEST: hashlib.sha256(manifest).hexdigest()}
    videos = sorted(folder.glob(f"{VIDEOS}/*/*{FRAMES_SUFFIX}"))
    for name in (*COVERED[1:], *(lines.relative_to(folder).as_posix() for lines in videos)):
        if (folder / name).is_file():
            sums[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    path = folder / CHECKSUMS
    write_atomic(path, "".join(f"{digest}  {name}\n" for name, digest in sums.items()).encode(), synced=False)
    return path


def changed_files(folder: Path, *, is_open: bool = False) -> Iterator[tuple[str, str]]:
    """Yield the path of each file that changed since the session was finished, and what is wrong with it.

    If it `is_open` again, files may be replaced or grow as late images arrive.
    """
    try:
        stored = read_regular(folder / CHECKSUMS)
    except OSError:
        yield CHECKSUMS, "the checksums are missing"
        return
    known = set()
    for line in stored.split(b"\n")[:-1]:
        sha256, _, name = line.decode("ascii", errors="replace").partition("  ")
        known.add(name)
        if not (name in COVERED or is_frames_path(name)) or len(sha256) != 64:
            yield CHECKSUMS, f"has an unknown line: {line!r}"
            continue
        try:
            data = read_regular(folder / name)
            may_differ = is_open and (name in REPLACED or _begins_with(data, sha256))
            if hashlib.sha256(data).hexdigest() != sha256 and not may_differ:
                yield name, "its bytes have changed: another sha256"
        except OSError as error:
            yield name, f"cannot be read: {error.strerror}"
    if MANIFEST not in known or JOURNAL not in known or not stored.endswith(b"\n"):
        yield CHECKSUMS, "is incomplete"


def _begins_with(data: bytes, sha256: str) -> bool:
    """Return whether the first lines of a file, or none, have a checksum."""
    running = hashlib.sha256()
    for line in (b"", *data.splitlines(keepends=True)):
        running.update(line)
        if running.hexdigest() == sha256:
            return True
    return False
