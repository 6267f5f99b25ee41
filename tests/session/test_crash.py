"""Pulled plugs, flipped bits and full disks: what was confirmed is never lost, and every lie is noticed."""

import asyncio
import errno
import json
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from capture_app.errors import DiskFullError, SimulshotError
from capture_app.node.leader.repair import repair
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import JOURNAL, MANIFEST, BurstRecord
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter

from .conftest import camera_record, jpeg

ROOT = Path(__file__).resolve().parents[2]
PERIOD_NS = 33_000_000
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def killed(root: Path, mode: str, *numbers: int) -> list[dict[str, Any]]:
    script = Path(__file__).with_name("killed_writer.py")
    command = [sys.executable, str(script), str(root), mode, *map(str, numbers)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def judge(runs: list[dict[str, Any]], least: int) -> None:
    assert len(runs) >= least
    assert any(run["ended"] == -9 and run["promised"] for run in runs), "none was killed in the middle"
    for run in runs:
        assert (run["lost"], run["lies"]) == ([], []), run


def test_a_writer_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 3, 100, 29), 8)


def test_a_writer_killed_at_some_moments_loses_nothing(tmp_path: Path) -> None:
    judge([*killed(tmp_path, "moments", 1, 8), *killed(tmp_path, "steps", 101, 1, 1)], 9)


def test_a_repair_killed_at_some_steps_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 151, 1, 1, 13), 3)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "steps", 1, 10_000, 1), 200)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_writer_killed_at_200_random_moments_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "moments", random.SystemRandom().randrange(10**6), 200), 200)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_repair_killed_at_every_step_loses_nothing(tmp_path: Path) -> None:
    judge(killed(tmp_path, "repairs", 17, 30, 9, 1), 500)


# A session with everything in it


class Take:
    """Two cameras, three instants, each with a picture, truth, events, a plan and a calibration."""

    names = ("cam0", "cam1")
    instants = 3

    def __init__(self, root: Path) -> None:
        self.folder = root / "take"
        self.confirmed: dict[tuple[str, int], bytes] = {}

    def begin(self) -> SessionWriter:
        writer = SessionWriter.create(self.folder.parent, self.folder.name)
        plan = BurstPlan(
            name="take",
            created=writer.created,
            software=writer.software,
            leader=1,
            number=1,
            burst=self.burst,
            cameras=tuple(CameraPlan(camera=camera_record(name)) for name in self.names),
        )
        try:
            writer.set_plan(plan)
        except DiskFullError:
            writer.discard()
            raise
        return writer

    @property
    def burst(self) -> BurstRecord:
        return BurstRecord(
            instants_ns=tuple(PERIOD_NS * n for n in range(self.instants)), period_ns=PERIOD_NS
        )

    def add(self, writer: SessionWriter, name: str, instant: int) -> None:
        data = jpeg(instant)
        writer.add_ground_truth(name, instant, b"truth" * 99, PERIOD_NS * instant)
        writer.add_image(data, camera=name, instant=instant, leader_ns=PERIOD_NS * instant, gain=0.1)
        self.confirmed[name, instant] = data

    def end(self, writer: SessionWriter) -> Session:
        camera = CameraCalibration(
            width=16,
            height=12,
            fx=9.0,
            fy=9.0,
            cx=8.0,
            cy=6.0,
            rotation=IDENTITY,
            translation=(0.0, 0.0, 0.0),
        )
        writer.set_calibration(Calibration(cameras={"cam0": camera}))
        writer.add_event({"event": "joined"}, {"event": "clock-synced", "offset_ns": 12})
        cameras = [camera_record(name) for name in self.names]
        return writer.finish(cameras, self.burst, origin="simulated", note="a note")

    def write(self) -> Session:
        writer = self.begin()
        for instant in range(self.instants):
            for name in self.names:
                self.add(writer, name, instant)
        return self.end(writer)

    def check_repaired(self) -> Session:
        """Repair, and see that all that was confirmed is there as it was, and that nothing lies."""
        results = asyncio.run(repair(self.folder, wait_s=0, host="127.0.0.1", port=0, on_news=lambda _: None))
        assert results[0].ok, results
        session = Session.open(self.folder)
        assert verify(session) == []
        images = {(image.camera, image.instant): image for image in session.manifest.images}
        for of, data in self.confirmed.items():
            assert session.image_file(images[of]).read_bytes() == data
        return session


def noticed(folder: Path) -> bool:
    try:
        return bool(verify(Session.open(folder)))
    except SimulshotError:
        return True


