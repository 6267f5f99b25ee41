"""Build the site of the documentation, strictly, in build/site: the repository's pages, linked as they are.

README is its first page; the references come from the commands and the docstrings.
"""

import base64
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from capture_app.cli import app as capture_app
from reconstruction.cli import app as reconstruct

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {"capture-app": capture_app, "reconstruct": reconstruct}
HELP_WIDTH = 80
PAGES = ("CONTRIBUTING.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md", "SECURITY.md", "LICENSE")


def stage(folder: Path) -> None:
    """Copy the pages and their pictures into a folder of their own."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    for name in (*PAGES, "sample_sessions/README.md"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    shutil.copyfile(ROOT / "README.md", folder / "index.md")
    for path in (folder / "docs" / "notebooks").glob("*.ipynb"):
        page = as_markdown(json.loads(path.read_text()), path.parent, path.stem)
        path.with_suffix(".md").write_text(page)
        path.unlink()
    commands = folder / "docs" / "commands.md"
    told = (line for name, command in COMMANDS.items() for line in describe(command, name))
    commands.write_text(commands.read_text() + "".join(told))
    # Where the repository shows notebooks, the site has pages of them.
    shown = folder / "docs" / "python.md"
    shown.write_text(shown.read_text().replace(".ipynb)", ".md)"))


def describe(command: click.Command, path: str, parent: click.Context | None = None) -> Iterator[str]:
    """A command's help as a section, and those of the commands below it."""
    own = {**command.context_settings, "terminal_width": HELP_WIDTH, "max_content_width": HELP_WIDTH}
    context = click.Context(command, parent=parent, info_name=path.rpartition(" ")[2], **own)
    yield f"\n{'#' * min(4, path.count(' ') + 2)} {path}\n\n```text\n{command.get_help(context)}\n```\n"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from describe(below, f"{path} {name}", context)


def as_markdown(notebook: dict[str, Any], pictures: Path, stem: str) -> str:
    """The notebook as a page; its pictures are written into a folder."""
    parts = []
    for number, cell in enumerate(notebook["cells"]):
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for place, output in enumerate(cell.get("outputs", ())):
            if output["output_type"] == "stream":
                parts.append(f"```text\n{''.join(output['text'])}```")
            else:
                file = pictures / f"{stem}-{number}-{place}.png"
                file.write_bytes(base64.b64decode(output["data"]["image/png"]))
                parts.append(f"![What the cell above draws]({file.name})")
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """Stage and build; return the exit code, which is not 0 where a link or a name leads nowhere."""
    stage(ROOT / "build" / "docs")
    command = [str(Path(sys.executable).with_name("zensical")), "build", "--clean", "--strict"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode  # noqa: S603 - our own pages


if __name__ == "__main__":
    sys.exit(main())
