"""A take as the screen follows it: ordered, on its way, saved, judged."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import SimulshotError
from capture_app.node.wire.messages import BurstRequest
from capture_app.node.wire.status import BurstStatus
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import Verdict, judge


@dataclass(frozen=True, slots=True)
class JudgedTake:
    """A take on this machine's disk, with its verdict."""

    sheet: TakeSheet
    verdict: Verdict


@dataclass(slots=True)
class Take:
    """One take: what was asked for, where it was asked from here, how far it is, and what it is worth."""

    status: BurstStatus
    request: BurstRequest | None = None
    judged: JudgedTake | None = None
    problem: str = ""
    """Why it could not be judged."""
    trashed: bool = False
    is_new: bool = True
    """It was taken while the screen was open."""
    begun_s: float = 0.0
    """When the screen heard of it first."""
    retake_of: str = ""
    """The take that it was taken again for."""

    @property
    def name(self) -> str:
        """The name of its session."""
        return self.status.name

    @property
    def key_instant(self) -> int:
        """The instant of the key, which is what the photographer meant."""
        return 0 if self.request is None else self.request.before


def judge_take(status: BurstStatus) -> JudgedTake | None:
    """Open the session of a burst that is done; None where it is not on this machine. Blocks on the disk.

    Raises SimulshotError where the session cannot be read.
    """
    if status.session is None or not (Path(status.session) / MANIFEST).is_file():
        return None
    sheet = TakeSheet.open(Path(status.session))
    if sheet.session.manifest.name != status.name:
        # A leader elsewhere has a folder of the same path.
        return None
    return JudgedTake(sheet, judge(sheet.session.manifest))


def describe_failure(error: SimulshotError) -> str:
    """A sentence for a take that could not be judged."""
    return f"it cannot be looked at: {error}"
