"""Fixtures shared by all tests."""

import asyncio
import contextlib
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.first_start import compile_changed_tests

# A busy machine is no bug: nothing here is timed.
# The same examples every time, for everybody: a change is judged by what it changed. Nights draw new ones.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("new", deadline=None, max_examples=1000, print_blob=True)
settings.load_profile("same")

# Started with & from a script, tests ignore SIGINT, and so would the programs that they interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Screens are those of a terminal with all colors on this machine, wherever the tests are started.
os.environ["COLORTERM"] = "truecolor"
for name in ("NO_COLOR", "SSH_CONNECTION", "SSH_TTY"):
    os.environ.pop(name, None)

# Several tests run at a time, as many as there are cores. Set before numpy and OpenCV are imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")

pytest_plugins = ["tests.costs", "tests.parts", "tests.skips", "tests.windows"]

SHARED = Path(__file__).resolve().parents[2] / "shared"


# Imports leave a million objects and no garbage. To search them in each test takes a sixth of the time.
gc.disable()


def pytest_configure(config: pytest.Config) -> None:
    """Compile once what as many workers as there are would compile."""
    many = config.getoption("numprocesses", None) and not hasattr(config, "workerinput")
    if many and not sys.dont_write_bytecode:
        # Of another version of pytest, which has no such private functions, each worker compiles for itself.
        with contextlib.suppress(AttributeError, TypeError):
            compile_changed_tests(config)


def pytest_collection_finish() -> None:
    """Collect garbage from now on, but not among all that was imported."""
    gc.freeze()
    # A screen is ten thousand objects, which the default would search again and again.
    gc.set_threshold(20_000)
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_asyncio_loop_factories(item: pytest.Item) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Run tests marked `virtual` in virtual time."""
    if item.get_closest_marker("virtual") is None:
        return {"real": asyncio.new_event_loop}
    from tests.virtual.in_process import virtual_loop

    return {"virtual": virtual_loop}


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings beside the checkout."""
    if not SHARED.is_dir():
        pytest.skip(f"no real recordings at {SHARED.name}/ beside the checkout")
    return SHARED


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Programs that tests start keep their state here, not in the user's own folder."""
    folder = tmp_path_factory.mktemp("state")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        patch.setenv("XDG_DATA_HOME", str(folder / "data"))
        yield folder


@pytest.fixture
def open_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is asked who it is: for tests that say each byte of a stream or a datagram themselves."""
    monkeypatch.setenv("SIMULSHOT_OPEN", "1")
