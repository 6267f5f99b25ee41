"""`reconstruct batch --cluster slurm` on a real SLURM of one machine (make test KIND=slurm)."""

import json
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.nightly.drivers.slurm.cluster import cluster, why_not
from tests.project import ROOT
from tests.unit.reconstruction.conftest import VIEWS, Board, Scene, jump, texture, write_session

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module", autouse=True)
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with cluster(tmp_path_factory.mktemp("slurm")) as conf, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLURM_CONF", str(conf))
        patch.setenv("PYTHONPATH", str(ROOT))
        yield


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    still, moving = (
        Board((-9, -9, 9, 9), 4.0, texture(1)),
        Board((-0.3, -0.3, 0.3, 0.3), 2.2, texture(5), jump),
    )
    views = {name: VIEWS[name] for name in ("left", "right")}
    return write_session(tmp_path_factory.mktemp("sessions"), Scene([still, moving]), views, instants=4)


def start(session: Session, out: Path, *more: str) -> "subprocess.Popen[str]":
    command = [
        sys.executable, "-m", "reconstruction.cli", "batch", str(session.folder), "--out", str(out), "--json",
        "--cluster", "slurm", "--cluster-setting", "memory=500MB", *more,
    ]  # fmt: skip
    return subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def queue() -> list[str]:
    command = ["squeue", "--me", "--noheader", "--array", "--format=%i"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def queue_empties() -> None:
    while queue():
        time.sleep(0.2)


def results(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and "work" not in path.relative_to(out).parts
    }


def test_the_cluster_makes_the_same_bytes_as_this_machine(session: Session, tmp_path: Path) -> None:
    asked = ["--instants", "0-1", "--condition", "synced", "--condition", "66"]
    running = start(session, tmp_path / "there", *asked, "--jobs", "2")
    printed, talk = running.communicate()
    assert running.returncode == 0, talk
    assert json.loads(printed)["computed"] == 4
    assert [line[:5] for line in talk.splitlines()] == ["[1/4]", "[2/4]", "[3/4]", "[4/4]"]
    # With one process, which then has all cores of this machine, as the jobs of this SLURM have.
    here = [sys.executable, "-m", "reconstruction.cli", "batch", str(session.folder), *asked]
    subprocess.run(
        [*here, "--jobs", "1", "--out", str(tmp_path / "here")], cwd=ROOT, check=True, capture_output=True
    )
    assert results(tmp_path / "here") == results(tmp_path / "there")


def test_a_command_that_is_killed_leaves_no_jobs_and_is_resumed(session: Session, tmp_path: Path) -> None:
    out = tmp_path / "out"
    running = start(session, out, "--jobs", "1")
    while not list(out.glob("units/*/*/unit.json")):
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    running.kill()
    running.communicate()
    queue_empties()
    before = {path: path.stat().st_ino for path in out.glob("units/*/*/unit.json")}
    again = start(session, out)
    printed, talk = again.communicate()
    assert again.returncode == 0, talk
    result = json.loads(printed)
    assert result["computed"] + result["reused"] == 4
    assert result["reused"] >= len(before) >= 1
    assert {path: path.stat().st_ino for path in out.glob("units/*/*/unit.json")}.items() >= before.items()


def test_an_interrupt_cancels_the_jobs(session: Session, tmp_path: Path) -> None:
    running = start(session, tmp_path / "out", "--jobs", "1")
    while not list(tmp_path.glob("out/units/*/.*")):
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    talk = running.communicate()[1]
    assert running.returncode == 130
    assert "results are saved; repeat the command to compute the others" in talk
    queue_empties()


def test_a_job_that_is_ended_costs_no_unit(session: Session, tmp_path: Path) -> None:
    running = start(session, tmp_path / "out", "--jobs", "2")
    while not list(tmp_path.glob("out/units/*/.*")):
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    subprocess.run(["scancel", sorted(queue())[-1]], check=True)
    printed, talk = running.communicate()
    assert running.returncode == 0, talk
    assert json.loads(printed)["computed"] == 4
    queue_empties()


def test_a_setting_that_slurm_has_not(session: Session, tmp_path: Path) -> None:
    running = start(session, tmp_path / "out", "--cluster-setting", "queue=nowhere")
    talk = running.communicate()[1]
    assert running.returncode == 1
    assert talk.startswith("reconstruct: error: slurm refused the jobs: ")
    assert len(talk.splitlines()) == 1
    assert "nowhere" in talk
    assert not queue()


def test_a_setting_that_jobs_do_not_have(session: Session, tmp_path: Path) -> None:
    running = start(session, tmp_path / "out", "--cluster-setting", "partition=test")
    talk = running.communicate()[1]
    assert running.returncode == 3
    assert len(talk.splitlines()) == 1
    assert "partition" in talk


def test_an_array_of_shards_makes_the_same_bytes_as_one_command(session: Session, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "reconstruction.cli", "batch", str(session.folder), "--jobs", "1"]
    subprocess.run([*command, "--out", str(tmp_path / "here")], cwd=ROOT, check=True, capture_output=True)
    there = [*command, "--out", str(tmp_path / "there")]
    script = f"{shlex.join(there)} --shard $SLURM_ARRAY_TASK_ID/3"
    array = [
        "sbatch",
        "--wait",
        "--array=1-3",
        "--mem=500MB",
        f"--output={tmp_path}/%a.log",
        "--wrap",
        script,
    ]
    done = subprocess.run(array, cwd=ROOT, text=True, capture_output=True, check=False)
    logs = "".join(path.read_text() for path in tmp_path.glob("*.log"))
    assert done.returncode == 0, done.stderr + logs
    assert len(list(tmp_path.glob("there/units/*/*/unit.json"))) == 4
    subprocess.run([*there, "--summary"], cwd=ROOT, check=True, capture_output=True)
    assert results(tmp_path / "here") == results(tmp_path / "there")
