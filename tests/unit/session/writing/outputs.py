"""Output folders that are made, opened and listed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from capture_app.session.files.output_folder import (
    OutputFolder,
    replaces_only,
)


def opened(target: Path, **options: Any) -> OutputFolder:
    return OutputFolder(target, replaces_only({"result", "pictures"}), **options)


def make(target: Path, text: str, meanwhile: Callable[[], object] = lambda: None, **options: Any) -> None:
    with opened(target, **options) as output:
        (output.folder / "result").write_text(text)
        meanwhile()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
