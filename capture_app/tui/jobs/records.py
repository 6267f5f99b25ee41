"""What is kept of a job on disk, beside its results, so that the next start of the screen knows of it.

_results/<session>/<job>.json    what it was to do, and what came of it
_results/<session>/<job>.log     what it said
"""

from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from msgspec import Struct

from capture_app.errors import BadInputError
from capture_app.session.files.durable import write_atomic_unsynced
from capture_app.session.format.checks import read_struct
from capture_app.session.library.results import RESULTS, results_folder
from capture_app.text import pretty_json, printable
from capture_app.tui.jobs.job import Job, JobState
from capture_app.tui.jobs.kinds import KINDS

INTERRUPTED = "the screen was closed before it was done"


class JobRecord(Struct, frozen=True, kw_only=True):
    """What is kept of a job."""

    kind: str
    session: str
    """Relative to the folder of sessions where it lies inside, else absolute."""
    out: str = ""
    """The same, for its folder of results."""
    options: str = ""
    state: JobState = JobState.RUNNING
    message: str = ""
    ended: datetime | None = None
    seconds: float = 0.0


def default_out(kind_name: str, session: Path, root: Path) -> Path:
    """Where a job of that kind puts its results unless it is told otherwise."""
    return results_folder(session, root) / kind_name


def save_record(job: Job, root: Path) -> None:
    """Write a job's record and its log. Raises OSError."""
    place = results_folder(job.session, root)
    place.mkdir(parents=True, exist_ok=True)
    record = JobRecord(
        kind=job.kind.name,
        session=_shorten(job.session, root),
        out="" if job.out is None else _shorten(job.out, root),
        options=job.options,
        state=job.state,
        message=job.message,
        ended=job.ended,
        seconds=round(job.seconds, 1),
    )
    write_atomic_unsynced(place / f"{job.kind.name}.json", pretty_json(record))
    if not job.state.is_over:
        (place / f"{job.kind.name}.log").unlink(missing_ok=True)
    else:
        log = "".join(f"{line}\n" for line in job.log)
        write_atomic_unsynced(place / f"{job.kind.name}.log", log.encode(errors="replace"))


def forget_record(job: Job, root: Path) -> None:
    """Remove a job's record and its log; its results stay. Raises OSError."""
    for suffix in ("json", "log"):
        (results_folder(job.session, root) / f"{job.kind.name}.{suffix}").unlink(missing_ok=True)


def find_jobs(root: Path) -> Iterator[Job]:
    """Yield the jobs of earlier runs in a folder of sessions, the latest last; blocks on the disk.

    A session that was renamed since has its results under its new name, and its jobs follow it.
    """
    places = [*(root / RESULTS).glob("*/*.json"), *(root / RESULTS).glob("_*/*/*.json")]
    found = [job for place in places if (job := _read(place, root)) is not None]
    yield from sorted(found, key=_age)


def _age(job: Job) -> tuple[datetime, str]:
    return job.ended or datetime.min.replace(tzinfo=UTC), f"{job.session} {job.kind.name}"


def _read(place: Path, root: Path) -> Job | None:
    try:
        record = read_struct(place, JobRecord)
    except BadInputError:
        return None
    kind = KINDS.get(record.kind)
    if kind is None or place.stem != record.kind:
        return None
    session, out = _lengthen(record.session, root), _lengthen(record.out, root) if record.out else None
    if place.parent.parent == root / RESULTS and session.parent == root:
        session = root / place.parent.name
        if out is not None and not Path(record.out).is_absolute():
            out = place.parent / out.name
    state, message, ended = record.state, record.message, record.ended
    if not state.is_over:
        state, message = JobState.CANCELLED, INTERRUPTED
        ended = datetime.fromtimestamp(place.stat().st_mtime, UTC)
    if state is JobState.DONE and kind.result and (out is None or not (out / kind.result).is_file()):
        return None
    job = Job(kind, session, out, record.options, 0, state, message=message, ended=ended)
    job.seconds, job.is_found = record.seconds, True
    with suppress(OSError):
        job.log.extend(printable(place.with_suffix(".log").read_text(errors="replace")).splitlines())
    return job


def _shorten(path: Path, root: Path) -> str:
    """Relative to the folder of sessions where it lies inside: that folder may be moved."""
    absolute, base = path.absolute(), root.absolute()
    return str(absolute.relative_to(base)) if absolute.is_relative_to(base) else str(absolute)


def _lengthen(text: str, root: Path) -> Path:
    return root / text
