"""Where results made from a session lie: the one place that decides it.

    ROOT/_results/<session>/<kind>        what `reconstruct` made
    ROOT/_results/<session>/<kind>.log    what it said meanwhile

No session can be called `_results`: names begin with a letter or a digit.
"""

import shutil
from contextlib import suppress
from pathlib import Path

from capture_app.session.files.durable import move_folder

RESULTS = "_results"


def results_folder(session: Path, root: Path | None = None) -> Path:
    """The folder for the results made from a session.

    `root` is the folder of sessions that is worked in: a session from elsewhere, such as a bundled sample,
    has its results there too, since its own place may be read-only or another program's.
    """
    root = session.parent if root is None else root
    if session.parent.resolve() == root.resolve():
        return root / RESULTS / session.name
    return root / RESULTS / f"_{session.parent.name}" / session.name


def move_results(session: Path, target: Path) -> None:
    """Let a session's results follow it to its new name; results without a session there are removed."""
    move_result_folder(results_folder(session), results_folder(target))


def move_result_folder(folder: Path, target: Path) -> None:
    """Move a folder of results in place of what is left of another's; stays where it is on an error."""
    if not folder.is_dir():
        return
    with suppress(OSError):
        if target.exists():
            shutil.rmtree(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        move_folder(folder, target)
