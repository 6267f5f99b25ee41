"""Rigs that run on this machine in separate processes: found, started, and left running."""

import asyncio
import contextlib
import os
import socket
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from msgspec import Struct
from platformdirs import user_state_path

from capture_app.common import system
from capture_app.common.address import LOOPBACK_HOSTS, Address, own_hosts, parse_address
from capture_app.common.child import error_of_exit
from capture_app.common.errors import DiskFullError, NetworkError, SimulshotError
from capture_app.common.passwords import reveal_password
from capture_app.common.stagger import Stagger
from capture_app.common.timeouts import RIG_START_TIMEOUT_S
from capture_app.protocol.orders import AddCamera
from capture_app.rig.rig_link import ask_status, give_order
from capture_app.session.files.disk import LITTLE_BYTES, free_bytes
from capture_app.session.files.durable import write_atomic


class LeaderRecord(Struct, frozen=True, kw_only=True):
    """Record of a leader's process, which exists while it runs."""

    pid: int
    leader: str
    """host:port for processes of this machine."""
    sessions: str
    started_unix_ns: int
    log: str | None = None
    """Log file of a rig in the background; None for one that logs to a terminal."""

    @property
    def address(self) -> Address:
        """Address for processes of this machine."""
        return parse_address(self.leader)


@dataclass(frozen=True, slots=True)
class AttachedRig:
    """The rig that a screen shows: its address, and whether this screen started it."""

    leader: Address
    sessions: Path
    """Folder whose sessions are shown: the rig's own if the rig is on this machine."""
    is_local: bool
    """Whether the leader is on this machine."""
    started: bool = False
    """Whether it was started for this screen."""


def rigs_folder() -> Path:
    """Return the folder of the records and logs."""
    return user_state_path("simulshot") / "rigs"


@contextlib.contextmanager
def recorded_rig(address: Address, sessions: Path, log: Path | None = None) -> Iterator[None]:
    """Store a record of this process while the block runs; without it, the screen cannot find the rig.

    If the folder cannot be written, that is the only consequence.
    """
    rig = LeaderRecord(
        pid=os.getpid(),
        leader=str(address),
        sessions=str(sessions.absolute()),
        started_unix_ns=time.time_ns(),
        log=None if log is None else str(log),
    )
    path = rigs_folder() / f"{rig.pid}.json"
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, msgspec.json.encode(rig))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def list_rigs(*, sessions: Path | None = None, port: int | None = None) -> list[LeaderRecord]:
    """Return the rigs of this machine whose processes run, newest first; remove stale records.

    Only those with that folder and port, if they are given.
    """
    rigs = []
    for path in rigs_folder().glob("*.json"):
        with contextlib.suppress(OSError, ValueError, RecursionError):
            rig = msgspec.json.decode(path.read_bytes(), type=LeaderRecord)
            if not system.is_running(rig.pid):
                path.unlink()
            elif port in (None, 0, rig.address.port) and (
                sessions is None or Path(rig.sessions).resolve() == sessions.resolve()
            ):
                rigs.append(rig)
    return sorted(rigs, key=lambda rig: -rig.started_unix_ns)


async def find_rig(*, sessions: Path | None = None, port: int | None = None) -> LeaderRecord | None:
    """Return the newest rig of this machine that answers, with that folder and port if they are given."""
    for rig in list_rigs(sessions=sessions, port=port):
        with contextlib.suppress(SimulshotError):
            await ask_status(rig.address)
            return rig
    return None


