"""Threads that ask for the same result compute it once, and those that ask for others do not wait."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from reconstruction.common.worker_pool import computed_once


def test_threads_that_ask_for_one_result_at_a_time_compute_it_once() -> None:
    begun, may_end = threading.Event(), threading.Event()
    made: list[tuple[str, int]] = []

    @computed_once
    def make(name: str, *, size: int = 0) -> tuple[str, int]:
        made.append((name, size))
        if name == "slow":
            begun.set()
            assert may_end.wait(10)
        return name, size

    with ThreadPoolExecutor(4) as pool:
        slow = [pool.submit(make, "slow") for _ in range(3)]
        assert begun.wait(10)
        assert make("other") == make("other") == ("other", 0)
        assert make("other", size=2) == ("other", 2)
        may_end.set()
        assert [one.result() for one in slow] == [("slow", 0)] * 3
    assert made == [("slow", 0), ("other", 0), ("other", 2)]


def test_a_failure_is_tried_again() -> None:
    tries: list[int] = []

    @computed_once
    def make(number: int) -> int:
        tries.append(number)
        if len(tries) == 1:
            raise ValueError("the first fails")
        return number

    with pytest.raises(ValueError, match="the first"):
        make(3)
    assert make(3) == 3
