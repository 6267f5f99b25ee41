"""Build the site of the documentation, strictly, in build/site: the repository's pages, linked as they are.

README is its first page; the references come from the commands and the docstrings.
"""

import shutil
import subprocess
import sys
from pathlib import Path

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


def main() -> int:
    """Stage and build; return the exit code, which is not 0 where a link or a name leads nowhere."""
    stage(ROOT / "build" / "docs")
    command = [str(Path(sys.executable).with_name("zensical")), "build", "--clean", "--strict"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode  # noqa: S603 - our own pages


if __name__ == "__main__":
    sys.exit(main())
