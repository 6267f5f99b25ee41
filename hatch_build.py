"""Hatchling's hook: compiles the hot loops of depth, with PyPI's ziglang where there is no C compiler."""

import os
import runpy
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

DEPTH = "reconstruction/depth"
CAPTURE_ONLY = "SIMULSHOT_CAPTURE_ONLY"
PLATFORMS = {
    "x86_64-linux-gnu.2.17": "manylinux_2_17_x86_64",
    "aarch64-linux-gnu.2.17": "manylinux_2_17_aarch64",
    "x86_64-windows-gnu": "win_amd64",
    "aarch64-macos.11.0": "macosx_11_0_arm64",
    "x86_64-macos.11.0": "macosx_11_0_x86_64",
}
"""What a wheel says of the machines that it is for, by zig's word for them (`make wheels`)."""


class CompileKernels(BuildHookInterface):  # type: ignore[misc]
    """Where nothing can compile, and for machines that only capture, the wheel is one for all machines."""

    @property
    def compiling(self) -> dict[str, Any]:
        """The names of the package's own module, which cannot be imported yet."""
        return runpy.run_path(str(Path(self.root, DEPTH, "compiling.py")))

    @property
    def target(self) -> str:
        """The other machine that the wheel is for; empty for this one's."""
        return os.environ.get(self.compiling["TARGET"], "")

    def dependencies(self) -> list[str]:
        """Return what the build needs: a compiler of 100 MB, unless there is one or depth is not wanted."""
        wanted = not os.environ.get(CAPTURE_ONLY) and (self.target or not self.compiling["find_compiler"]())
        return ["ziglang"] if wanted else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the library into the wheel: one for each architecture, for all Pythons."""
        compile_kernels, sources = self.compiling["compile_kernels"], self.compiling["SOURCES"]
        if self.target_name != "wheel":
            return
        if self.target:
            # Aside: the checkout keeps the libraries of this machine.
            self.aside = tempfile.TemporaryDirectory()
            for source in sources:
                name = self.compiling["library_of"](source).name
                library = Path(self.aside.name, name)
                if not compile_kernels(source, library):
                    raise RuntimeError(f"{source.name} cannot be compiled for {self.target}")
                build_data["force_include"][str(library)] = f"{DEPTH}/{name}"
            platform = PLATFORMS[self.target]
        elif all(map(compile_kernels, sources)):
            build_data["artifacts"].append(f"{DEPTH}/*.library")
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        else:
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
