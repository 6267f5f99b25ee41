"""A rename, a note, a move to the trash and back, each killed again and again; prints what each kill left.

    -m tests.unit.session.writing.killed_changes ROOT CHANGE EVERY

CHANGE is rename, note, trash or restore. Kills at every so many steps, with a file system that can exchange
folders and with one that cannot, and then does the same again without a kill, as a user would.
"""

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from capture_app.common import system
from capture_app.common.errors import BadInputError
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.session.library import changes
from capture_app.session.library.changes import TRASH
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.session.writing.killed_writer import NAME, die_at, no_picture, run, tell, write

NEW, NOTE = "renamed", "the second jump"


def rename(root: Path) -> None:
    if not (root / NEW).exists():
        changes.rename_session(root / NAME, NEW)


def note(root: Path) -> None:
    changes.set_note(root / NAME, NOTE)


def to_trash(root: Path) -> None:
    if (root / NAME).exists():
        changes.trash_session(root / NAME)


def restore(root: Path) -> None:
    if not (root / NAME).exists():
        changes.restore_session(root)


CHANGES = {"rename": rename, "note": note, "trash": to_trash, "restore": restore}


def killed_at(
    step: int, root: Path, change: Callable[[Path], None], exchanges: bool
) -> Callable[[int], None]:
    def work(pipe: int) -> None:
        if not exchanges:
            system.exchange = lambda path, other: False
        die_at(
            step,
            [
                (system, "exchange"),
                (changes, "move_folder"),
                (os, "link"),
            ],
        )
        change(root)

    return work


def whole_sessions(root: Path) -> dict[str, Session]:
    """The sessions in the folder and in its trash, each of which must be whole."""
    clear_leftovers(root)
    found = {}
    for folder in [*root.iterdir(), *root.glob(f"{TRASH}/*/session")]:
        try:
            session = Session.open(folder)
        except BadInputError:
            continue
        wrong = [str(lie) for lie in verify(session) if not no_picture(lie)]
        assert not wrong, wrong
        found[str(folder.relative_to(root))] = session
    return found


def judge(root: Path, change: Callable[[Path], None]) -> dict[str, Any]:
    left = whole_sessions(root)
    change(root)
    after = whole_sessions(root)
    ((where, session),) = after.items()
    return {
        "left": {name: [session.name, session.manifest.note] for name, session in left.items()},
        "after": [where, session.name, session.manifest.note],
        "hidden": sorted(str(path.relative_to(root)) for path in root.glob(".*.part/*")),
    }


def main(root: Path, change: str, every: int) -> None:
    (root / "made").mkdir(parents=True)
    with (root / "promises").open("wb") as promises:
        write(root / "made", promises.fileno())
    if change == "restore":
        changes.trash_session(root / "made" / NAME)
    for exchanges in (True, False):
        for step in range(1, 10_000, every):
            shutil.rmtree(root / "tried", ignore_errors=True)
            shutil.copytree(root / "made", root / "tried")
            status, _ = run(killed_at(step, root / "tried", CHANGES[change], exchanges))
            tell([exchanges, step], {"ended": status, **judge(root / "tried", CHANGES[change])})
            if status == 0:
                break


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
