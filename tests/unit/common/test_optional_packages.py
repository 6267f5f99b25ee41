"""A machine without what only some work needs: what runs, and what the rest says."""

import platform
import sys
from pathlib import Path

import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.common.optional_packages import how_to_install, load_optional

PC = "(sys_platform == 'linux' and platform_machine == 'x86_64')"
REQUIRES = [
    "numpy>=2.0",
    'av>=15; extra == "export"',
    'mcap<3,>=1.2; extra == "export"',
    f"open3d-cpu>=0.20; {PC} and extra == 'reconstruction'",
    f"pycolmap>=4.2; {PC} and extra == 'reconstruction'",
]


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Linux machine with simulshot's capture side, by the records that installers keep."""
    lines = [*(f"Provides-Extra: {extra}" for extra in ("export", "reconstruction"))]
    lines += [f"Requires-Dist: {need}" for need in REQUIRES]
    record = tmp_path / "simulshot-0.1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(
        "\n".join(("Metadata-Version: 2.4", "Name: simulshot", "Version: 0.1.0", *lines))
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(platform, "system", lambda: "Linux")


@pytest.mark.usefixtures("machine")
def test_the_line_installs_the_packages_by_their_own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/my rig/bin/python")
    assert how_to_install("export") == "'/my rig/bin/python' -m pip install 'av>=15' 'mcap<3,>=1.2'"


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize(
    ("machine_name", "advice"),
    [
        ("x86_64", "-m pip install 'open3d-cpu>=0.20' 'pycolmap>=4.2'"),
        ("aarch64", "Linux on aarch64: copy the"),
    ],
)
def test_a_machine_that_cannot_have_them_is_told(
    monkeypatch: pytest.MonkeyPatch, machine_name: str, advice: str
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine_name)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        NotAvailableError, match="finding poses needs pycolmap, which is not installed"
    ) as caught:
        load_optional("pycolmap", "reconstruction", "finding poses")
    assert advice in str(caught.value)


@pytest.mark.usefixtures("machine")
def test_open3d_with_cuda_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(sys, "platform", "linux")
    (tmp_path / "open3d.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    assert how_to_install("reconstruction").endswith("-m pip install 'pycolmap>=4.2'")


def test_a_library_of_the_system_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken3d.py").write_text("raise OSError('libGL.so.1: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(NotAvailableError, match=r"does not load here: libGL.*apt-get install libgl1"):
        load_optional("broken3d", "reconstruction", "a mesh")
