"""Readers of sessions, and of what a machine keeps for itself."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from capture_app.common.errors import SimulshotError
from capture_app.node.camera.device_profiles import DeviceProfiles, mode_key
from capture_app.node.camera.spool import SpoolFolder
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.journal import TIMES, ground_truth_path
from capture_app.session.format.manifest import CALIBRATION, JOURNAL, MANIFEST
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.checksums import CHECKSUMS
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.trust.known_machines import FILE, KnownMachines
from reconstruction.scene.dataset import Dataset
from tests.facts import make_facts
from tests.fuzz.folders import Reader, put, small_session

SESSION_FILES: Sequence[str] = (MANIFEST, JOURNAL, CHECKSUMS, PLAN, CALIBRATION, TIMES)


def read_session_file(name: str) -> Reader:
    """A session in which one file is whatever a stranger made of it: listed, opened, verified, shown."""

    def read(data: bytes, folder: Path) -> None:
        session = small_session(folder)
        put(session / name, data)
        list_sessions(folder)
        with suppress(SimulshotError):
            opened = Session.open(session)
            verify(opened)
            judge(opened.manifest)
            opened.calibration()
            opened.true_times()
        for use in (TakeSheet.open, Dataset.open, read_plan):
            with suppress(SimulshotError):
                use(session)

    return read


def read_ground_truth(data: bytes, folder: Path) -> None:
    """The true depth of an image."""
    session = small_session(folder)
    put(session / ground_truth_path("left", 0), data)
    with suppress(SimulshotError):
        Dataset.open(session).ground_truth("left", 0)


def repair_session(data: bytes, folder: Path) -> None:
    """An unfinished session whose journal is broken: what is whole is kept."""
    session = small_session(folder)
    (session / MANIFEST).unlink()
    put(session / JOURNAL, data)
    with suppress(SimulshotError):
        SessionWriter.resume(session).abort()
    assert len(list(session.rglob("*.jpg"))) == 5


def read_spool(data: bytes, folder: Path) -> None:
    """A burst that a node still has to send."""
    (folder / "report.json").write_bytes(data)
    (folder / "000001.film").write_bytes(bytes(1_000_000))
    (folder / "000001.ndjson").write_bytes(data)
    burst = SpoolFolder(folder)
    with suppress(SimulshotError):
        burst.read_report()
    with suppress(SimulshotError):
        list(burst.film.recover())


def read_profiles(data: bytes, folder: Path) -> None:
    """What this machine knows of its devices."""
    (folder / "device-profiles.json").write_bytes(data)
    known = DeviceProfiles(folder).read(mode_key(make_facts()))
    assert known.usable_injection in (None, known.injection)


def read_known_machines(data: bytes, folder: Path) -> None:
    """The machines that this one knows."""
    put(folder / FILE, data)
    with suppress(SimulshotError):
        KnownMachines(folder).all()
