"""Thirty folders of recordings as strangers have them: what is typed, what is found, and how right it is.

Rendered clips (simulated) of 6 s at known offsets that are no whole frames, each folder imported by
`capture-app sessions import FOLDER` without an option: python -m benchmarks.sessions.folders
"""

import io
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from benchmarks.report import new_parser, print_report, print_rows
from capture_app.cli import run
from capture_app.session.format.common_times import REFERENCE
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.strangers import FOLDERS, MIDDLE_NS, Folder, true_offset_ms

COLUMNS = {
    "folder": ("folder", ""),
    "files": ("files", ""),
    "camera": ("camera", ""),
    "by": ("by", ""),
    "offset_ms": ("offset ms", ".2f"),
    "bar_ms": ("bar ms", ".2f"),
    "truth_ms": ("truth ms", ".2f"),
    "held": ("held", ""),
    "lines": ("lines", ""),
    "said": ("said, code", ""),
}


def main() -> None:
    """Import all folders and print a row for each camera except the reference."""
    parser = new_parser(__doc__)
    parser.add_argument("--only", metavar="WORDS", default="", help="folders whose name has these words")
    options = parser.parse_args()
    names = [name for name in FOLDERS if options.only in name]
    rows = [row for name in names for row in _import(name, FOLDERS[name])]
    print_report({"rows": rows}, lambda found: print_rows(found["rows"], COLUMNS), as_json=options.json)


def _import(name: str, folder: Folder) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as temporary:
        root, out = Path(temporary) / "footage", Path(temporary) / "out"
        printed, talk = io.StringIO(), io.StringIO()
        path = folder.make(root)
        with redirect_stdout(printed), redirect_stderr(talk):
            code = run(["sessions", "import", str(path), "--out", str(out)])
        sessions = [Session.open(one.folder) for one in list_sessions(out)] if out.is_dir() else []
        lines = talk.getvalue().splitlines()
        files = sum(path.is_file() for path in root.rglob("*"))
        said = f"{_last(lines, temporary)}, {code}"
        # A terminal shows progress as a bar in one line.
        shown = [line for line in (*printed.getvalue().splitlines(), *lines) if not line.startswith("[")]
        about = {"folder": name, "files": files, "lines": len(shown), "said": said}
        return [about | row for row in _offsets(folder, sessions)] or [about]


def _offsets(folder: Folder, sessions: Sequence[Session]) -> Iterator[dict[str, Any]]:
    for session in sessions:
        times = session.manifest.burst.common_times
        for camera, of in times.cameras.items() if times else ():
            if of.source == REFERENCE:
                continue
            truth_ms = true_offset_ms(folder, camera, times.reference if times else "")
            offset_ms = (of.leader_from_local(MIDDLE_NS) - MIDDLE_NS) / 1e6
            bar_ms = (of.uncertainty_at_ns(MIDDLE_NS) or 0) / 1e6
            held = "yes" if abs(offset_ms - truth_ms) <= bar_ms else "NO"
            figures = {"offset_ms": offset_ms, "bar_ms": bar_ms, "truth_ms": truth_ms}
            yield {"camera": f"{session.name}: {camera}", "by": of.source, "held": held, **figures}


def _last(lines: Sequence[str], temporary: str) -> str:
    """Return the last line of the output, which is the next command, without this machine's folder."""
    return lines[-1].replace(f"{temporary}/", "") if lines else ""


if __name__ == "__main__":
    main()
