"""Atomic output folders: a result appears complete or not at all, and an earlier one stays until then.

A run works in the hidden folder `.NAME.part` beside its target, on the same file system:

    lock      held by the run with flock, so that the system releases it when the run is killed
    new       the new result; it replaces the target at the end
    earlier   the earlier result, briefly, if the file system cannot exchange two folders atomically
    early     a file on its way to a target without an earlier result, before all others

The next run to the same target restores or removes what a killed run left there, with a warning. A second run
to a target in use is refused at once, since one of the two results would be lost. Only a caller that can use
the other's result, such as a batch, waits for it.
"""

import errno
import logging
import os
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskFullError, SimulshotError, TryAgainError
from capture_app.session.files.disk import is_full
from capture_app.session.files.durable import (
    PART,
    free_name,
    link_or_copy,
    sync_folder,
    sync_tree,
)
from capture_app.session.files.locks import lock_file

_LOCK, _NEW, _EARLIER, _EARLY = "lock", "new", "earlier", "early"
_INNER = f".{_NEW}{PART}"
"""Working folder of an output inside another's working folder, such as multiview's in a batch's unit."""
_log = logging.getLogger(__name__)

_EARLIER_PAGE = "walk.html"
"""File in results of splat, view and people that were written before December 2026."""
Check = Callable[[Path], None]
"""Raises BadInputError if a non-empty folder must not be replaced."""


def replaces_only(names: Collection[str]) -> Check:
    """Return a check that allows replacing an earlier result, but no folder with files other than `names`."""

    def check(target: Path) -> None:
        if foreign := {path.name for path in target.iterdir()} - {*names, _EARLIER_PAGE}:
            raise BadInputError(
                f"{target} holds other files ({min(foreign)})", hint="choose a new folder for --out"
            )

    return check


def replaces_nothing(target: Path, option: str = "--out") -> None:
    """Refuse to replace any non-empty folder; `option` of the command chooses another."""
    raise BadInputError(
        f"{target} exists already and has something in it", hint=f"choose another name with {option}"
    )


