"""Completion of interrupted sessions, with images that nodes still have if they can be reached."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, NetworkError, SimulshotError
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.intake import disk_threads
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.manifest import IMAGES, JOURNAL, MANIFEST, RIG, MissingImage
from capture_app.session.reading.reader import Session, writing_state
from capture_app.session.reading.verify import verify


class RepairResult(Struct, frozen=True, kw_only=True):
    """Result of repairing one session."""

    session: str
    ok: bool
    """Whether the session is now complete and verified."""
    changed: bool
    images: int = 0
    missing: int = 0
    what: str = ""
    awaited: tuple[str, ...] = ()
    """Cameras that may still have missing images, which a running leader adds when they connect."""


async def repair(path: Path, *, wait_s: float, address: Address, log: Log) -> list[RepairResult]:
    """Finish the session at `path`, or all in that folder, and return the result of each.

    For `wait_s` a leader listens on the address for nodes that deliver what they still have; with 0 it does
    not. Raises BadInputError where there is no session, NetworkError where the port is in use.
    """
    folders = _sessions(path)
    problems = {folder: _problem(folder) for folder in folders}
    broken = [folder for folder, problem in problems.items() if problem and (folder / PLAN).is_file()]
    if broken and wait_s > 0:
        await _ask_nodes(broken, wait_s, address, log)
    for folder in broken:
        if _problem(folder):
            try:
                with disk_threads() as disk:
                    session = BurstSession.resume(folder, 0, disk)
                    await session.finish_now(
                        "it was not on the leader's disk when the session was repaired, and no node sent it"
                    )
                if session.failure is not None:
                    raise session.failure
            except BadInputError as error:
                problems[folder] = f"{error}; its images: capture-app sessions import {folder / IMAGES / RIG}"
            except SimulshotError as error:
                problems[folder] = str(error)
    return [_result(folder, problems[folder], folder in broken) for folder in folders]


async def _ask_nodes(broken: Sequence[Path], wait_s: float, address: Address, log: Log) -> None:
    options = LeaderOptions(
        sessions=broken[0].parent,
        host=address.host,
        port=address.port,
        log=log,
        resume=broken,
        return_ns=round(wait_s * 1e9),
    )
    try:
        leader = await LeaderNode.start(options)
    except NetworkError as error:
        hint = "a leader that runs there resumes its own sessions; --wait-s 0 finishes without asking nodes"
        raise NetworkError(error.what, hint=hint) from error
    async with leader:
        await leader.bursts.resumed.wait_until_finished()


def _sessions(path: Path) -> list[Path]:
    if not path.is_dir():
        raise BadInputError(f"no folder {path}", hint="capture-app sessions list shows what is there")
    for pattern in ("", "*/"):
        files = (file for name in (MANIFEST, JOURNAL, PLAN) for file in path.glob(pattern + name))
        if folders := sorted({file.parent for file in files if file.is_file()}):
            return folders
    raise BadInputError(
        f"no session in {path}", hint="give a session, or the folder that contains the sessions"
    )


def _problem(folder: Path) -> str:
    """Return what is wrong with a session; empty for nothing."""
    state = writing_state(folder)
    if state in ("being written", "reopened"):
        # What has arrived late is checked when it is finished again.
        return "is still being written by another process" if state == "being written" else ""
    try:
        problems = verify(Session.open(folder))
    except SimulshotError as error:
        if not (folder / PLAN).is_file() and not (folder / MANIFEST).is_file():
            return f"cannot be completed without {PLAN}, which imports do not have; import it again"
        return str(error)
    return str(problems[0]) if problems else ""


def _result(folder: Path, before: str, tried: bool) -> RepairResult:
    if before and (problem := _problem(folder)):
        # The error that prevented the repair is more informative than the remaining problem.
        return RepairResult(session=str(folder), ok=False, changed=False, what=before if tried else problem)
    manifest = Session.open(folder).manifest
    labels = manifest.labels
    return RepairResult(
        session=str(folder),
        ok=True,
        changed=bool(before),
        images=len(manifest.images),
        missing=len(manifest.missing),
        what="; ".join(sorted({f"{labels[gap.camera]}: {gap.reason}" for gap in manifest.missing})),
        awaited=_holders(folder, manifest.missing),
    )


def _holders(folder: Path, missing: Iterable[MissingImage]) -> tuple[str, ...]:
    """Return the cameras that may still have missing images, as they did not report them missing."""
    with suppress(BadInputError):
        parts = read_plan(folder).cameras
        reported = {(gap.camera, gap.reason) for part in parts for gap in part.missing}
        reported |= {(part.camera.name, run.reason) for part in parts for run in part.missing_runs}
        return tuple(sorted({gap.camera for gap in missing if (gap.camera, gap.reason) not in reported}))
    return ()
