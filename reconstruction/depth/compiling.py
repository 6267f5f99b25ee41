"""Compilation of `kernels.c` when simulshot is installed (`hatch_build.py`); imports no other module of it.

`python reconstruction/depth/compiling.py` compiles it in a checkout.
"""

import os
import platform
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

SOURCE = Path(__file__).with_name("kernels.c")
# Not kernels.so, which Python would take for an extension module.
LIBRARY = Path(__file__).with_name("kernels.library")
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


def source_checksum() -> int:
    """Return the checksum that a library has in itself if it was compiled from today's source."""
    return zlib.crc32(SOURCE.read_bytes()) >> 1


def compile_kernels(library: Path = LIBRARY) -> bool:
    """Compile the sweep's hot loops into a library; False if no C compiler can."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "cc", "gcc", "clang"))), None)
    if compiler is None:
        return False
    # Gathers are worth it from Haswell on; generic tuning avoids them.
    tuned = ["-mtune=haswell"] if platform.machine() == "x86_64" else []
    part = library.with_suffix(f".{os.getpid()}")
    checksum = f"-DSOURCE_CHECKSUM={source_checksum()}"
    command = [compiler, *FLAGS, *tuned, checksum, "-o", str(part), str(SOURCE), "-lm"]
    # A compiler without support for several processor versions builds a single one.
    for plain in ([], ["-DONE_VERSION"]):
        if subprocess.run([*command, *plain], capture_output=True, check=False).returncode == 0:  # noqa: S603
            part.replace(library)
            return True
    return False


if __name__ == "__main__":
    sys.exit(not compile_kernels())
