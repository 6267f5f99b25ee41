"""Entry points of packages outside simulshot: found, loaded, and skipped where they are broken."""

import builtins
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from capture_app.common import plugins
from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.plugins import load_plugin, load_plugins, plugin_names

GROUP = "simulshot.tests"
BROKEN = {
    "absent": ("no_such_module", "No module named 'no_such_module'"),
    "faulty": ("faulty_plugin", "it is Friday"),
    "nameless": ("good_plugin:nothing", "no attribute 'nothing'"),
    "useless": ("good_plugin:OTHER", "it has no 'run'"),
    "leaving": ("leaving_plugin", r"SystemExit\(3\)"),
    "hanging": ("hanging_plugin:HANG", "still being imported"),
}

HANGING = """
import builtins

def __getattr__(name):
    if name == "HANG":
        builtins.hang.wait()
    return name
"""


class Hang:
    """Threads that hang until `over`; to join one of them lasts as long as the timeout, in no time."""

    def __init__(self) -> None:
        self.over = threading.Event()
        self._threads: set[threading.Thread] = set()
        self._join = threading.Thread.join

    def wait(self) -> None:
        self._threads.add(threading.current_thread())
        self.over.wait()

    def join(self, thread: threading.Thread, timeout: float | None = None) -> None:
        while thread.is_alive() and (thread not in self._threads or self.over.is_set()):
            self._join(thread, 0.01)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "good_plugin.py").write_text("class Good:\n    run = 3\n\nOTHER = 'no plugin'\n")
    (tmp_path / "faulty_plugin.py").write_text("raise RuntimeError('it is Friday')\n")
    (tmp_path / "leaving_plugin.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "hanging_plugin.py").write_text(HANGING)
    hang = Hang()
    monkeypatch.setattr(builtins, "hang", hang, raising=False)
    monkeypatch.setattr(threading.Thread, "join", lambda *args: hang.join(*args))
    install(tmp_path, "third-party", {"good": "good_plugin:Good"})
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    hang.over.set()
    for module in ("good_plugin", "faulty_plugin", "hanging_plugin"):
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
    caplog.clear()
    for _ in range(2):
        assert list(load_plugins(GROUP, "run")) == ["good"]
    [record] = caplog.records
    for message in (str(raised.value), record.message):
        assert f"{name!r} of {GROUP} does not load: " in message
        assert re.search(reason, message)
        assert "broken-things" in message


def test_named_plugin_that_imports_for_long_is_waited_for(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(folder, "slow-things", {"slow": "hanging_plugin:HANG"})
    said: list[str] = []

    def warning(text: str, what: str) -> None:
        said.append(text % what)
        builtins.hang.over.set()  # type: ignore[attr-defined]

    monkeypatch.setattr(plugins._log, "warning", warning)
    assert load_plugin(GROUP, "slow") == "HANG"
    assert said == ["the plugin 'slow' of simulshot.tests is still being imported"]


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("METADATA", None, "it has no METADATA"),
        ("METADATA", b"Metadata-Version: 2.1\nName: caf\xe9\n", "codec can't decode"),
        ("entry_points.txt", b"[simulshot.tests]\ncaf\xe9 = good_plugin:Good\n", "codec can't decode"),
        ("entry_points.txt", b"[simulshot.tests]\nodd\n", ""),
    ],
)
def test_damaged_package_is_named_once_and_skipped(
    folder: Path, caplog: pytest.LogCaptureFixture, file: str, content: bytes | None, reason: str
) -> None:
    install(folder, "half-removed", {"acme": "good_plugin:Good"})
    metadata = folder / "half_removed-1.0.dist-info"
    if content is None:
        (metadata / file).unlink()
    else:
        (metadata / file).write_bytes(content)
    for group in (GROUP, "simulshot.others"):
        assert plugin_names(group) == (("good",) if group == GROUP else ())
        assert list(load_plugins(group, "run")) == list(plugin_names(group))
    [record] = caplog.records
    assert str(metadata) in record.message
    assert reason in record.message


def test_no_package_replaces_a_plugin_of_simulshot(folder: Path) -> None:
    install(folder, "simulshot", {"shared": "good_plugin:Good"})
    install(folder, "aaa", {"shared": "faulty_plugin"})
    install(folder, "zzz", {"shared": "faulty_plugin"})
    assert load_plugin(GROUP, "shared").run == 3
