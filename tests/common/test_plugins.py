"""Entry points of packages outside simulshot: found, loaded, and skipped where they are broken."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.plugins import load_plugin, load_plugins, plugin_names

GROUP = "simulshot.tests"
BROKEN = {
    "absent": ("no_such_module", "No module named 'no_such_module'"),
    "faulty": ("faulty_plugin", "it is Friday"),
    "nameless": ("good_plugin:nothing", "no attribute 'nothing'"),
    "useless": ("good_plugin:OTHER", "it has no 'run'"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "good_plugin.py").write_text("class Good:\n    run = 3\n\nOTHER = 'no plugin'\n")
    (tmp_path / "faulty_plugin.py").write_text("raise RuntimeError('it is Friday')\n")
    install(tmp_path, "third-party", {"good": "good_plugin:Good"})
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for module in ("good_plugin", "faulty_plugin"):
        sys.modules.pop(module, None)


def install(folder: Path, package: str, entries: dict[str, str]) -> None:
    """Write a package's metadata."""
    metadata = folder / f"{package.replace('-', '_')}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (metadata / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines]))


def test_names_are_known_without_an_import(folder: Path) -> None:
    install(folder, "another", {"early": "faulty_plugin"})
    assert plugin_names(GROUP) == ("early", "good")
    assert "faulty_plugin" not in sys.modules
    assert "good_plugin" not in sys.modules
    assert load_plugin(GROUP, "good", "run").run == 3


def test_unknown_name_lists_what_is_installed(folder: Path) -> None:
    with pytest.raises(BadInputError, match=r"'goood' is not in simulshot\.tests \(installed: good\)"):
        load_plugin(GROUP, "goood")


@pytest.mark.parametrize("name", BROKEN)
def test_broken_plugin_is_named_and_skipped(
    folder: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    value, reason = BROKEN[name]
    install(folder, "broken-things", {name: value})
    with pytest.raises(NotAvailableError, match=reason) as raised:
        load_plugin(GROUP, name, "run")
    assert f"{name!r} of {GROUP}" in str(raised.value)
    assert "broken-things" in str(raised.value)
    assert list(load_plugins(GROUP, "run")) == ["good"]
    assert [record.message for record in caplog.records] == [str(raised.value)]


def test_no_package_replaces_a_plugin_of_simulshot(folder: Path) -> None:
    install(folder, "simulshot", {"shared": "good_plugin:Good"})
    install(folder, "aaa", {"shared": "faulty_plugin"})
    install(folder, "zzz", {"shared": "faulty_plugin"})
    assert load_plugin(GROUP, "shared").run == 3
