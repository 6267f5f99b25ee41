"""Frames are taken from a driver in time though the event loop is busy, and not without limit."""

import asyncio
import time
from collections.abc import Iterator

from capture_app.cameras import frame_reader
from capture_app.cameras.frame_reader import FrameReader
from tests.waiting import until

PERIOD_NS, BUFFERS = 10_000_000, 8


class Driver:
    """A driver with few buffers, which loses the frames that find none free; None ends its stream."""

    def __init__(self) -> None:
        self.begun_ns, self.read_to, self.lost = time.monotonic_ns(), 0, 0
        self.taken: list[int] = []
        self.errors: list[OSError] = []
        self.is_unplugged = False

    def read(self) -> Iterator[int]:
        if self.is_unplugged:
            raise OSError("unplugged")
        due = (time.monotonic_ns() - self.begun_ns) // PERIOD_NS
        self.lost += max(0, due - self.read_to - BUFFERS)
        yield from range(self.read_to, min(due, self.read_to + BUFFERS))
        self.read_to = due

    def reader(self) -> FrameReader[int]:
        return FrameReader(
            self.read, self.taken.append, self.errors.append, period_ns=PERIOD_NS, buffers=BUFFERS
        )


async def test_a_busy_event_loop_loses_no_frame() -> None:
    driver = Driver()
    reader = driver.reader()
    time.sleep(0.4)  # noqa: ASYNC251 - five times as long as the driver's buffers last
    assert not driver.taken
    await until(lambda: len(driver.taken) >= 40)
    reader.stop()
    reader.join()
    assert driver.taken == [*range(len(driver.taken))]
    assert not driver.lost


async def test_frames_that_nobody_takes_stay_with_the_driver() -> None:
    driver = Driver()
    reader = driver.reader()
    reader._max_waiting = 3
    time.sleep(0.2)  # noqa: ASYNC251 - the loop is busy
    reader.stop()
    reader.join()
    assert 3 <= driver.read_to < 3 + BUFFERS
    await asyncio.sleep(0)
    assert not driver.taken, "it was stopped before"


async def test_a_device_that_is_gone_is_reported_after_its_frames() -> None:
    driver = Driver()
    reader = driver.reader()
    await until(lambda: len(driver.taken) > 3)
    driver.is_unplugged = True
    await until(lambda: bool(driver.errors))
    assert driver.taken == [*range(driver.read_to)]
    reader.join()


async def test_reads_are_frequent_enough_for_few_buffers() -> None:
    fast = FrameReader(list, print, print, period_ns=PERIOD_NS, buffers=4)
    assert fast._interval_s <= 4 * PERIOD_NS / 4e9
    fast.stop()
    assert fast._max_waiting * PERIOD_NS == frame_reader.BUDGET_NS
