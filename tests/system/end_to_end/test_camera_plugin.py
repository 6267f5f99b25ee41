"""A package outside the tree adds a camera: the module of docs/plugins.md as it is written there."""

import asyncio
import json
import re
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.project import ROOT
from tests.system.end_to_end.rig import burst, lead, output
from tests.unit.documentation.pages import plugin_module

from .conftest import Start

GUIDE = ROOT / "docs" / "plugins.md"
BROKEN = "broken_camera", "raise RuntimeError('it is Friday')"
FAILING = (
    "failing_camera",
    """
SPEC, HELP, NEEDS, OPTIONS, open_camera = "failing:ID", "Cameras that fail.", "a firmware update", {}, print

def list_cameras():
    raise OSError("the bus is on fire")
""",
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where Python finds the packages of the test."""
    section = GUIDE.read_text().partition("\n## A camera\n")[2].partition("\n## ")[0]
    module, (entry,) = plugin_module(section), re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    group, name, target = re.search(r'"(.+?)"\]\n(\w+) = "(\w+)"', entry).groups()
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    install(tmp_path, target, module, f"[{group}]\n{name} = {target}\n")
    return tmp_path


def install(folder: Path, module: str, code: str, entry_points: str) -> None:
    """Write a module and its package's metadata, as an installer does."""
    (folder / f"{module}.py").write_text(code)
    metadata = folder / f"{module}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)


@pytest.mark.usefixtures("folder")
async def test_a_camera_of_another_package_is_listed_and_takes_a_burst(start: Start, tmp_path: Path) -> None:
    (help_text, listed), (_, leader) = await asyncio.gather(
        asyncio.gather(*[output(await start("cameras", option)) for option in ("--help", "--json")]),
        lead(start, tmp_path / "sessions"),
    )
    assert "acme:NUMBER[,fps=RATE]" in help_text
    cameras = json.loads(listed)["cameras"]
    assert {"spec": "acme:0", "kind": "acme", "model": "Acme 0", "detail": "64x48", "usable": True} in cameras
    node = await start("node", "--name", "a", "--camera", "acme:0,fps=24.7", "--leader", leader)
    await node.says("ready")
    session = Session.open(Path((await burst(start, leader, "--frames", "2"))["session"]))
    assert verify(session) == []
    (camera,) = session.manifest.cameras
    assert (camera.facts.kind, camera.facts.period_ns) == ("acme", round(1e9 / 24.7))
    assert len(session.manifest.images) == 2


async def test_an_option_that_a_plugin_does_not_have_is_refused(folder: Path, start: Start) -> None:
    node = await start("node", "--camera", "acme:0,zoom=2", "--leader", "127.0.0.1:9")
    await node.says("acme cameras have no option 'zoom' (there are fps)")
    assert await node.process.wait() == ExitCode.BAD_INPUT


async def test_a_plugin_that_is_broken_is_named_and_the_others_work(folder: Path, start: Start) -> None:
    for kind, (module, code) in {"broken": BROKEN, "failing": FAILING}.items():
        install(folder, module, code, f"[simulshot.cameras]\n{kind} = {module}\n")
    command = await start("cameras", "--json")
    specs = {camera["spec"] for camera in json.loads(await output(command))["cameras"]}
    assert {"acme:0", "sim:pi"} <= specs
    broken, failing = command.said
    assert "the plugin 'broken' of simulshot.cameras does not load: it is Friday" in broken
    assert "broken_camera" in broken
    assert "the driver of failing cameras cannot list them: the bus is on fire" in failing
    used = await start("node", "--camera", "broken:0", "--leader", "127.0.0.1:9")
    await used.says("the plugin 'broken' of simulshot.cameras does not load: it is Friday")
    assert await used.process.wait() == ExitCode.NOT_AVAILABLE
