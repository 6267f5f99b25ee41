"""Hatchling's hook: compiles what of `reconstruct` is compiled, where there is a C compiler."""

import runpy
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

DEPTH = "reconstruction/depth"


class CompileKernels(BuildHookInterface):  # type: ignore[misc]
    """Without a compiler the wheel is one for all machines, whose sweep runs by NumPy."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the library into the wheel: one for each architecture, for all Pythons."""
        compiling = runpy.run_path(str(Path(self.root, DEPTH, "compiling.py")))
        if self.target_name == "wheel" and compiling["compile_kernels"]():
            build_data["artifacts"].append(f"{DEPTH}/kernels.library")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