def flipped_bits(folder: Path, places: Callable[[int], Iterator[int]]) -> list[str]:
    """Flip one bit after the other, and return those that nobody noticed."""
    silent = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        data = path.read_bytes()
        for place in places(8 * len(data)):
            changed = bytearray(data)
            changed[place // 8] ^= 1 << place % 8
            path.write_bytes(changed)
            if not noticed(folder):
                silent.append(f"{path.name} bit {place}")
        path.write_bytes(data)
    return silent


def test_flipped_bits_are_noticed_wherever_they_are(tmp_path: Path) -> None:
    session = Take(tmp_path).write()
    assert verify(session) == []
    chance = random.Random(1)
    assert flipped_bits(session.folder, lambda bits: iter(chance.sample(range(bits), 12))) == []
    assert verify(session) == []


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_flipped_bit_is_noticed(tmp_path: Path) -> None:
    session = Take(tmp_path).write()
    assert flipped_bits(session.folder, lambda bits: iter(range(bits))) == []


def test_a_journal_cut_anywhere_in_its_last_line_is_noticed_and_repaired(tmp_path: Path) -> None:
    take = Take(tmp_path)
    journal = take.write().folder / JOURNAL
    data = journal.read_bytes()
    begin = data.rindex(b"\n", 0, -1) + 1
    for length in range(begin, len(data)):
        journal.write_bytes(data[:length])
        assert noticed(take.folder), length
        if length % 64 == 0 or length > len(data) - 2:
            take.check_repaired()
            assert journal.read_bytes() == data


def test_a_torn_journal_of_an_unfinished_session_costs_one_image(tmp_path: Path) -> None:
    take = Take(tmp_path)
    writer = take.begin()
    for instant in range(3):
        take.add(writer, "cam0", instant)
    writer.abort()
    journal = take.folder / JOURNAL
    data = journal.read_bytes()
    for cut in (1, 2, 100, len(data) - data.rindex(b"\n", 0, -1) - 1):
        journal.write_bytes(data[:-cut])
        for gone in (MANIFEST, "checksums.sha256"):
            (take.folder / gone).unlink(missing_ok=True)
        kept = take.confirmed.copy()
        # Without its newline the last line may be whole, and then it counts.
        if cut > 1:
            del take.confirmed["cam0", 2]
        session = take.check_repaired()
        assert len(session.manifest.images) == len(take.confirmed)
        take.confirmed = kept
        aside = take.folder / "set_aside/images/rig1/cam0/000002.jpg"
        if cut > 1:
            aside.replace(take.folder / "images/rig1/cam0/000002.jpg")


def test_damaged_images_are_set_aside_and_said_to_be_lost(tmp_path: Path) -> None:
    take = Take(tmp_path)
    take.write()
    file = take.folder / "images/rig1/cam0/000001.jpg"
    file.write_bytes(b"scribble")
    del take.confirmed["cam0", 1]
    session = take.check_repaired()
    (gone,) = session.manifest.missing
    assert (gone.camera, gone.instant) == ("cam0", 1)
    assert "damaged" in gone.reason
    assert (take.folder / "set_aside/images/rig1/cam0/000001.jpg").read_bytes() == b"scribble"


def test_a_disk_that_is_full_once_at_any_call_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every write, sync, rename and folder fails once for want of room; then it is tried again."""
    names = ("write", "fsync", "fdatasync", "replace", "mkdir", "posix_fallocate")
    real = {name: getattr(os, name) for name in names}
    real["fsync"] = real["fdatasync"] = lambda _: None  # what a sync costs is not at stake here
    step = failed = 0
    while True:
        step += 1
        left = step

        def fail(name: str, *arguments: Any, **options: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                if name == "write":
                    real["write"](arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
                raise OSError(errno.ENOSPC, "No space left on device")
            return real[name](*arguments, **options)

        take = Take(tmp_path / str(step))
        for name in names:
            monkeypatch.setattr(os, name, lambda *a, name=name, **k: fail(name, *a, **k))
        errors = retrying(take)
        monkeypatch.undo()
        assert verify(Session.open(take.folder)) == [], step
        assert len(take.confirmed) == 6
        failed += errors
        if left > 0:
            break
    assert failed > 60


def retrying(take: Take) -> int:
    """Write a session and do again what fails because the disk is full; how often that was."""
    errors = 0

    def again(work: Callable[[], Any]) -> Any:
        nonlocal errors
        try:
            return work()
        except DiskFullError:
            errors += 1
            return work()

    writer = again(take.begin)
    for instant in range(take.instants):
        for name in take.names:
            again(lambda name=name, instant=instant: take.add(writer, name, instant))
    again(lambda: take.end(writer))
    return errors


def test_on_a_disk_that_is_really_full_nothing_confirmed_is_lost(
    small_disk: Callable[[int], Path],
) -> None:
    full = finished = 0
    for pages in range(1, 90):
        root = small_disk(pages)
        take = Take(root)
        writer = None
        try:
            writer = take.begin()
            for instant in range(take.instants):
                for name in take.names:
                    take.add(writer, name, instant)
            take.end(writer)
            finished += 1
        except DiskFullError as error:
            full += "is full" in str(error)
            if writer is not None and take.confirmed:
                # The room that was reserved lets the session be finished with what it has, all the same.
                missing_at_least_one(take, writer)
            elif writer is not None:
                writer.abort()
        small_disk(1000)
        if take.folder.exists() and (take.folder / "burst.json").exists():
            take.check_repaired()
        else:
            assert not take.confirmed
        subprocess.run(["umount", str(root)], check=True)
    assert full > 30
    assert finished > 5


def missing_at_least_one(take: Take, writer: SessionWriter) -> None:
    from capture_app.session.format.manifest import MissingImage

    cameras = [camera_record(name) for name in take.names]
    every = ((name, instant) for name in take.names for instant in range(take.instants))
    gaps = [
        MissingImage(camera=name, instant=instant, reason="the leader's disk is full")
        for name, instant in every
        if (name, instant) not in take.confirmed
    ]
    session = writer.finish(cameras, take.burst, gaps, origin="simulated")
    assert verify(session) == []
    assert len(session.manifest.images) == len(take.confirmed)
