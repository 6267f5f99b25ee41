"""Benchmarks by name: `python -m benchmarks NAME [ARGUMENTS]` runs one, without a name it lists them."""

import os
import sys
import tomllib
from pathlib import Path

BENCHES = tomllib.loads(Path(__file__).with_name("benches.toml").read_text("utf-8"))


def main() -> None:
    """Run the named benchmark as a program, or print a line for each, as of `make help`."""
    if len(sys.argv) == 1:
        for name, bench in BENCHES.items():
            needs = f" BENCH={bench['needs']}" if "needs" in bench else ""
            print(f"make bench NAME={name}{needs}   {bench['does']}")
        return
    name, *arguments = sys.argv[1:]
    if name not in BENCHES:
        sys.exit(f"there is no NAME={name}: see make help")
    bench = BENCHES[name]
    arguments = [*bench.get("always", []), *(arguments or bench.get("otherwise", []))]
    os.execv(sys.executable, [sys.executable, "-m", bench["module"], *arguments])  # noqa: S606 - our own module


if __name__ == "__main__":
    main()
