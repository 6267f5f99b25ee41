"""The kernels give the same to the last bit on all x86-64, and on arm64 (emulated)."""

import shutil
import subprocess
from pathlib import Path

import pytest

from reconstruction.depth.compiling import FLAGS, SOURCE

PROGRAM = Path(__file__).with_name("kernels_alone.c")
FOR_ARM = "aarch64-linux-gnu-gcc", "qemu-aarch64"


def said(folder: Path, compiler: str, *flags: str, run: tuple[str, ...] = ()) -> str:
    program = folder / "kernels_alone"
    plain = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC")]
    command = [
        compiler,
        *plain,
        f"-I{SOURCE.parent}",
        *flags,
        "-o",
        str(program),
        str(PROGRAM),
        "-lm",
    ]
    subprocess.run(command, check=True)
    return subprocess.run([*run, str(program)], check=True, capture_output=True, text=True).stdout


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here")
def test_one_version_for_all_gives_what_this_processors_own_gives(tmp_path: Path) -> None:
    one = said(tmp_path, "gcc", "-DONE_VERSION")
    assert len(set(one.splitlines())) == 16
    assert said(tmp_path, "gcc", "-mtune=native") == one


@pytest.mark.skipif(not all(map(shutil.which, FOR_ARM)), reason="gcc-aarch64-linux-gnu, qemu-user")
def test_arm64_gives_what_this_processor_gives(tmp_path: Path) -> None:
    on_arm = said(tmp_path, FOR_ARM[0], "-static", run=(FOR_ARM[1],))
    assert on_arm == said(tmp_path, "gcc", "-DONE_VERSION")
