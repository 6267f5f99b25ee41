"""The folder of a sequence, which grows cloud by cloud: a run that was stopped goes on where it was.

`plan.json` is what it is made of and how, `instants/<instant>.json` says that an instant is done.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import msgspec
from msgspec import Struct

from capture_app.errors import BadInputError, DiskFullError, TryAgainError
from capture_app.session.files.disk import is_full
from capture_app.session.files.durable import PART, sync_folder, write_atomic
from capture_app.session.files.locks import lock_file
from capture_app.session.files.output_folder import replaces_only
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from capture_app.text import pretty_json
from reconstruction.multiview.recording import RECORDING
from reconstruction.multiview.result import SequenceInstant

RESULT = "sequence.json"
PLAN = "plan.json"
INSTANTS, CLOUDS, MESHES, DEPTH, MASKS = "instants", "clouds", "meshes", "depth", "movers"
_WORK, _LOCK = ".work", ".lock"
_BEGUN = {PLAN, f"{PLAN}{PART}", _WORK, _LOCK}
OURS = _BEGUN | {RESULT, INSTANTS, CLOUDS, MESHES, DEPTH, MASKS, CALIBRATION, RECORDING}
OURS |= {f"{RESULT}{PART}", f"{CALIBRATION}{PART}"}
"""With what a killed run leaves half written."""

Form = TypeVar("Form", bound=Struct)


class SequencePlan(Struct, frozen=True, kw_only=True):
    """What a folder's clouds are made of and how: those of another plan do not belong among them."""

    session: str
    pictures: str
    """Their fingerprint, with the calibration's."""
    condition: str
    time_shifts_ms: dict[str, float]
    matcher: str
    meshes: bool
    depth: bool

    def require_same(self, earlier: "SequencePlan", out: Path) -> None:
        """Raises BadInputError where an earlier plan differs."""
        for name in self.__struct_fields__:
            if getattr(self, name) != getattr(earlier, name):
                what = f"{out} holds clouds of {name.replace('_', ' ')} {getattr(earlier, name)!r}"
                raise BadInputError(
                    f"{what}, not {getattr(self, name)!r}", hint="choose a new folder for --out"
                )


class SequenceFolder:
    """A sequence's folder, locked against other runs while its context lasts."""

    def __init__(self, out: Path, plan: SequencePlan) -> None:
        self.out = out
        self._plan = plan
        self._lock = -1

    def __enter__(self) -> Self:
        """Lock the folder, make it where there is none, and remove what a run that was killed had begun.

        Raises:
            TryAgainError: another run is writing to it.
            BadInputError: it holds something else, or clouds that were made otherwise, or cannot be written.
        """
        try:
            if self.out.exists():
                if not self.out.is_dir():
                    raise BadInputError(f"{self.out} is a file", hint="choose another --out")
                replaces_only(OURS if (self.out / PLAN).exists() else _BEGUN)(self.out)
            self._lock = lock_file(self.out / _LOCK)
            try:
                self._begin()
            except BaseException:
                self._release()
                raise
        except BlockingIOError:
            what = f"another run is writing to {self.out}"
            raise TryAgainError(what, hint="wait until it has ended, or choose another --out") from None
        except OSError as error:
            raise self._explain(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the folder; without a cloud nothing is left of it."""
        # What is removed makes room: the disk is asked before.
        explained = self._explain(error) if isinstance(error, OSError) else None
        self._release()
        if explained is not None:
            raise explained from error

    def done(self, instant: int) -> SequenceInstant | None:
        """What came of an instant; None where its cloud is still to make."""
        done = _read(self._record(instant), SequenceInstant)
        return done if done and done.cloud and (self.out / done.cloud).is_file() else None

    def finish(self, done: SequenceInstant) -> None:
        """Keep what came of an instant, whose cloud has its name."""
        write_atomic(self._record(done.instant), pretty_json(done))

    def calibration(self) -> Calibration | None:
        """The calibration that an earlier run made for this folder, as its session has none."""
        return _read(self.out / CALIBRATION, Calibration)

    @property
    def files(self) -> tuple[str, ...]:
        """What the finished folder holds."""
        return tuple(sorted({RESULT} | {path.name for path in self.out.iterdir()} - {_WORK, _LOCK}))

    def empty_work(self) -> Path:
        """A folder to make files in, empty now; it is gone in the end, or when a killed run goes on."""
        shutil.rmtree(self.out / _WORK, ignore_errors=True)
        (self.out / _WORK).mkdir()
        return self.out / _WORK

    def take_over(self, name: str) -> None:
        """Give what was made in the folder to work in its place."""
        (self.out / _WORK / name).replace(self.out / name)
        sync_folder(self.out)

    def _begin(self) -> None:
        earlier = _read(self.out / PLAN, SequencePlan)
        if earlier is None and (self.out / PLAN).exists():
            raise BadInputError(f"{self.out / PLAN} is broken", hint="choose a new folder for --out")
        if earlier is not None and self._has_clouds():
            self._plan.require_same(earlier, self.out)
        shutil.rmtree(self.out / _WORK, ignore_errors=True)
        for part in list(self.out.rglob(f"*{PART}")):
            part.unlink()
        if earlier != self._plan:
            self._clear()
            write_atomic(self.out / PLAN, pretty_json(self._plan))
        for folder in (INSTANTS, CLOUDS):
            (self.out / folder).mkdir(exist_ok=True)

    def _record(self, instant: int) -> Path:
        return self.out / INSTANTS / f"{instant:06d}.json"

    def _release(self) -> None:
        # A plan that was refused is another's, and so is all the rest.
        if _read(self.out / PLAN, SequencePlan) == self._plan:
            shutil.rmtree(self.out / _WORK, ignore_errors=True)
            if not self._has_clouds():
                self._clear()
        (self.out / _LOCK).unlink(missing_ok=True)
        with suppress(OSError):
            self.out.rmdir()
        os.close(self._lock)

    def _has_clouds(self) -> bool:
        return any((self.out / CLOUDS).glob("*.ply"))

    def _clear(self) -> None:
        """Remove what is of no use without clouds."""
        for folder in (INSTANTS, CLOUDS, MESHES, DEPTH, MASKS):
            shutil.rmtree(self.out / folder, ignore_errors=True)
        # Last the plan: with it the next run knows the rest for its own.
        for file in (CALIBRATION, RECORDING, RESULT, PLAN):
            (self.out / file).unlink(missing_ok=True)

    def _explain(self, error: OSError) -> BadInputError | DiskFullError:
        if is_full(error, self.out):
            what = f"the disk of {self.out} is full"
            return DiskFullError(what, hint="make room and run it again: it goes on where it was")
        return BadInputError(f"cannot write to {self.out}: {error.strerror}", hint="choose another --out")


def _read(path: Path, form: type[Form]) -> Form | None:
    """A file of ours; None where there is none, or it is broken."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=form)
    except (FileNotFoundError, msgspec.MsgspecError):
        return None
