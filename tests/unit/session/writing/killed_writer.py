"""A writer that is killed again and again, and repaired; prints what each run left as a line of JSON.

    -m tests.unit.session.writing.killed_writer ROOT steps FIRST COUNT EVERY
    -m tests.unit.session.writing.killed_writer ROOT batches FIRST COUNT EVERY
    -m tests.unit.session.writing.killed_writer ROOT videos FIRST COUNT EVERY
    -m tests.unit.session.writing.killed_writer ROOT repairs FIRST COUNT EVERY EVERY_IN_REPAIR
    -m tests.unit.session.writing.killed_writer ROOT moments SEED COUNT

`steps` kills before, and in the middle of, each call that changes the disk; `batches` does so where images
are saved several at a time, as a leader does that receives them; `videos` does where they are frames that are
added to videos; `repairs` kills the repair of a
killed writer so; `moments` sends SIGKILL at random times. Each run is a forked child of this one process.
"""

import asyncio
import functools
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.machine.repair import repair
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import PLAN, BurstPlan, CameraPlan
from capture_app.session.format.manifest import (
    MANIFEST,
    BurstRecord,
    CameraRecord,
    ImageRecord,
    image_path,
)
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import Problem, verify
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.session_writer import SessionWriter
from tests.facts import make_facts
from tests.project import ROOT

CAMERAS, INSTANTS, PERIOD_NS = 2, 4, 33_000_000
NAME = "killed"
CHANGING = (
    "write", "fsync", "fdatasync", "replace", "mkdir", "unlink", "rmdir", "truncate", "ftruncate",
    "posix_fallocate", "rename",
)  # fmt: skip


def picture(camera: int, instant: int) -> bytes:
    return hashlib.sha256(b"%d %d" % (camera, instant)).digest() * 300


def write(root: Path, confirmed: int, threads: int = 1, *, how: str = "images") -> None:
    """Write a session, and tell on a pipe which images are promised to be safe."""
    writer = SessionWriter.create(root, NAME)
    facts = make_facts(width=8, height=8, period_ns=PERIOD_NS)
    cameras = tuple(CameraRecord(name=f"cam{number}", facts=facts) for number in range(CAMERAS))
    burst = BurstRecord(instants_ns=tuple(PERIOD_NS * n for n in range(INSTANTS)), period_ns=PERIOD_NS)
    plan = BurstPlan(
        name=NAME, created=writer.created, software=writer.software, leader=1, number=1, burst=burst,
        cameras=tuple(CameraPlan(camera=camera) for camera in cameras),
    )  # fmt: skip
    writer.set_plan(plan)

    def add(mine: int) -> None:
        for instant in range(INSTANTS):
            for camera in range(CAMERAS):
                if (instant * CAMERAS + camera) % threads == mine:
                    name, at_ns = f"cam{camera}", PERIOD_NS * instant
                    data = picture(camera, instant)
                    writer.add_image(
                        data, camera=name, instant=instant, leader_ns=at_ns, truth=b"truth", true_ns=at_ns
                    )
                    REAL["write"](confirmed, bytes((camera, instant)))

    ways: dict[str, Callable[[], None]] = {
        "images": lambda: add(0),
        "batches": lambda: add_batches(writer, confirmed),
        "videos": lambda: add_frames(writer, confirmed),
    }
    workers = [threading.Thread(target=add, args=(mine,)) for mine in range(1, threads)]
    for worker in workers:
        worker.start()
    ways[how]()
    for worker in workers:
        worker.join()
    writer.add_event({"event": "done"})
    writer.finish(cameras, burst, origin="simulated")
    REAL["write"](confirmed, b"\xff\xff")


def add_batches(writer: SessionWriter, confirmed: int) -> None:
    """Save the images of two instants at a time."""
    for instant in range(0, INSTANTS, 2):
        batch = [(camera, instant + n) for n in range(2) for camera in range(CAMERAS)]
        writer.save([received(*of) for of in batch])
        REAL["write"](confirmed, b"".join(bytes(of) for of in batch))


def add_frames(writer: SessionWriter, confirmed: int) -> None:
    """Save two frames of a camera's video at a time."""
    for instant in range(0, INSTANTS, 2):
        for camera in range(CAMERAS):
            batch = [(camera, instant), (camera, instant + 1)]
            writer.save([new_frame(*of) for of in batch], in_videos=True)
            REAL["write"](confirmed, b"".join(bytes(of) for of in batch))


def received(camera: int, instant: int) -> StoredImage:
    """An image with its ground truth."""
    return StoredImage(record_of(camera, instant), picture(camera, instant), b"truth", PERIOD_NS * instant)


def new_frame(camera: int, instant: int) -> StoredImage:
    return StoredImage(record_of(camera, instant), picture(camera, instant), true_ns=PERIOD_NS * instant)


def record_of(camera: int, instant: int) -> ImageRecord:
    data, name = picture(camera, instant), f"cam{camera}"
    return ImageRecord(
        camera=name, instant=instant, path=image_path(name, instant), leader_ns=PERIOD_NS * instant,
        bytes=len(data), sha256=hashlib.sha256(data).hexdigest(),
    )  # fmt: skip


REAL: dict[str, Any] = {name: getattr(os, name) for name in CHANGING if hasattr(os, name)}


