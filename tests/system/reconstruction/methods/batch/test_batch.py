"""`reconstruct batch`: its units, what it does with those that fail, and its summary."""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session
from reconstruction.common.matchers import Matcher
from reconstruction.methods.batch import workers
from reconstruction.methods.batch.batch_plan import DEPTH_TASK, BatchPlan
from reconstruction.methods.batch.batch_run import batch, exit_code, summarize
from reconstruction.methods.batch.units import Shard, run_unit
from reconstruction.methods.batch.workers import Workers
from reconstruction.scene.conditions import Condition
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, make_view, write_session
from tests.unit.reconstruction.methods.batch.fake_units import FAKE_TASK
from tests.unit.reconstruction.methods.batch.test_batch import (
    here,  # noqa: F401 - a fixture
    run,  # noqa: F401 - a fixture
)

FAILING = "tests.unit.reconstruction.methods.batch.fake_units:compute_or_fail"


def test_real_units_in_processes_and_nothing_twice(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    asked = (boards.folder, "--instants", 2, "--condition", "synced", "--condition", 66, "--out", out)
    printed = reconstruct("batch", *asked, "--json")
    result = printed.result
    assert (result["computed"], result["reused"], result["failed"]) == (2, 0, 0)
    assert [line[:5] for line in printed.err.splitlines()] == ["[1/2]", "[2/2]"]
    assert "left" in printed.err.splitlines()[0]
    synced, offset = result["groups"]
    assert synced["mover_within_2pct"] > 0.5 > 0.1 > offset["mover_within_2pct"]
    assert abs(synced["static_within_2pct"] - offset["static_within_2pct"]) < 0.5
    for row in result["units"]:
        assert (out / row["folder"] / "fused.ply").stat().st_size > 1000
    page = (out / "summary.html").read_text()
    assert page.count("data:image/webp") == 2
    for row in result["units"]:
        assert f'href="{row["picture"]}"' in page
        assert (out / row["picture"]).stat().st_size > 1000
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    printed = reconstruct("batch", *asked)
    assert printed.out.splitlines()[0] == "0 computed, 2 reused, 0 failed"
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_what_no_depth_can_be_made_of_is_not_applicable_and_no_failure(
    run: Callable[..., Any], boards: Session, scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    apart = {"left": VIEWS["left"], "away": make_view((0.1, 0, 0), yaw=58)}
    strangers = write_session(tmp_path / "strangers", scene, apart, instants=1, truth=False)
    lonely = write_session(tmp_path / "lonely", scene, {"left": VIEWS["left"]}, instants=1, truth=False)
    asked = ("batch", strangers.folder, lonely.folder, "--out", tmp_path / "none")
    first, again = reconstruct(*asked), reconstruct(*asked)
    assert "boards, instant 0, synced: not applicable: " in first.err
    assert "not applicable: the session has one camera only (left)" in first.err
    # A result as any other: it is not computed again.
    assert "reusing 1 of 1 results" in again.err
    for printed in (first, again):
        assert printed.code == ExitCode.BAD_INPUT
        assert "nothing could be computed" in printed.err
        assert printed.out.splitlines()[0] == "0 computed, 0 reused, 0 failed, 2 not applicable"
    beside = run(sessions=[boards.folder, lonely.folder], instants=(0,))
    assert (beside.result.computed, beside.result.failed, beside.result.not_applicable) == (1, 0, 1)
    assert exit_code(beside.result) is ExitCode.OK
    assert "1 unit computed, 1 not applicable" in (beside.out / "summary.html").read_text()


def test_units_that_fail_leave_the_others_alone(
    run: Callable[..., Any], boards: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions = [boards.folder, boards.folder / "nowhere"]
    with monkeypatch.context() as patch:
        patch.setattr(workers, "CONNECT_S", 1e-9)  # a scheduler of its own may take long to start
        done = run(workers=Workers(jobs=1), task=FAILING, sessions=sessions)
    problems = {row.instant: row.error for row in done.result.units}
    assert problems[0] == "ValueError: unheard of in two lines"
    assert "its process died twice" in problems[1]
    assert " is full (make room" in problems[2]
    assert "memory" in problems[3]
    assert problems[4] == ""
    assert "no session at" in problems[None]
    assert (done.result.computed, done.result.failed) == (1, 5)
    assert exit_code(done.result) is ExitCode.INCOMPLETE
    assert sum("failed: " in line for line in done.lines) == 5
    assert not list(done.out.rglob("*.part"))
    # Only what failed is tried again.
    again = run(task=FAKE_TASK)
    assert (again.result.computed, again.result.reused, again.result.failed) == (4, 1, 0)
    assert exit_code(again.result) is ExitCode.OK


def test_a_key_is_of_all_that_the_result_depends_on(boards: Session, tmp_path: Path) -> None:
    def keys(
        folder: Path = boards.folder,
        condition: str = "synced",
        matcher: Matcher = Matcher.SWEEP,
        program: str = "1",
        shifts_ms: Mapping[str, float] | None = None,
    ) -> Any:
        options = BatchPlan(
            conditions=(Condition.parse(condition),),
            matcher=matcher,
            program=program,
            time_shifts_ms=shifts_ms or {},
        )
        units, _ = options.units(folder)
        return [unit.key for unit in units]

    first = keys()
    assert len(set(first)) == 5
    assert keys() == first
    copied = shutil.copytree(boards.folder, tmp_path / "elsewhere" / boards.folder.name)
    assert keys(copied) == first
    assert keys(matcher=Matcher.AUTO) == first
    assert not set(keys(matcher=Matcher.PATCHMATCH)) & set(first)
    assert not set(keys(shifts_ms={"right": PERIOD_NS / 1e6})) & set(first)
    assert not set(keys(condition="0,0,0")) & set(first)
    truth = boards.ground_truth("left", 1)
    assert truth is not None
    (copied / truth.relative_to(boards.folder)).write_bytes(b"other")
    assert [a == b for a, b in zip(keys(copied), first, strict=True)] == [True, False, True, True, True]
    (copied / "calibration.json").unlink()
    assert not set(keys(copied)) & set(first)
    assert not set(keys(program="another version")) & set(first)


def test_a_damaged_image_is_no_input_of_its_instant_and_spoils_no_other(
    boards: Session, tmp_path: Path
) -> None:
    """Before, what moves at the instants beside it could not be seen, so that these failed, too."""
    copied = shutil.copytree(boards.folder, tmp_path / boards.folder.name)
    image = copied / boards.image_file(boards.images_by_instant()[0]["left"]).relative_to(boards.folder)
    data = bytearray(image.read_bytes())
    data[-20] ^= 1
    image.write_bytes(data)
    units, _ = BatchPlan(instants=(0, 1)).units(copied)
    outcomes = [run_unit(DEPTH_TASK, unit, tmp_path / "out") for unit in units]
    assert [outcome.exit_code for outcome in outcomes] == [ExitCode.INCOMPLETE, ExitCode.OK]
    assert "is damaged" in outcomes[0].error
    result = json.loads((tmp_path / "out" / units[1].folder / "unit.json").read_bytes())
    assert result["changed_pictures"] == [str(image)]


def test_a_summary_names_what_is_not_computed_yet(boards: Session, here: Workers, tmp_path: Path) -> None:
    options = BatchPlan(instants=(0, 1))
    batch([boards.folder], tmp_path / "out", options, here, FAKE_TASK, Shard(1, 2))
    found = summarize([boards.folder], tmp_path / "out", options)
    assert [row.error for row in found.units] == ["", "it is not computed yet"]
    assert exit_code(found) is ExitCode.INCOMPLETE
    assert (tmp_path / "out" / "summary.html").is_file()
