"""A copy of both packages that wings are taken from, with the entry points that are then left."""

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

from tests.project import ROOT

ENTRIES: dict[str, dict[str, str]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "entry-points"
]
PLACES = (
    "capture_app/plugins/cameras",
    "capture_app/plugins/programs",
    "capture_app/plugins/footage",
    "capture_app/companions",
    "reconstruction/methods",
    "reconstruction/checks",
)
"""Folders outside the wall; a wing is a folder or a module directly in one of them."""
WINGS = sorted(
    str(path.relative_to(ROOT).with_suffix(""))
    for place in PLACES
    for path in (ROOT / place).iterdir()
    if not path.name.startswith("_") and (path.suffix == ".py" or (path / "__init__.py").is_file())
)


def wing_of(target: str) -> str | None:
    """The wing that an entry point leads to; None if it leads into the core."""
    module = target.partition(":")[0].replace(".", "/") + "/"
    return next((wing for wing in WINGS if module.startswith(wing + "/")), None)


class CutTree:
    """A copy of the packages in a folder; each run is without some wings."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for package in ("capture_app", "reconstruction"):
            shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))

    def run(self, gone: Sequence[str], *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run Python in the tree without the wings `gone`."""
        about, aside = self.folder / "simulshot-1.dist-info", self.folder / "aside"
        about.mkdir(exist_ok=True)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: simulshot\nVersion: 1\n")
        lines = []
        for group, entries in ENTRIES.items():
            left = [f"{name} = {target}" for name, target in entries.items() if wing_of(target) not in gone]
            lines += [f"[{group}]", *left]
        (about / "entry_points.txt").write_text("\n".join(lines))
        moves = []
        for wing in gone:
            path = self.folder / wing
            path = path if path.is_dir() else path.with_suffix(".py")
            moves.append((path, aside / path.relative_to(self.folder)))
        try:
            for path, away in moves:
                away.parent.mkdir(parents=True, exist_ok=True)
                path.rename(away)
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(self.folder), *sys.path))}
            environment.pop("PYTHONDONTWRITEBYTECODE", None)
            command = [sys.executable, *map(str, arguments)]
            return subprocess.run(command, env=environment, cwd=self.folder, capture_output=True, text=True)
        finally:
            for path, away in moves:
                if away.exists():
                    away.rename(path)
