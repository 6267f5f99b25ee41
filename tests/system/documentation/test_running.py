"""The blocks of commands of pages, run as the shell scripts that they are, beside a simulated rig."""

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec
import pytest

from tests.project import ROOT, SAMPLES
from tests.unit.documentation import stand_in
from tests.unit.documentation.pages import PAGES, blocks
from tests.waiting import until

RUN_BY_EVERY_CHANGE = ("README", "first-rig", "python", "trouble")
"""Pages that a newcomer reads first; tests/nightly runs the others."""
CASES = {
    f"{page.parent.name}-{page.stem}": page
    for page in PAGES
    if not all(block.not_run for block in blocks(page))
}


World = tuple[Path, dict[str, str]]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """A folder with samples and commands, in which a rig of two simulated cameras runs."""
    folder = tmp_path_factory.mktemp("world")
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("capture-app", "reconstruct", "pip", "make"):
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {stand_in.__file__} {name} "$@"\n')
        (programs / name).chmod(0o755)
    shutil.copytree(SAMPLES, folder / "sample_sessions")
    # What the rig takes is elsewhere: the sessions of a page are samples, under its names for them.
    rigs = folder / "rig"
    rigs.mkdir()
    folders = {
        "XDG_STATE_HOME": folder / "state",
        "XDG_DATA_HOME": folder / "data",
        "XDG_CONFIG_HOME": folder / "config",
    }
    environment = {
        **os.environ,
        **{name: str(path) for name, path in folders.items()},
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "DOCUMENTED_SAMPLES": str(SAMPLES),
        "DOCUMENTED_LEADER": "",
    }
    options = ("--host", "127.0.0.1", "--port", "0", "--json")
    cameras = ("--camera", stand_in.CAMERA, "--camera", stand_in.CAMERA)
    rig = subprocess.Popen(
        [sys.executable, "-m", "capture_app.cli", "leader", *options, *cameras],
        cwd=rigs, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert rig.stdout is not None
    leader = msgspec.json.decode(rig.stdout.readline())["leader"]
    # Until commands without --leader find it, too.
    status = [programs / "capture-app", "status"]
    find = partial(subprocess.run, status, env=environment, capture_output=True, check=False)
    asyncio.run(until(lambda: find().returncode == 0))
    yield folder, {**environment, "DOCUMENTED_LEADER": leader}
    rig.send_signal(signal.SIGTERM)
    rig.communicate()


@pytest.mark.parametrize("name", [name for name, page in CASES.items() if page.stem in RUN_BY_EVERY_CHANGE])
def test_a_pages_blocks_run(name: str, world: World) -> None:
    run_page(CASES[name], world)


def run_page(page: Path, world: World) -> None:
    """Run all blocks of a page that are not marked as not run. Raises AssertionError where one fails."""
    folder, environment = world
    # What another page has done to its sessions is not this one's.
    shutil.rmtree(folder / "sessions", ignore_errors=True)
    (folder / "sessions").mkdir()
    for block in blocks(page):
        if block.not_run:
            continue
        shell = subprocess.Popen(
            ["bash", "-eu", "-o", "pipefail", "-c", block.script],
            cwd=folder, env=environment, start_new_session=True, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            printed, _ = shell.communicate(timeout=500)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGTERM)
        print(printed)
        assert shell.returncode == 0, f"{page.name}:{block.line}\n{block.script}\n---\n{printed}"
