"""Opens the screen on a rig, and returns when it is closed."""

from capture_app.node.operator.link import RigLink
from capture_app.rig_process import AttachedRig
from capture_app.tui.app import SimulshotApp
from capture_app.tui.pictures.sharp import find_sharp_terminal
from capture_app.tui.settings import Settings


def run_screen(rig: AttachedRig, *, frames: int | None = None) -> None:
    """Show a rig until the user leaves; `frames` of a burst are remembered where they are given."""
    settings = Settings.load()
    if frames is not None:
        settings.remember("shoot.frames", frames)
    link = RigLink(rig.leader)
    SimulshotApp(
        link,
        settings=settings,
        sessions=rig.sessions,
        local=rig.is_local,
        started=rig.started,
        sharp_terminal=find_sharp_terminal(settings.recall("pictures", "local")),
    ).run()