async def start_rig(
    *,
    sessions: Path,
    host: str,
    port: int | None = None,
    cameras: Sequence[str] = (),
    stagger: Stagger | None = None,
    is_owned: bool = False,
    until_unused: bool = False,
) -> LeaderRecord:
    """Start a rig in the background and return it when it answers.

    It outlives this process unless `is_owned`; with `until_unused` it ends if it is unused.
    Without a `port` it takes the default one, or a free one.
    Raises NetworkError for a port that is in use or a host that is not this machine's, and the error with
    which the rig's process ended.
    """
    log = _new_log()
    options = (
        *("--host", host),
        *([] if port is None else ["--port", str(port)]),
        *(["--until-unused"] if until_unused else []),
        *(f"--camera={camera}" for camera in cameras),
        *([] if stagger is None else ["--stagger", str(stagger)]),
    )
    process = _spawn(options, sessions, log, is_owned)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(RIG_START_TIMEOUT_S):
            while process.poll() is None:
                for rig in list_rigs():
                    if rig.pid == process.pid:
                        with contextlib.suppress(NetworkError):
                            await ask_status(rig.address)
                            return rig
                await asyncio.sleep(0.1)
            raise _failure(process.returncode, log)
    process.terminate()
    raise NetworkError(f"the rig did not answer within {RIG_START_TIMEOUT_S:g} s", hint=f"its log is {log}")


async def attach(
    *,
    leader: Address | None = None,
    sessions: Path | None = None,
    host: str = "0.0.0.0",  # noqa: S104 - cameras are other machines
    port: int | None = None,
    cameras: Sequence[str] = (),
) -> AttachedRig:
    """Find the rig that a screen is to show, or start one; a given `leader` need not answer yet.

    Raises the errors of `start_rig`.
    """
    if leader is not None:
        local = leader.host in (*LOOPBACK_HOSTS, *own_hosts(socket.AF_INET), *own_hosts(socket.AF_INET6))
        folder = sessions or Path("sessions")
        if local and sessions is None:
            with contextlib.suppress(SimulshotError):
                folder = Path((await ask_status(leader)).sessions_folder or folder)
        return AttachedRig(leader, folder, is_local=local)
    rig_here = await find_rig(sessions=sessions, port=port)
    if rig_here is not None:
        for camera in cameras:
            await give_order(rig_here.address, AddCamera(spec=reveal_password(camera)))
        return AttachedRig(rig_here.address, Path(rig_here.sessions), is_local=True)
    folder = sessions or Path("sessions")
    rig = await start_rig(sessions=folder, host=host, port=port, cameras=cameras, until_unused=True)
    return AttachedRig(rig.address, Path(rig.sessions), is_local=True, started=True)


def _new_log() -> Path:
    folder = rigs_folder()
    folder.mkdir(parents=True, exist_ok=True)
    # The newest nine stay, beside the new one.
    for old in sorted(folder.glob("*.log"))[:-9]:
        with contextlib.suppress(OSError):
            old.unlink()
    return folder / f"{time.time_ns()}.log"


def _spawn(options: Sequence[str], sessions: Path, log: Path, is_owned: bool) -> subprocess.Popen[bytes]:
    """Start a leader's process, which ends with this one if it `is_owned`."""
    places = ("--sessions", str(sessions.absolute()), "--log", str(log))
    arguments = (*places, *(["--until-eof"] if is_owned else []), *options)
    with log.open("wb") as output:
        process = subprocess.Popen(  # noqa: S603 - our own program
            [*system.PYTHON, "-m", "capture_app.cli", "leader", *arguments],
            # The pipe closes with this process, however it ends.
            stdin=subprocess.PIPE if is_owned else subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            **system.child_options({}, in_background=not is_owned),
        )
    threading.Thread(target=_reap, args=(process,), daemon=True).start()
    return process


def _reap(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process, which otherwise stays a zombie and counts as running, and close its pipe."""
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _failure(code: int, log: Path) -> SimulshotError:
    """Return the error of a rig that ended at once, from the end of its log."""
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    if not lines and free_bytes(log.parent) < LITTLE_BYTES:
        return DiskFullError(f"the rig could not begin: the disk of {log.parent} is full", hint="make room")
    said = next((line.partition(": error: ")[2] for line in reversed(lines) if ": error: " in line), "")
    return error_of_exit(
        code, said or f"the rig ended with code {code}: {(lines or ['it said nothing'])[-1]}"
    )