class OutputFolder:
    """A working `folder` that replaces `target` when its context ends without an error."""

    def __init__(self, target: Path, check: Check, *, wait: bool = False) -> None:
        """Check that `target` may be written; `wait` for another run to it instead of being refused.

        Raises:
            BadInputError: `target` is a file, a mount point or, by `check`, not an earlier result.
        """
        self.target = Path(os.path.realpath(target))
        self._check, self._wait = check, wait
        self._discarded = False
        self._early: Path | None = None
        """The target's file that was shown before the result was complete."""
        self._lock = -1
        self._workplace = self.target.parent / f".{self.target.name}{PART}"
        self._earlier = self._workplace / _EARLIER
        self.folder = self._workplace / _NEW
        with output_errors(self.target, self._workplace):
            self._check_target()

    def __enter__(self) -> Self:
        """Lock the target, clean up after a killed run, and create the working folder.

        Raises:
            TryAgainError: another run is writing to the target.
            BadInputError: the target cannot be written, or must not be replaced.
        """
        try:
            with output_errors(self.target, self._workplace):
                self._check_workplace()
                self._lock = lock_file(self._workplace / _LOCK, wait=self._wait)
                try:
                    self._clear_leftovers()
                    self._check_target()
                    self.folder.mkdir()
                except BaseException:
                    self._release()
                    raise
        except SimulshotError:
            self._remove_workplace()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Move the folder to its target; after an error, delete it and keep the target unchanged.

        Raises:
            DiskFullError: the disk is full.
            BadInputError: the target cannot be replaced.
        """
        try:
            with output_errors(self.target, self._workplace):
                if error is None and not self._discarded:
                    self._put_in_place()
                elif isinstance(error, OSError) and is_full(error, self._workplace):
                    raise error
        finally:
            self._release()

    def discard(self) -> None:
        """Drop the new output on exit, and leave the target unchanged; this is not an error."""
        self._discarded = True

    def show_early(self, name: str) -> bool:
        """Show a file of the unfinished result in the target already; return whether it has just appeared.

        A target with an earlier result remains until the end. After an error the file disappears.
        """
        shown, part = self.target / name, self._workplace / _EARLY
        with output_errors(self.target, self._workplace):
            if self.target.exists() and {path.name for path in self.target.iterdir()} - {name}:
                return False
            self.target.mkdir(exist_ok=True)
            link_or_copy(str(self.folder / name), str(part))
            system.replace(part, shown)
        appeared, self._early = self._early is None, shown
        return appeared

    def _check_target(self) -> None:
        if os.path.ismount(self.target):
            raise BadInputError(f"{self.target} is a mount point", hint="choose a folder inside it")
        if self.target.exists() and not self.target.is_dir():
            raise BadInputError(f"{self.target} is a file", hint="choose another --out")
        if not self._is_free():
            self._check(self.target)

    def _check_workplace(self) -> None:
        # Another run may remove the folder meanwhile, which `os.walk` takes for an empty one.
        _, folders, files = next(os.walk(self._workplace), ("", [], []))
        if foreign := {*folders, *files} - {_LOCK, _NEW, _EARLIER, _EARLY, _INNER}:
            raise BadInputError(
                f"{self._workplace} is not of this program (it holds {min(foreign)})",
                hint="move it away, or choose another --out",
            )

    def _is_free(self) -> bool:
        return not self.target.exists() or not any(self.target.iterdir())

    def _clear_leftovers(self) -> None:
        """Restore or remove what a killed run left, and log a warning."""
        left = self.folder.exists() or self._earlier.exists()
        self._restore()
        (self._workplace / _EARLY).unlink(missing_ok=True)
        for unfinished in (self.folder, self._workplace / _INNER):
            if unfinished.exists():
                shutil.rmtree(unfinished)
        if left:
            _log.warning("removed what a run that was killed had left in %s", self._workplace)

    def _restore(self) -> None:
        """Settle an earlier result that was set aside: move it back if nothing has replaced it.

        Delete it if the new result has. Rename it to NAME-earlier if another program's folder has.
        """
        if not self._earlier.exists():
            return
        if not self.target.exists():
            system.replace(self._earlier, self.target)
            sync_folder(self.target.parent)
            _log.warning("restored the earlier result in %s", self.target)
        elif self.folder.exists():
            # Another program created a folder of that name before the new result could be moved there.
            renamed = free_name(self.target.with_name(f"{self.target.name}-earlier"))
            system.replace(self._earlier, renamed)
            _log.warning("the earlier result of %s is now in %s", self.target, renamed)
        else:
            shutil.rmtree(self._earlier)

    def _put_in_place(self) -> None:
        sync_tree(self.folder)
        sync_folder(self._workplace)
        self._check_target()
        if self._is_free():
            with suppress(FileNotFoundError):
                self.target.rmdir()  # fails if it is no longer empty
            system.replace(self.folder, self.target)
        elif not system.exchange(self.folder, self.target):
            system.replace(self.target, self._earlier)
            sync_folder(self._workplace)
            system.replace(self.folder, self.target)
        self._early = None
        sync_folder(self.target.parent)
        sync_folder(self._workplace)

    def _release(self) -> None:
        """Remove the working folder and release the lock; log what cannot be removed."""
        try:
            self._restore()
            if self._early is not None:
                self._early.unlink(missing_ok=True)
                with suppress(OSError):
                    self.target.rmdir()
            (self._workplace / _EARLY).unlink(missing_ok=True)
            shutil.rmtree(self.folder, ignore_errors=True)
            if self.folder.exists():
                raise OSError(0, "some files in it cannot be removed")
            (self._workplace / _LOCK).unlink()
            self._remove_workplace()
        except OSError as error:
            self._warn_left(error)
        finally:
            os.close(self._lock)

    def _remove_workplace(self) -> None:
        try:
            self._workplace.rmdir()
        except OSError as error:
            # Another run may use it by now, or it is not there, which a read-only disk does not say.
            if error.errno not in (errno.ENOTEMPTY, errno.ENOTDIR) and self._workplace.exists():
                self._warn_left(error)

    def _warn_left(self, error: OSError) -> None:
        _log.warning("%s is left behind: %s", self._workplace, error.strerror or error)


@contextmanager
def output_errors(target: Path, workplace: Path) -> Iterator[None]:
    """Raise TryAgainError, DiskFullError or BadInputError when writing to `target` raises OSError.

    The writing goes by way of `workplace`, a folder on the same disk.
    """
    try:
        yield
    except BlockingIOError as error:
        raise TryAgainError(
            f"another run is writing to {target}", hint="wait until it has ended, or choose another --out"
        ) from error
    except OSError as error:
        if is_full(error, workplace):
            raise DiskFullError(
                f"the disk of {target} is full", hint="make room, or choose an --out on another disk"
            ) from error
        raise BadInputError(
            f"cannot write to {target}: {error.strerror or error}", hint="choose another --out"
        ) from error


@contextmanager
def growing_folder(out: Path, lock: str, ours: Collection[str]) -> Iterator[Path]:
    """Lock a folder that gets its results one by one and keeps them; yield its resolved path.

    `lock` is the path of its lock file, and `ours` are the names that it may have already.

    Raises:
        TryAgainError: another run is writing to it.
        DiskFullError: the disk is full.
        BadInputError: it has other contents, or cannot be written.
    """
    root = Path(os.path.realpath(out))
    with output_errors(root, root):
        if root.is_dir():
            replaces_only(ours)(root)
        elif root.exists():
            raise BadInputError(f"{root} is a file", hint="choose another --out")
        handle = lock_file(root / lock)
        try:
            yield root
        finally:
            (root / lock).unlink(missing_ok=True)
            with suppress(OSError):
                root.rmdir()  # if nothing has been added
            os.close(handle)


def unfinished_outputs(parent: Path) -> list[Path]:
    """Return the output folders in `parent` that runs are writing, or that killed runs left unfinished."""
    return [parent / lock.parent.name[1 : -len(PART)] for lock in sorted(parent.glob(f".*{PART}/{_LOCK}"))]


def clear_leftovers(parent: Path) -> None:
    """Clean up after killed runs in `parent`, except in folders that are in use."""
    for workplace in parent.glob(f".*{PART}"):
        # A run killed just before it took the lock, or after it released it, leaves an empty folder.
        with suppress(OSError):
            workplace.rmdir()
    for target in unfinished_outputs(parent):
        with suppress(TryAgainError), OutputFolder(target, lambda _: None) as output:
            output.discard()
