"""What a library of sessions owes their owner, in histories that are drawn.

Each session is listed under its name with its note, goes to the trash and comes back with its results, and
nothing else is changed or lost.
"""

import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings

from capture_app.common.errors import BadInputError
from capture_app.session.library.changes import (
    TRASH,
    empty_trash,
    rename_session,
    restore_session,
    results_folder,
    set_note,
    trash_session,
    trashed_sessions,
)
from capture_app.session.library.listing import SessionListing
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.histories import histories

NAMES = ("jump", "walk", "throw")


@dataclass
class Known:
    """A session, and the report that was made of it."""

    note: str
    report: str = ""


@dataclass
class Library:
    """A folder of sessions; each method is something that its owner does."""

    root: Path
    template: Path
    sessions: dict[str, Known] = field(default_factory=dict)
    trash: list[tuple[str, str, Known]] = field(default_factory=list)
    """Id, former name and content of each session in the trash, the latest last."""
    made: int = 0

    def __post_init__(self) -> None:
        self.listing = SessionListing(self.root)

    def _report(self, name: str) -> Path:
        return results_folder(self.root / name) / "compare" / "report.html"

    def create(self, number: int) -> None:
        name = NAMES[number % 3]
        if name not in self.sessions:
            shutil.copytree(self.template, self.root / name)
            self.sessions[name] = Known("")
        self.annotate(number)

    def annotate(self, number: int) -> None:
        name = NAMES[number % 3]
        if name in self.sessions:
            self.made += 1
            set_note(self.root / name, f"the {self.made}th")
            self.sessions[name].note = f"the {self.made}th"

    def reconstruct(self, number: int) -> None:
        name = NAMES[number % 3]
        if name in self.sessions:
            self.made += 1
            path = self._report(name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"report {self.made}")
            self.sessions[name].report = f"report {self.made}"

    def rename(self, number: int) -> None:
        name, new = NAMES[number % 3], NAMES[number // 3 % 3]
        if name not in self.sessions:
            return
        if new != name and new in self.sessions:
            with pytest.raises(BadInputError, match="exists already"):
                rename_session(self.root / name, new)
            return
        if new != name and self.sessions[name].report:
            # Results of a session that was deleted by hand.
            self._report(new).parent.mkdir(parents=True, exist_ok=True)
            self._report(new).write_text("left over")
        assert rename_session(self.root / name, new) == self.root / new
        self.sessions[new] = self.sessions.pop(name)
        assert Session.open(self.root / new).name == new

    def discard(self, number: int) -> None:
        name = NAMES[number % 3]
        if name in self.sessions:
            trashed = trash_session(self.root / name)
            assert trashed.id not in [id_ for id_, _, _ in self.trash]
            self.trash.append((trashed.id, name, self.sessions.pop(name)))

    def restore(self, number: int) -> None:
        """The latest, or one by its id; under its name, or another one."""
        entry = self.trash[number % len(self.trash)] if self.trash and number > 4 else None
        chosen = entry or (self.trash[-1] if self.trash else None)
        name = NAMES[number % 3] if number % 2 else chosen[1] if chosen else ""
        which, new = entry[0] if entry else "", name if number % 2 else ""
        if chosen is None or name in self.sessions:
            with pytest.raises(BadInputError):
                restore_session(self.root, which, name=new)
            return
        assert restore_session(self.root, which, name=new) == self.root / name
        self.trash.remove(chosen)
        self.sessions[name] = chosen[2]

    def empty(self, number: int) -> None:
        assert empty_trash(self.root) == len(self.trash)
        self.trash = []

    def check(self) -> None:
        cards = self.listing.read()
        assert [(card.name, card.note, card.state) for card in cards] == [
            (name, known.note, "complete") for name, known in sorted(self.sessions.items())
        ]
        assert [entry.id for entry in trashed_sessions(self.root)] == [id_ for id_, _, _ in self.trash]
        assert [entry.name for entry in trashed_sessions(self.root)] == [name for _, name, _ in self.trash]
        left = {path.name for path in (self.root / TRASH).glob("*")}
        assert left == {id_ for id_, _, _ in self.trash}, "it fills the disk"
        for name, known in self.sessions.items():
            if known.report:
                assert self._report(name).read_text() == known.report


USUAL = ("create", "create", "reconstruct", "rename", "discard", "discard", "restore")
OTHERS = ("annotate", "empty")


@given(history=histories(USUAL, OTHERS, max_steps=20, max_others=1, numbers=9))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_each_session_keeps_its_name_its_note_and_its_results(
    session: Session, history: list[tuple[str, int]]
) -> None:
    # What a power cut leaves is tested where files are written.
    with TemporaryDirectory() as root, patch.object(os, "fsync"):
        library = Library(Path(root), session.folder)
        for step, number in history:
            getattr(library, step)(number)
            library.check()
        for name in library.sessions:
            assert verify(Session.open(library.root / name)) == []
