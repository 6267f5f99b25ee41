"""The wall: without any wing, and without all but the simulated camera, everything else still runs."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.unit.packaging.cut_tree import WINGS, CutTree
from tests.unit.packaging.test_deletion import (
    COMPANIONS,
    OTHERS,
    tree,  # noqa: F401 - a fixture
)

SIM = "capture_app/plugins/cameras/sim"
ALL_BUT_SIM = [wing for wing in WINGS if wing != SIM]
PLUGINS = [wing for wing in OTHERS if wing != SIM]
EVERY_HELP = """
import click, capture_app.cli, reconstruction.cli
def show(command, context):
    if not command.hidden:
        print(command.get_help(context))
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            one = command.get_command(context, name)
            show(one, click.Context(one, info_name=name, parent=context))
for name, app in (("capture-app", capture_app.cli.app), ("reconstruct", reconstruction.cli.app)):
    show(app, click.Context(app, info_name=name))
"""
EVERY_IMPORT = """
import pkgutil, capture_app, reconstruction
for package in (capture_app, reconstruction):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if module.name == "capture_app.common.system.windows":
            continue
        __import__(module.name)
"""
TAKE = """
import asyncio, json, sys
from pathlib import Path
from capture_app import open_session
from capture_app.commands.demo import QUICK, capture
written = asyncio.run(capture(Path(sys.argv[1]), 2, lambda line: None))
session = open_session(written.folder)
print(json.dumps({"session": str(written.folder), "images": len(session.manifest.images), "quick": QUICK}))
"""
SCREEN = """
import asyncio
from tests.unit.tui.driving import make_app, settle, until
from tests.unit.tui.fake_rig import FakeRig
async def look():
    app = make_app(FakeRig(1))
    async with app.run_test(size=(200, 40)) as pilot:
        for mode in "34":
            await pilot.press(mode)
            await settle(pilot)
            await until(pilot, lambda: app.screen.query_one("#footer").plain)
            print(*(strip.text for strip in app.screen._compositor.render_strips()), sep="\\n")
        print(*(command.title for command in app.get_system_commands(app.screen)), sep="\\n")
asyncio.run(look())
"""
UNSAID = {
    "capture_app/companions/characterize": ("characterize",),
    "capture_app/companions/exporting": ("\n  export  ", "capture-app sessions export"),
    "capture_app/companions/importing": ("\n  import  ",),
    "capture_app/companions/link": ("\n  link  ",),
    "capture_app/companions/monitor": ("capture-app monitor", "\n  monitor  "),
    "capture_app/companions/panel": ("--panel", "capture-app panel", "\n  panel  "),
    "capture_app/companions/phones": ("--phones", "capture-app phones", "\n  phones  "),
    "capture_app/companions/softwaresync": ("\n  softwaresync  ",),
}
"""What the help says of each companion, and does not say without it."""


def name_of(gone: Sequence[str]) -> str:
    return gone[0].rpartition("/")[2] if len(gone) == 1 else f"{len(gone)} wings"


@pytest.mark.parametrize("gone", [*([wing] for wing in COMPANIONS), ALL_BUT_SIM], ids=name_of)
def test_no_help_speaks_of_a_companion_that_is_gone(tree: CutTree, gone: Sequence[str]) -> None:
    done = tree.run(gone, "-c", EVERY_HELP)
    assert (done.returncode, done.stderr) == (0, "")
    said = {wing for wing, words in UNSAID.items() if any(word in done.stdout for word in words)}
    assert said == {*UNSAID} - {*gone}


@pytest.mark.parametrize(
    ("wing", "words"),
    [("exporting", {"e exports", "Export"}), ("importing", {"I imports", "Import", "import a folder"})],
)
def test_the_screen_offers_no_command_that_is_gone(tree: CutTree, wing: str, words: set[str]) -> None:
    whole = tree.run([], "-c", SCREEN)
    done = tree.run([f"capture_app/companions/{wing}"], "-c", SCREEN)
    assert (done.returncode, done.stderr) == (whole.returncode, whole.stderr) == (0, "")
    assert [word for word in words if word in done.stdout or word not in whole.stdout] == []


def test_every_module_imports_with_the_simulated_camera_alone(tree: CutTree) -> None:
    done = tree.run(ALL_BUT_SIM, "-c", EVERY_IMPORT)
    assert (done.returncode, done.stderr) == (0, "")


# Not each companion alone: an import contract keeps all else, and other companions, from importing one.
@pytest.mark.parametrize("gone", [PLUGINS, ALL_BUT_SIM], ids=name_of)
def test_a_rig_takes_and_its_session_is_read(tree: CutTree, gone: Sequence[str], tmp_path: Path) -> None:
    done = tree.run(gone, "-c", TAKE, tmp_path / "sessions")
    assert (done.returncode, done.stderr) == (0, "")
    taken = json.loads(done.stdout)
    assert taken["images"] == 10
    options = () if "reconstruction/methods/multiview" in gone else taken["quick"]
    out = tmp_path / "out"
    done = tree.run(gone, "-m", "reconstruction.cli", "compare", taken["session"], *options, "--out", out)
    assert done.returncode == 0, done.stderr
