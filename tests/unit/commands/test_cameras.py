"""`capture-app cameras`: what it asks of a rig, and what it says."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from capture_app.commands.cameras import cameras
from capture_app.common.camera_facts import CameraControls
from capture_app.rig import rig_link
from tests.unit.tui.fake_rig import FakeRig


@pytest.mark.parametrize(
    "typed",
    [
        ("controls",),
        ("set", "exposure=4000", "gain=auto", "--camera", "Böhm"),
        ("set", "--profile", "night.json"),
        ("match", "Böhm"),
    ],
)
def test_the_rig_is_asked_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, typed: tuple[str, ...]
) -> None:
    status, asked, told = FakeRig(2).status(), [], dict[str, Any]()
    first, *others = status.nodes
    nodes = (replace(first, camera=replace(first.camera, label="Böhm")), *others)

    async def ask_status(_: object) -> Any:
        asked.append(1)
        return replace(status, nodes=nodes)

    async def ask_camera(_: object, name: str, values: Any) -> CameraControls:
        told[name] = values
        return CameraControls()

    monkeypatch.setattr(rig_link, "ask_status", ask_status)
    monkeypatch.setattr(rig_link, "_ask_camera", ask_camera)
    monkeypatch.chdir(tmp_path)
    Path("night.json").write_text(json.dumps({node.name: {"gain": 2} for node in nodes}))
    done = CliRunner().invoke(cameras, [*typed, "--leader", "127.0.0.1:1"], catch_exceptions=False)
    assert len(asked) == 1
    assert "Böhm" in done.stdout, "a camera is shown by its label"
    if typed[0] == "set":
        only = {"exposure": 4000.0, "gain": "auto"}
        assert told == ({"cam00": only} if "Böhm" in typed else {node.name: {"gain": 2} for node in nodes})
