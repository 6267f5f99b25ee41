"""Recipes without a take: the engine takes the burst, and the recipe that comes out gives the same bytes."""

import json
from pathlib import Path

import msgspec
import pytest

from benchmarks.samples.__main__ import run as render_command
from benchmarks.samples.recipe import Trigger, read_recipe
from benchmarks.samples.render import render, same_files
from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.format.manifest import RECIPE
from capture_app.session.reading.verify import verify
from tests.unit.samples.test_render import recipe_of


@pytest.mark.parametrize("trigger", Trigger)
def test_a_recipe_gives_the_same_bytes_again(trigger: Trigger, tmp_path: Path) -> None:
    first = render(recipe_of(trigger=trigger), tmp_path / "a")[0]
    assert verify(first) == []
    assert first.manifest.created == "2026-01-01T00:00:00.000Z"
    assert first.manifest.origin == "simulated"
    render(recipe_of(trigger=trigger), tmp_path / "b")
    assert same_files(first.folder, tmp_path / "b" / "card")
    render(read_recipe(first.folder), tmp_path / "c")
    assert same_files(first.folder, tmp_path / "c" / "card")
    render(recipe_of(trigger=trigger, seed=1), tmp_path / "d")
    assert not same_files(first.folder, tmp_path / "d" / "card")


def test_synchronized_cameras_keep_their_engines_record(tmp_path: Path) -> None:
    manifest = render(recipe_of(), tmp_path)[0].manifest
    for camera in manifest.cameras:
        assert camera.clock is not None
        assert camera.clock.samples > 100
        assert camera.phase is not None
        assert camera.phase.tolerance_ns is not None
    assert max(manifest.sync.spread_ns if manifest.sync else (10**9,)) < 1_000_000
    assert (tmp_path / "card" / "events.ndjson").read_text().count("clock-synced") == 2


def test_replace_says_whether_the_bytes_are_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / RECIPE
    file.write_bytes(msgspec.json.encode(recipe_of()))
    arguments = [str(file), "--out", str(tmp_path), "--json"]
    assert render_command(arguments) == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["sessions"][0]["same_bytes_as_before"] is None
    assert render_command(arguments) == ExitCode.BAD_INPUT  # a session is never overwritten unasked
    assert "exists already" in capsys.readouterr().err
    assert render_command([*arguments, "--replace"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["sessions"][0]["same_bytes_as_before"] is True
    (tmp_path / "card" / "images" / "rig1" / "cam00" / "000000.jpg").write_bytes(b"x")
    assert render_command([*arguments, "--replace"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["sessions"][0]["same_bytes_as_before"] is False
    assert run(["sessions", "verify", str(tmp_path / "card")]) == ExitCode.OK
    assert sorted(path.name for path in tmp_path.iterdir()) == ["card", RECIPE]


def test_a_take_of_another_burst_is_refused(tmp_path: Path) -> None:
    recipe = read_recipe(render(recipe_of(), tmp_path)[0].folder)
    assert recipe.take is not None
    frames = (msgspec.structs.replace(recipe.take.frames[0], instant=7), *recipe.take.frames[1:])
    take = msgspec.structs.replace(recipe.take, frames=frames)
    file = tmp_path / "bad.json"
    file.write_bytes(msgspec.json.encode(msgspec.structs.replace(recipe, take=take)))
    with pytest.raises(BadInputError, match="instant 7"):
        read_recipe(file)
