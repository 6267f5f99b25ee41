"""Stands in for `reconstruct compare`: quick, and as the words after the session say.

SESSION [say LINE] [wait FILE] [fail] [flood LINES] [priority] [write FILE] --out DIR --json
"""

import json
import os
import sys
import time
from pathlib import Path


def print_help() -> None:
    """Print options of which some are below the end of a dialog, one as wide as the lines may be."""
    print("Usage: quick\n\nOptions:\n" + "  --more".ljust(int(os.environ["COLUMNS"]) - 2, "."))
    print("\n".join("  --pace N" for _ in range(40)))


def main() -> None:
    from capture_app.session.files.output_folder import OutputFolder, replaces_only  # for no help

    words = iter(sys.argv[1:])
    out = Path(sys.argv[sys.argv.index("--out") + 1])
    with OutputFolder(out, replaces_only(["metrics.json", "splat.json"])) as output:
        for word in words:
            if word == "say":
                print(next(words), file=sys.stderr, flush=True)
            elif word == "wait":
                path = Path(next(words))
                while not path.exists():
                    time.sleep(0.01)
            elif word == "write":
                (output.folder / next(words)).write_text("{}")
            elif word == "priority":
                print(f"priority {os.nice(0)}", file=sys.stderr, flush=True)
            elif word == "flood":
                for number in range(int(next(words))):
                    print(f"line {number}", file=sys.stderr)
            elif word == "fail":
                sys.exit("quick: error: the burst has one instant only")
        metrics = {"verdict": "It is [bold]much[/bold] better. So it is."}
        (output.folder / "metrics.json").write_text(json.dumps(metrics))
    print(metrics["verdict"])


if __name__ == "__main__":
    (print_help if "--help" in sys.argv else main)()
