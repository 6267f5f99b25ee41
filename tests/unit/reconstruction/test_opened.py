"""The commands as methods of an open session: results with arrays, and not a word on the terminal."""

import threading
from concurrent.futures import ThreadPoolExecutor

import cv2
import pytest

from capture_app.console.terminal import talk
from capture_app.console.usage import silence
from reconstruction import open_session
from reconstruction.common.memory import limited_memory, memory_budget
from reconstruction.common.options import described
from reconstruction.common.picture_checksums import checked_pictures, picture_checks
from reconstruction.common.worker_pool import worker_pool
from reconstruction.method.interface import methods
from tests.project import JUMPER


def test_two_sessions_in_two_threads_neither_silence_nor_limit_each_other(
    capfd: pytest.CaptureFixture[str],
) -> None:
    both = threading.Barrier(2)

    def small() -> tuple[int, bool, int]:
        with silence(), limited_memory(300 << 20), checked_pictures(required=True), worker_pool() as pool:
            both.wait()
            talk("never heard")
            within = pool.submit(lambda: (memory_budget().limit_bytes, picture_checks().required)).result()
            pool.submit(talk, "never heard from a worker").result()
            both.wait()
            return (*within, cv2.getNumThreads())

    before = cv2.getNumThreads()
    with ThreadPoolExecutor(1) as other, limited_memory(2 << 30):
        beside = other.submit(small)
        both.wait()
        with worker_pool():
            talk("heard")
            assert memory_budget().limit_bytes == 2 << 30
            assert not picture_checks().required
            both.wait()
            assert beside.result() == (300 << 20, True, 1)
        assert cv2.getNumThreads() == before
        both.reset()
    assert capfd.readouterr().err == "heard\n"


def test_each_method_has_the_help_of_its_command() -> None:
    opened = open_session(JUMPER)
    for name, method in methods().items():
        bound = getattr(opened, name)
        assert bound.__name__ == name
        assert bound.__doc__.startswith(method.help)
        assert all(f"    {option.field}: " in bound.__doc__ for option in described(method))
