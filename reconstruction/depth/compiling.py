"""Compilation of `SOURCES` when simulshot is installed (`hatch_build.py`); imports no other module of it.

`python reconstruction/depth/compiling.py` compiles them in a checkout.
"""

import os
import platform
import shutil
import subprocess
import sys
import zlib
from importlib.util import find_spec
from pathlib import Path

SOURCE = Path(__file__).with_name("kernels.c")
VIEWS = Path(__file__).with_name("views.c")
GAUSSIANS = Path(__file__).with_name("gaussians.c")
SOURCES = (SOURCE, VIEWS, GAUSSIANS)
TARGET = "SIMULSHOT_TARGET"
"""Environment variable with another machine, in zig's words, for which ziglang compiles."""
# Without fused multiply-add all machines give the same depth; the other flags change no result.
FLAGS = (
    "-std=gnu11",
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-shared",
)


def library_of(source: Path = SOURCE) -> Path:
    """Return the path of the source's library; another source's would be called with wrong arguments."""
    # Not .so, which Python would take for an extension module.
    return source.with_suffix(f".{zlib.crc32(source.read_bytes()):08x}.library")


def find_compiler() -> list[str]:
    """Return the C compiler's command: the system's, or that of PyPI's ziglang; empty if there is none."""
    if target := os.environ.get(TARGET):
        return [sys.executable, "-m", "ziglang", "cc", "-target", target, "-mcpu=baseline"]
    named = os.environ.get("CC", "cc"), "cc", "gcc", "clang"
    if compiler := next(filter(None, map(shutil.which, named)), None):
        # Gathers are worth it from Haswell on; generic tuning avoids them.
        return [compiler, "-mtune=haswell"] if platform.machine() == "x86_64" else [compiler]
    # Without a processor ziglang compiles for this one alone, and with -mtune for none older than that.
    return [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"] if find_spec("ziglang") else []


def compile_kernels(source: Path = SOURCE, library: Path | None = None) -> bool:
    """Compile hot loops into a library, by default into that of this machine; False if no C compiler can."""
    if not (compiler := find_compiler()):
        return False
    library = library or library_of(source)
    part = library.with_suffix(f".{os.getpid()}")
    command = [*compiler, *FLAGS, "-o", str(part), str(source), "-lm"]
    # A compiler without support for several processor versions builds a single one.
    for plain in ([], ["-DONE_VERSION"]):
        if subprocess.run([*command, *plain], capture_output=True, check=False).returncode == 0:  # noqa: S603
            part.replace(library)
            for older in {*library.parent.glob(f"{source.stem}.*.library")} - {library}:
                older.unlink(missing_ok=True)
            return True
    return False


if __name__ == "__main__":
    sys.exit(not all(map(compile_kernels, SOURCES)))
