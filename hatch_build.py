"""Hatchling's hook: compiles the hot loops of depth, with PyPI's ziglang where there is no C compiler."""

import os
import runpy
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

DEPTH = "reconstruction/depth"
CAPTURE_ONLY = "SIMULSHOT_CAPTURE_ONLY"


class CompileKernels(BuildHookInterface):  # type: ignore[misc]
    """Where nothing can compile, and for machines that only capture, the wheel is one for all machines."""

    @property
    def compiling(self) -> dict[str, Any]:
        """The names of the package's own module, which cannot be imported yet."""
        return runpy.run_path(str(Path(self.root, DEPTH, "compiling.py")))

    def dependencies(self) -> list[str]:
        """Return what the build needs: a compiler of 100 MB, unless there is one or depth is not wanted."""
        wanted = not os.environ.get(CAPTURE_ONLY) and not self.compiling["find_compiler"]()
        return ["ziglang"] if wanted else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the library into the wheel: one for each architecture, for all Pythons."""
        sources = self.compiling["SOURCES"]
        if self.target_name == "wheel" and all(map(self.compiling["compile_kernels"], sources)):
            build_data["artifacts"].append(f"{DEPTH}/*.library")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
