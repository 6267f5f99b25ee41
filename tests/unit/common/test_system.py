"""The seam to the operating system: all systems have the same functions, and no other room calls a system."""

import ast
import asyncio
import ctypes
import importlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from capture_app.common import system
from tests.project import ROOT

LINUX_ONLY = ROOT / "capture_app" / "plugins" / "cameras" / "libcamera"
"""A driver whose library is Linux' own."""
ROOM = ROOT / "capture_app" / "common" / "system"
SYSTEMS = ("linux", "macos", "windows")
METHODS = {"add_reader", "remove_reader", "add_signal_handler", "remove_signal_handler", "is_mount"}
"""Methods of Python's own that Windows lacks; functions are in ruff's list of banned names."""


def defined_by(name: str) -> dict[str, ast.AST]:
    """Return what a module defines, by name, with what it takes over from `posix`."""
    tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
    stars = (n.module for n in tree.body if isinstance(n, ast.ImportFrom) and n.names[0].name == "*")
    names: dict[str, ast.AST] = {}
    for star in stars:
        names |= defined_by(str(star).rpartition(".")[2])
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names[node.name] = node
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            names[node.targets[0].id] = node
    return names


@pytest.mark.parametrize("name", SYSTEMS)
def test_each_system_has_all_functions(name: str) -> None:
    assert not set(system.__all__) - set(defined_by(name))


@pytest.mark.parametrize("name", SYSTEMS[1:])
def test_a_function_takes_the_same_arguments_on_each_system(name: str) -> None:
    ours, theirs = defined_by("linux"), defined_by(name)
    for function in system.__all__:
        one, other = ours[function], theirs[function]
        if isinstance(one, ast.FunctionDef) and isinstance(other, ast.FunctionDef):
            required = [a.arg for a in one.args.args], [a.arg for a in one.args.kwonlyargs]
            given = (
                [a.arg for a in other.args.args][: len(required[0])],
                [a.arg for a in other.args.kwonlyargs],
            )
            assert required == given, function


def test_a_machine_that_does_not_sleep_is_not_said_to() -> None:
    first_ns, *later_ns = (system.asleep_ns() for _ in range(100))
    assert first_ns > -50_000_000
    assert min(abs(ns - first_ns) for ns in later_ns) < 1_000_000


def test_nobody_else_calls_what_a_system_lacks() -> None:
    calls = []
    for package in ("capture_app", "reconstruction"):
        for path in (ROOT / package).rglob("*.py"):
            if path.parent in (ROOM, LINUX_ONLY):
                continue
            text = path.read_text(encoding="utf-8")
            if not any(word in text for word in (*METHODS, "CDLL(")):
                continue  # to parse all files takes seconds
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Attribute) and node.attr in METHODS:
                    calls.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.attr}")
                if isinstance(node, ast.Call) and ast.unparse(node).startswith("ctypes.CDLL(None"):
                    calls.append(f"{path.relative_to(ROOT)}:{node.lineno} CDLL(None)")
    assert not calls


@pytest.mark.skipif(sys.platform == "win32", reason="macOS' functions are of POSIX")
def test_what_macos_does_in_another_way(tmp_path: Path) -> None:
    macos = importlib.import_module("capture_app.common.system.macos")
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_bytes(b"1")
    with one.open("ab") as file:
        file.write(b"2")
        file.flush()
        macos.sync_data(file.fileno())
    macos.move_new(one, other)
    assert other.read_bytes() == b"12"
    one.mkdir()
    with pytest.raises(FileExistsError):
        macos.move_new(other, one)
    assert macos.exchange(one, other) is False
    assert macos.machine_memory() > 1 << 28


def test_an_open_file_is_renamed_replaced_and_removed(tmp_path: Path) -> None:
    """Windows refuses that unless a file is opened for it."""
    path, aside = tmp_path / "file", tmp_path / "aside"
    handle = system.open_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL)
    with os.fdopen(handle, "r+b") as file:
        file.write(b"\r\n\x1a\n" * 3)
        file.flush()
        system.sync_data(file.fileno())
        assert system.read_at(file.fileno(), 3, 1) == b"\n\x1a\n"
        system.replace(path, aside)
        path.write_bytes(b"new")
        system.sync_path(path)
        system.sync_path(tmp_path)
        aside.unlink()
    system.replace(path, aside)
    aside.unlink()
    assert not any(tmp_path.iterdir())


def test_links_are_not_followed_if_they_must_not_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"1")
    try:
        (tmp_path / "link").symlink_to(tmp_path / "file")
        (tmp_path / "link").read_bytes()
    except OSError:
        pytest.skip("this system or user makes no links")
    os.close(system.open_file(tmp_path / "link", os.O_RDONLY))
    with pytest.raises(OSError, match="link"):
        system.open_file(tmp_path / "link", os.O_RDONLY, follow_links=False)


