"""Build the site of the documentation, strictly, in build/site: the repository's pages, linked as they are.

README is its first page; the references come from the commands and the docstrings.
"""

import base64
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
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
    # Where the repository shows notebooks, the site has pages of them.
    shown = folder / "docs" / "python.md"
    shown.write_text(shown.read_text().replace(".ipynb)", ".md)"))


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
