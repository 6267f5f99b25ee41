"""Compiles `kernels.c` where simulshot is installed (`hatch_build.py`): it imports nothing of ours.

`python reconstruction/depth/compiling.py` compiles it in a checkout.
"""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).with_name("kernels.c")
# Not kernels.so, which Python would take for a module of its own.
LIBRARY = Path(__file__).with_name("kernels.library")
# No product is fused with a sum, so that all machines give the same depth; the others change no result.
FLAGS = (
    "-std=gnu11",
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-shared",
)


def compile_kernels(library: Path = LIBRARY) -> bool:
    """Compile the sweep's hot loops into a library; False where there is no C compiler that can."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "cc", "gcc", "clang"))), None)
    if compiler is None:
        return False
    # Gathers are worth it from Haswell on; generic tuning avoids them.
    tuned = ["-mtune=haswell"] if platform.machine() == "x86_64" else []
    part = library.with_suffix(f".{os.getpid()}")
    command = [compiler, *FLAGS, *tuned, "-o", str(part), str(SOURCE), "-lm"]
    # A compiler that knows fewer versions of processors makes one for all.
    for plain in ([], ["-DONE_VERSION"]):
        if subprocess.run([*command, *plain], capture_output=True, check=False).returncode == 0:  # noqa: S603
            part.replace(library)
            return True
    return False


if __name__ == "__main__":
    sys.exit(not compile_kernels())