def test_a_held_name_is_free_when_its_handle_is_closed(tmp_path: Path) -> None:
    def handle() -> int:
        return system.open_file(tmp_path / "file", os.O_RDWR | os.O_CREAT)

    first, second = handle(), handle()
    name = f"simulshot-test-{os.getpid()}"
    system.hold_name(first, name)
    with pytest.raises(BlockingIOError):
        system.hold_name(second, name)
    os.close(first)
    system.hold_name(second, name)
    os.close(second)


def test_a_process_runs_until_it_has_ended() -> None:
    """On Windows, os.kill(pid, 0) would end it."""
    with subprocess.Popen([*system.PYTHON, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert system.is_running(child.pid)
        assert system.is_running(child.pid), "it was asked, and still runs"
        child.communicate(b"\n")
    assert child.returncode == 0
    assert not system.is_running(child.pid)
    assert system.is_running(os.getpid())


def test_a_group_is_paused_resumed_and_killed() -> None:
    code = "import time\nwhile True: print('.', flush=True); time.sleep(0.01)"
    options = system.child_options({"SIMULSHOT_TEST": "1"})
    with subprocess.Popen([*system.PYTHON, "-c", code], stdout=subprocess.PIPE, **options) as child:
        assert child.stdout is not None
        assert child.stdout.read(1) == b"."
        system.signal_group(child.pid, "pause")
        system.signal_group(child.pid, "resume")
        system.signal_group(child.pid, "kill")
        assert child.wait() != 0
    with pytest.raises(ProcessLookupError):
        system.signal_group(child.pid, "kill")


async def test_datagrams_are_received_with_the_time_of_their_arrival() -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(("127.0.0.1", 0))
    got: list[tuple[bytes, tuple[str, int], int | None, int | None]] = []
    all_here = asyncio.Event()

    def received(*datagram: object) -> None:
        got.append(datagram)  # type: ignore[arg-type]
        if len(got) == 100:
            all_here.set()

    end = system.receive_datagrams(sock, 2048, received, lambda: None, at_once=8)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        begun_ns = system.monotonic_ns()
        for number in range(100):
            sender.sendto(b"%d" % number, sock.getsockname())
        async with asyncio.timeout(10):
            await all_here.wait()
        ended_ns = system.monotonic_ns()
        assert [data for data, *_ in got] == [b"%d" % number for number in range(100)]
        assert {address for _, address, _, _ in got} == {("127.0.0.1", sender.getsockname()[1])}
    for _, _, real_ns, monotonic_ns in got:
        assert monotonic_ns is None or begun_ns <= monotonic_ns <= ended_ns
        assert real_ns is None or monotonic_ns is None
    end()
    sock.close()


def test_timers_of_the_loop_are_accurate_to_milliseconds() -> None:
    """Before Python 3.13 those of Windows count in ticks of 15.6 ms."""

    async def sleeps() -> list[int]:
        spans = []
        for _ in range(9):
            begun_ns = system.monotonic_ns()
            await asyncio.sleep(0.02)
            spans.append(system.monotonic_ns() - begun_ns)
        return spans

    with asyncio.Runner(loop_factory=system.new_event_loop) as runner:
        assert min(runner.run(sleeps())) >= 19_000_000


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
@pytest.mark.parametrize("is_open", [True, False])
async def test_a_screen_resumes_only_while_its_terminal_is_open(
    monkeypatch: pytest.MonkeyPatch, *, is_open: bool
) -> None:
    resumed: list[bool] = []
    before = signal.signal(signal.SIGCONT, lambda *_: resumed.append(True))
    try:
        system.on_end(lambda: None)
        monkeypatch.setattr("os.isatty", lambda _: is_open)
        signal.raise_signal(signal.SIGCONT)
    finally:
        signal.signal(signal.SIGCONT, before)
        for number in (signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().remove_signal_handler(number)
    assert resumed == [True] * is_open


FREEING = """
import resource
from capture_app.common import system
system.reuse_freed_memory()
cleared = []
for _ in range(20):
    images = [b"x" * (2 << 20) for _ in range(8)]
    del images
    cleared.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
print(cleared[-1] - cleared[9])
"""


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="not glibc")
def test_the_next_images_take_the_memory_of_those_before() -> None:
    said = subprocess.run([sys.executable, "-c", FREEING], capture_output=True, text=True, check=True).stdout
    assert int(said) < 1000  # pages that were cleared for ten times eight images; without it some 40,000