def die_at(step: int, further: Sequence[tuple[Any, str]] = ()) -> None:
    """Kill this process at the n-th change of the disk: odd steps before it, even ones half-way through.

    `further` names functions of other modules that change the disk too.
    """
    left = step

    def deadly(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal left
            left -= 2
            if left <= 0:
                if left == 0 and name == "write":
                    REAL["write"](arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
                elif left == 0:
                    real(*arguments, **options)
                os.kill(os.getpid(), 9)
            return real(*arguments, **options)

        return call

    for name in REAL:
        setattr(os, name, deadly(name, REAL[name]))
    for module, name in further:
        setattr(module, name, deadly(name, getattr(module, name)))


def run(work: Callable[[int], None], kill_after_s: float | None = None) -> tuple[int, bytes]:
    """Run in a child, and return how it ended and what it told."""
    if not hasattr(os, "fork"):
        pytest.skip("Windows cannot fork")
    reading, telling = os.pipe()
    child = os.fork()
    if not child:
        status = 1
        try:
            os.close(reading)
            work(telling)
            status = 0
        finally:
            os._exit(status)
    os.close(telling)
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        os.kill(child, signal.SIGKILL)
    told = b""
    while block := os.read(reading, 4096):
        told += block
    os.close(reading)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), told


def mend(root: Path) -> None:
    asyncio.run(repair(root / NAME, wait_s=0, address=Address("127.0.0.1", 0), log=Log()))


def mending_until(step: int, root: Path) -> Callable[[int], None]:
    def work(pipe: int) -> None:
        die_at(step)
        mend(root)

    return work


def judge(root: Path, status: int, told: bytes) -> dict[str, Any]:
    """What the run left: promised images that are gone or other than they were, and lies."""
    promised = {(told[n], told[n + 1]) for n in range(0, len(told), 2)} - {(255, 255)}
    folder = root / NAME
    result: dict[str, Any] = {
        "ended": status,
        "promised": len(promised),
        "lost": [],
        "lies": [],
        "state": "nothing",
    }
    if not (folder / PLAN).exists():
        result["lost"] = sorted(promised)
        return result
    if status == 0 and not (folder / MANIFEST).exists():
        result["lies"] = ["no manifest after the end"]
    mend(root)
    session = Session.open(folder)
    there = {(image.camera, image.instant): image for image in session.manifest.images}
    for camera, instant in sorted(promised):
        image = there.get((f"cam{camera}", instant))
        if image is None or session.image_bytes(image) != picture(camera, instant):
            result["lost"] = [*result["lost"], (camera, instant)]
    result["lies"] = [*result["lies"], *(str(lie) for lie in verify(session) if not no_picture(lie))]
    result["state"] = "finished"
    result["images"] = len(there)
    return result


def no_picture(lie: Problem) -> bool:
    """The images of this test are no pictures, which is the one thing that verify may say of them."""
    return lie.kind == "unreadable" and "decoded" in lie.what


def tell(step: object, result: dict[str, Any]) -> None:
    print(json.dumps({"step": step, **result}), flush=True)


def results_of(module: str, *arguments: object) -> list[dict[str, Any]]:
    """Run a module of this folder in a process of its own, and return what it told."""
    command = [sys.executable, "-m", f"tests.unit.session.writing.{module}", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def killed_at(step: int, root: Path, how: str = "images") -> Callable[[int], None]:
    def work(pipe: int) -> None:
        die_at(step)
        write(root, pipe, how=how)

    return work


def kill_steps(root: Path, first: int, count: int, every: int, *, how: str = "images") -> None:
    for step in range(first, first + count * every, every):
        shutil.rmtree(root / NAME, ignore_errors=True)
        status, told = run(killed_at(step, root, how))
        tell(step, judge(root, status, told))
        if status == 0:
            break


def kill_repairs(root: Path, first: int, count: int, every: int, every_in_repair: int) -> None:
    for writer_step in range(first, first + count * every, every):
        for step in range(1, 1000, every_in_repair):
            shutil.rmtree(root / NAME, ignore_errors=True)
            status, told = run(killed_at(writer_step, root))
            if status == 0 or not (root / NAME / PLAN).exists():
                break
            status, _ = run(mending_until(step, root))
            tell([writer_step, step], judge(root, status, told))
            if status == 0:
                break


def kill_moments(root: Path, seed: int, count: int) -> None:
    chance = random.Random(seed)
    shutil.rmtree(root / NAME, ignore_errors=True)
    began_s = time.monotonic()
    assert run(lambda pipe: write(root, pipe, 3))[0] == 0
    whole_s = time.monotonic() - began_s
    for number in range(count):
        shutil.rmtree(root / NAME, ignore_errors=True)
        moment_s = chance.uniform(0, 1.2 * whole_s)
        status, told = run(lambda pipe: write(root, pipe, 3), moment_s)
        tell(number, judge(root, status, told))


if __name__ == "__main__":
    mode = {
        "steps": kill_steps,
        "batches": functools.partial(kill_steps, how="batches"),
        "videos": functools.partial(kill_steps, how="videos"),
        "repairs": kill_repairs,
        "moments": kill_moments,
    }[sys.argv[2]]
    mode(Path(sys.argv[1]), *map(int, sys.argv[3:]))  # type: ignore[operator]
