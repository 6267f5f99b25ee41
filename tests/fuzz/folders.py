"""What readers of files are given: a folder of their own, and a small session in it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec

from capture_app.session.format.burst_plan import PLAN, BurstPlan, CameraPlan
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import fill

Reader = Callable[[bytes, Path], None]


def contents(folder: Path) -> dict[Path, bytes]:
    return {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def small_session(folder: Path) -> Path:
    """A small session, the same every time."""
    if not _kept:
        with SessionWriter.create(folder, "kept") as writer:
            filled = fill(writer).manifest
        made = folder / "kept"
        _kept.update(
            {file.relative_to(made): file.read_bytes() for file in made.rglob("*") if file.is_file()}
        )
        shutil.rmtree(made)
        plan = BurstPlan(
            name=filled.name,
            created=filled.created,
            software=filled.software,
            leader=1,
            number=1,
            burst=filled.burst,
            cameras=tuple(CameraPlan(camera=camera) for camera in filled.cameras),
        )
        _kept[Path(PLAN)] = msgspec.json.encode(plan)
    session = folder / "small"
    for name, data in _kept.items():
        put(session / name, data)
    return session


_kept: dict[Path, bytes] = {}


def put(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
