"""The one output folder: killed, refused, out of room or doubled, there is always one whole result."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskFullError, SimulshotError, TryAgainError
from capture_app.session.files.output_folder import (
    OutputFolder,
    clear_leftovers,
    replaces_nothing,
)
from tests.project import ROOT
from tests.unit.session.writing.killed_writer import results_of
from tests.unit.session.writing.outputs import make, names, opened


def test_a_result_replaces_one_with_a_page_of_an_earlier_version(tmp_path: Path) -> None:
    make(tmp_path / "out", "old")
    (tmp_path / "out" / "walk.html").touch()
    make(tmp_path / "out", "new")
    assert names(tmp_path / "out") == ["result"]


def test_a_result_replaces_its_like(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    with opened(out) as output:
        (output.folder / "pictures").mkdir()
        (output.folder / "pictures" / "one").write_text("1")
    make(out, "second")
    assert (out / "result").read_text() == "second"
    assert names(out) == ["result"]
    assert names(out.parent) == ["out"]


def test_an_error_and_a_discarded_result_change_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    make(out, "first")
    with pytest.raises(ZeroDivisionError):
        make(out, "half", lambda: 1 // 0)
    with opened(out) as output:
        output.discard()
    assert (out / "result").read_text() == "first"
    assert names(tmp_path) == ["out"]


def test_a_file_is_shown_early_where_no_earlier_result_is(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def show(output: OutputFolder, text: str) -> tuple[bool, list[str]]:
        (output.folder / "result").write_text(text)
        return output.show_early("result"), names(out)

    with suppress(ZeroDivisionError), opened(out) as output:
        assert show(output, "half") == (True, ["result"])
        raise ZeroDivisionError
    assert names(tmp_path) == []
    out.mkdir()
    (out / "result").write_text("what a killed run had shown")
    with opened(out) as output:
        (output.folder / "pictures").mkdir()
        for text, first in (("half", True), ("more", False)):
            assert show(output, text) == (first, ["result"])
            assert (out / "result").read_text() == text
    assert names(out) == ["pictures", "result"]
    with opened(out) as output:
        assert show(output, "other") == (False, ["pictures", "result"])
        assert (out / "result").read_text() == "more"
        output.discard()
    assert (out / "result").read_text() == "more"
    assert names(tmp_path) == ["out"]


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    make(tmp_path / "real", "first")
    (tmp_path / "link").symlink_to("real")
    make(tmp_path / "link", "second")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "result").read_text() == "second"
    assert names(tmp_path) == ["link", "real"]


def test_somebody_elses_files_are_never_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis").write_text("mine")
    with pytest.raises(BadInputError, match=r"other files \(thesis\)"):
        opened(out)
    with pytest.raises(BadInputError, match="exists already"):
        OutputFolder(out, replaces_nothing)
    with pytest.raises(BadInputError, match="is a file"):
        opened(out / "thesis")
    # What comes there while the run works is not replaced either.
    with pytest.raises(BadInputError, match=r"other files \(thesis\)"):
        make(tmp_path / "late", "new", lambda: out.rename(tmp_path / "late"))
    assert names(tmp_path / "late") == ["thesis"]
    hidden = tmp_path / ".late.part"
    (hidden / "new").mkdir(parents=True)
    (hidden / "letters").write_text("mine")
    (tmp_path / "late" / "thesis").unlink()
    with pytest.raises(BadInputError, match=r"not of this program \(it holds letters\)"):
        make(tmp_path / "late", "new")
    assert names(hidden) == ["letters", "new"]


def test_a_second_run_is_refused_at_once_or_waits(tmp_path: Path) -> None:
    out = tmp_path / "out"
    waiting = "import sys; from tests.unit.session.writing.outputs import make, Path; " \
        "make(Path(sys.argv[1]), 'second', wait=True)"  # fmt: skip
    with opened(out) as output:
        with pytest.raises(TryAgainError, match=f"another run is writing to {out}"):
            make(out, "second")
        clear_leftovers(tmp_path)
        (output.folder / "result").write_text("first")
        child = subprocess.Popen([sys.executable, "-c", waiting, str(out)], cwd=ROOT)
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(1)
    assert child.wait(60) == 0
    assert (out / "result").read_text() == "second"
    assert names(tmp_path) == ["out"]


def killed(root: Path, every: int, every_in_next: int) -> list[dict[str, Any]]:
    runs = results_of("killed_output", root, every, every_in_next)
    assert any(one["ended"] == -9 for one in runs)
    assert any(one["ended"] == 0 for one in runs)
    assert [one for one in runs if one["wrong"]] == []
    return runs


def test_a_run_killed_within_another_is_mended(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    make(tmp_path / "out", "first")
    inner = tmp_path / ".out.part" / ".new.part"
    (inner / "new").mkdir(parents=True)
    (inner / "lock").touch()
    (tmp_path / ".out.part" / "lock").touch()
    (tmp_path / ".out.part" / "new").mkdir()
    with opened(tmp_path / "out") as output:
        make(output.folder, "second")
    assert (tmp_path / "out" / "result").read_text() == "second"
    assert names(tmp_path) == ["out"]
    assert "removed what a run that was killed had left" in caplog.text


def test_leftovers_of_all_targets_in_a_folder(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("one", "two"):
        place = tmp_path / f".{name}.part"
        (place / "new").mkdir(parents=True)
        (place / "lock").touch()
    (tmp_path / ".one.part" / "earlier").mkdir()
    (tmp_path / ".one.part" / "earlier" / "result").write_text("first")
    (tmp_path / ".three.part").mkdir()
    (tmp_path / ".letters.part").mkdir()
    (tmp_path / ".letters.part" / "mine").touch()
    clear_leftovers(tmp_path)
    assert names(tmp_path) == [".letters.part", "one"]
    assert (tmp_path / "one" / "result").read_text() == "first"
    assert [word in caplog.text for word in (".one.part", ".two.part", "restored")] == [True] * 3


@pytest.mark.parametrize("exchanges", [True, False])
def test_a_system_call_that_fails_once_costs_at_most_the_new_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, exchanges: bool
) -> None:
    """Every sync, rename and removal is refused once."""
    calls = [(os, name) for name in ("fsync", "rename", "mkdir", "unlink", "rmdir")]
    if not exchanges:
        monkeypatch.setattr(system, "exchange", lambda one, other: False)
    else:
        calls.append((system, "exchange"))
    left = 0
    words = set()

    def fail(real: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
        nonlocal left
        left -= 1
        if left == 0:
            raise PermissionError(1, "Operation not permitted")
        return real(*arguments, **more)

    for step in range(1, 1000):
        out = tmp_path / str(step) / "out"
        make(out, "first")
        left = step
        caplog.clear()
        with monkeypatch.context() as faults:
            for module, name in calls:
                faults.setattr(module, name, partial(fail, getattr(module, name)))
            try:
                make(out, "second")
                least = "second"
            except SimulshotError as error:
                least = "first"
                words.add(error.what.rpartition(": ")[2])
        assert (out / "result").read_text() in {least, "second"}
        if names(out.parent) != ["out"]:
            assert f"{out.parent / '.out.part'} is left behind" in caplog.text
        make(out, "third")
        assert (out / "result").read_text() == "third"
        assert names(out.parent) == ["out"]
        if left > 0:
            break
    assert step > 12
    assert words == {"Operation not permitted"}


def test_a_full_disk_keeps_the_earlier_result(small_disk: Callable[[int], Path]) -> None:
    out = small_disk(30) / "out"
    make(out, "first")
    with pytest.raises(DiskFullError, match=f"the disk of {out} is full"):
        make(out, "second" * 100_000)
    assert (out / "result").read_text() == "first"
    assert names(out.parent) == ["out"]
    small_disk(1000)
    make(out, "third")
    assert (out / "result").read_text() == "third"


@pytest.fixture
def frozen(tmp_path: Path) -> Iterator[Callable[[str], None]]:
    """Forbid ("+i") and allow ("-i") the file system to change the names in tmp_path."""

    def change(how: str) -> None:
        try:
            subprocess.run(["chattr", how, str(tmp_path)], capture_output=True, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"folders cannot be made immutable here: {error}")

    yield change
    change("-i")


def test_a_rename_that_is_refused_keeps_the_earlier_result(
    tmp_path: Path, frozen: Callable[[str], None], caplog: pytest.LogCaptureFixture
) -> None:
    make(tmp_path / "out", "first")
    with pytest.raises(BadInputError, match=r"cannot write to .*out: Operation not permitted"):
        make(tmp_path / "out", "second", lambda: frozen("+i"))
    assert (tmp_path / "out" / "result").read_text() == "first"
    assert ".out.part is left behind" in caplog.text
    with pytest.raises(BadInputError, match=r"cannot write to .*other: Operation not permitted"):
        make(tmp_path / "other", "third")
    frozen("-i")
    make(tmp_path / "out", "third")
    assert (tmp_path / "out" / "result").read_text() == "third"
    assert names(tmp_path) == ["out"]


def test_where_nothing_could_be_made_nothing_is_said_to_be_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Linux refuses to remove even what is not there, if the file system is mounted read-only."""

    def refuse(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "mkdir", refuse)
    monkeypatch.setattr(Path, "rmdir", refuse)
    with pytest.raises(BadInputError, match=r"cannot write to .*out: Read-only file system"):
        make(tmp_path / "out", "first")
    assert not caplog.text


def test_a_mount_point_is_refused_before_any_work(small_disk: Callable[[int], Path]) -> None:
    with pytest.raises(BadInputError, match="is a mount point"):
        opened(small_disk(30))
