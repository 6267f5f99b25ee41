"""The signs of the house are true: descriptions of rooms, the page of the architecture, and test folders."""

import re
import runpy
from pathlib import Path

import pytest

from tests.project import ROOT

ROOMS = runpy.run_path(str(ROOT / "docs" / "rooms.py"))
INITS = sorted((*ROOT.glob("capture_app/**/__init__.py"), *ROOT.glob("reconstruction/**/__init__.py")))
WITHOUT_ROOM = {
    "benchmarks",
    "documentation",
    "drivers",
    "readers",
    "end_to_end",
    "fuzz",
    "packaging",
    "samples",
    "slurm",
    "virtual",
}
"""Folders of tests that test no single room of `capture_app`."""


@pytest.mark.parametrize("path", INITS, ids=lambda path: str(path.parent.relative_to(ROOT)))
def test_names_in_the_description_of_a_room_exist(path: Path) -> None:
    code = "\n".join(other.read_text() for other in path.parent.rglob("*.py") if other != path)
    for name in re.findall(r"`([^`]+)`", path.read_text()):
        is_command = name.split()[0] in ("capture-app", "reconstruct")
        is_file = (path.parent / name).exists() or (path.parent / f"{name}.py").exists()
        assert is_command or is_file or re.search(rf"\b{re.escape(name)}\b", code), f"`{name}` in {path}"


MAX_ARROWS = 50


def test_names_on_the_page_of_the_architecture_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    folders = ("capture_app", "reconstruction")
    code = "\n".join(path.read_text() for folder in folders for path in (ROOT / folder).rglob("*.py"))
    missing = []
    for name in re.findall(r"`([^`]+)`", page):
        program, *words = name.split()
        if program in ("capture-app", "reconstruct", "make", "python"):
            found = all(re.search(rf"\b{word}\b", code) or (ROOT / word).exists() for word in words)
            found = found or program == "make"
        elif "/" in name:
            found = (ROOT / name).exists()
        else:
            path = name.replace(".", "/")
            places = (ROOT, ROOT / "capture_app", ROOT / "reconstruction")
            found = any((at / near).exists() for at in places for near in (name, path, f"{path}.py"))
            found = found or re.search(rf"(?<![\w.]){re.escape(name)}\b", code) is not None
        missing += [] if found else [name]
    assert missing == [], "paths are written from the root of the repository"


def test_the_page_lists_each_room() -> None:
    rooms = {room for package in ROOMS["PACKAGES"] for row in ROOMS["layers"](package) for room in row}
    assert ROOMS["described"]().keys() == rooms, "a row for each room of the contracts"


def test_reconstruction_has_few_arrows_between_its_rooms() -> None:
    package = "reconstruction."
    found = {room: others for room, others in ROOMS["imports"]().items() if room.startswith(package)}
    arrows = [
        (room, other) for room, others in found.items() for other in others if other.startswith(package)
    ]
    assert len(arrows) <= MAX_ARROWS, "a room that needs another may be the wrong room"


def test_the_picture_of_the_rooms_is_drawn_from_the_contracts() -> None:
    assert (ROOT / "docs/images/rooms.svg").read_text() == ROOMS["picture"](), "python docs/rooms.py draws it"


def test_a_folder_of_tests_mirrors_a_room() -> None:
    folders = [path for path in (ROOT / "tests").rglob("*") if path.is_dir() and any(path.glob("test_*.py"))]
    strays = []
    for folder in folders:
        _, *parts = folder.relative_to(ROOT / "tests").parts
        if parts[0] in WITHOUT_ROOM:
            continue
        room = ROOT.joinpath(*parts) if parts[0] == "reconstruction" else ROOT.joinpath("capture_app", *parts)
        if not room.is_dir() and not room.with_suffix(".py").exists():
            strays.append(str(folder.relative_to(ROOT)))
    assert strays == []


def test_a_commands_test_is_beside_those_of_other_commands() -> None:
    loose = [path.name for path in (ROOT / "tests").glob("test_*.py")]
    assert loose == [], "each belongs to unit, system or nightly"
