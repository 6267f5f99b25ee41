"""Wheels for other systems: one build makes them all, and each has kernels that its system can load."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from reconstruction.depth.compiling import SOURCES, library_of
from tests.project import ROOT

lief = pytest.importorskip("lief")

pytestmark = pytest.mark.timeout(1200)

FORMATS = {
    "manylinux_2_17_x86_64": ("ELF", "X86_64"),
    "manylinux_2_17_aarch64": ("ELF", "AARCH64"),
    "win_amd64": ("PE", "AMD64"),
    "macosx_11_0_arm64": ("MACHO", "ARM64"),
    "macosx_11_0_x86_64": ("MACHO", "X86_64"),
}
"""Format and processor of a wheel's libraries, by its platform."""
OF_THE_SYSTEM = re.compile(
    r"libc\.so\.6|libm\.so\.6|ld-linux.*|/usr/lib/libSystem\.B\.dylib|KERNEL32\.dll|api-ms-win-crt-.*\.dll",
    re.I,
)
EXPORTED = re.compile(r"^(?:FOR_ALL )?(?:int|void|long|float) (\w+)\(", re.MULTILINE)
"""A function of C that is not static."""


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One wheel for each target of `make wheels`, by its platform."""
    folder = tmp_path_factory.mktemp("wheels")
    platforms = {}
    before = [library_of(source).read_bytes() for source in SOURCES]
    targets = dict(re.findall(r'"([\w.-]+)": "(\w+)",', (ROOT / "hatch_build.py").read_text()))
    words = re.search(r"^TARGETS := (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert words is not None
    assert words[1].split() == list(targets)
    for target, platform in targets.items():
        subprocess.run(
            [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", folder, ROOT],
            check=True,
            env={**os.environ, "SIMULSHOT_TARGET": target},
        )
        (platforms[platform],) = folder.glob(f"*-py3-none-{platform}.whl")
    assert [library_of(source).read_bytes() for source in SOURCES] == before, "its own libraries"
    return platforms


def test_each_target_has_a_wheel_with_a_library_of_its_own_system(wheels: dict[str, Path]) -> None:
    assert wheels.keys() == FORMATS.keys()
    for platform, wheel in wheels.items():
        with zipfile.ZipFile(wheel) as archive:
            (about,) = (
                archive.read(n).decode() for n in archive.namelist() if n.endswith(".dist-info/WHEEL")
            )
            assert f"Tag: py3-none-{platform}\n" in about
            assert "Root-Is-Purelib: false" in about
            for source in SOURCES:
                data = archive.read(f"reconstruction/depth/{library_of(source).name}")
                _check(lief.parse(list(data)), source, platform)
            assert sum(name.endswith(".library") for name in archive.namelist()) == len(SOURCES)


def _check(library: object, source: Path, platform: str) -> None:
    """Check a library's format, processor, exported functions and what it loads; a Mac of Apple's, signed."""
    form, processor = FORMATS[platform]
    header = library.header  # type: ignore[attr-defined]
    machine = next(getattr(header, n) for n in ("machine_type", "machine", "cpu_type") if hasattr(header, n))
    assert (library.format.name, machine.name) == (form, processor)  # type: ignore[attr-defined]
    exported = {one.name.lstrip("_").partition(".")[0] for one in library.exported_functions}  # type: ignore[attr-defined]
    wanted = set(EXPORTED.findall(source.read_text()))
    assert wanted
    assert not wanted - exported
    loaded = [getattr(one, "name", one) for one in library.libraries]  # type: ignore[attr-defined]
    own = f"{library_of(source).stem}."
    foreign = [name for name in loaded if own not in name and not OF_THE_SYSTEM.fullmatch(name)]
    assert not foreign
    if platform == "macosx_11_0_arm64":
        assert library.has_code_signature  # type: ignore[attr-defined]
