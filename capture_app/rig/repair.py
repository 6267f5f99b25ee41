"""Completion of interrupted sessions, with images that nodes still have if they can be reached."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, NetworkError, SimulshotError
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.intake import disk_threads
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.manifest import IMAGES, JOURNAL, MANIFEST, RIG
from capture_app.session.reading.reader import Session, is_being_written
from capture_app.session.reading.verify import verify

CHECK_EVERY_S = 0.25


class RepairResult(Struct, frozen=True, kw_only=True):
    """Result of repairing one session."""

    session: str
    ok: bool
    """Whether the session is now complete and verified."""
    changed: bool
    images: int = 0
    missing: int = 0
    what: str = ""
    awaited: str = ""
    """How images that nodes may still have are added; empty if no node can have any."""


async def repair(path: Path, *, wait_s: float, address: Address, log: Log) -> list[RepairResult]:
    """Finish the session at `path`, or all in that folder, and return the result of each.

    For `wait_s` a leader listens on the address for nodes that deliver what they still have; with 0 it does
    not. Raises BadInputError where there is no session, NetworkError where an interrupted session needs a
    port that is in use.
    """
    folders = _sessions(path)
    problems = {folder: _problem(folder) for folder in folders}
    broken = [folder for folder, problem in problems.items() if problem and (folder / PLAN).is_file()]
    before = {folder: _missing(folder) for folder in folders if not problems[folder]}
    lacking = [folder for folder in before if _holders(folder)]
    leader = "the leader"
    if (broken or lacking) and wait_s > 0:
        try:
            await _ask_nodes(broken, lacking, wait_s, address, log)
        except NetworkError:
            if broken:
                raise
            leader = f"the leader that runs at {address}"
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
    results = [_result(folder, problems[folder], folder in broken) for folder in folders]
    return [
        replace(
            result,
            changed=result.changed or result.missing < before.get(folder, 0),
            awaited=f"{leader} adds what {', '.join(holders)} may still have" if holders else "",
        )
        for folder, result in zip(folders, results, strict=True)
        for holders in [_holders(folder) if folder in lacking else []]
    ]


async def _ask_nodes(
    broken: Sequence[Path], lacking: Sequence[Path], wait_s: float, address: Address, log: Log
) -> None:
    """Lead for `wait_s`: finish the broken sessions, and add images to those that lack some."""
    options = LeaderOptions(
        sessions=[*broken, *lacking][0].parent,
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
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                while any(map(_holders, lacking)):  # noqa: ASYNC110 - the sessions of other bursts do not tell
                    await asyncio.sleep(CHECK_EVERY_S)
        await leader.bursts.resumed.wait_until_finished()


def _missing(folder: Path) -> int:
    return len(Session.open(folder).stored_manifest.missing)


def _holders(folder: Path) -> list[str]:
    """Return the cameras that may still have missing images, as they have not reported them missing."""
    try:
        plan, missing = read_plan(folder), Session.open(folder).stored_manifest.missing
    except SimulshotError:
        return []
    gone = {(gap.camera, gap.instant) for part in plan.cameras for gap in part.missing}
    runs = [(part.camera.name, run) for part in plan.cameras for run in part.missing_runs]

    def is_gone(camera: str, instant: int) -> bool:
        ordered = plan.chosen[instant] if plan.chosen else instant
        return (camera, ordered) in gone or any(
            name == camera and run.first <= instant < run.first + run.count for name, run in runs
        )

    return sorted({gap.camera for gap in missing if not is_gone(gap.camera, gap.instant)})


def _sessions(path: Path) -> list[Path]:
    if not path.is_dir():
        raise BadInputError(f"no folder {path}", hint="capture-app sessions list shows what is there")
    for pattern in ("", "*/"):
        files = (file for name in (MANIFEST, JOURNAL, PLAN) for file in path.glob(pattern + name))
        if found := sorted({file.parent for file in files if file.is_file()}):
            return found
    raise BadInputError(
        f"no session in {path}", hint="give a session, or the folder that contains the sessions"
    )


def _problem(folder: Path) -> str:
    """Return what is wrong with a session; empty for nothing."""
    if is_being_written(folder):
        # Where it is finished, its missing images are arriving.
        return "" if (folder / MANIFEST).is_file() else "is still being written by another process"
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
    return RepairResult(
        session=str(folder),
        ok=True,
        changed=bool(before),
        images=len(manifest.images),
        missing=len(manifest.missing),
        what="; ".join(sorted({f"{gap.camera}: {gap.reason}" for gap in manifest.missing})),
    )
