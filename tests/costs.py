"""Processor time of each test: the dearest are printed, and in CI a unit test that is too dear fails."""

import os
import time
from collections.abc import Generator, Iterable

import pytest

UNIT_LIMIT_S = 1.0
"""Processor time that a test in tests/unit may take in CI; what takes more belongs in tests/system.

It is that of a machine on which `loop_s` takes LOOP_S; a slower one has more. Elsewhere nothing is
refused: at a load of 16 the same test takes two and a half times as much.
"""
LOOP_S = 0.035
"""Processor time of `loop_s` on the machine where the tests were sorted into folders."""
DEAREST = 10
_PROPERTY = "cpu_s"


def cpu_s() -> float:
    """Return the processor time of this process and of all its children that have ended."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Measure a test without its fixtures, which the first of many tests sets up for all."""
    before_s = cpu_s()
    result = yield
    cost_s = cpu_s() - before_s
    item.user_properties.append((_PROPERTY, cost_s))
    is_unit = os.environ.get("CI") and item.nodeid.startswith("tests/unit/")
    if is_unit and cost_s > UNIT_LIMIT_S and cost_s > UNIT_LIMIT_S * loop_s() / LOOP_S:
        pytest.fail(
            f"a unit test of {cost_s:.1f} s of a processor, over {UNIT_LIMIT_S:g} s: "
            "make it cheaper, or move it to tests/system",
            pytrace=False,
        )
    return result


def loop_s() -> float:
    """Measure how long this machine takes now for what always is the same work."""
    before_s = time.process_time()
    sum(number * number for number in range(1_000_000))
    return time.process_time() - before_s


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the sum and the dearest tests."""
    costs = sorted(_costs(terminalreporter.getreports("passed")), reverse=True)
    if len(costs) > DEAREST:
        terminalreporter.section(f"processor time {sum(cost for cost, _ in costs):.0f} s, the dearest tests")
        for cost_s, name in costs[:DEAREST]:
            terminalreporter.write_line(f"{cost_s:6.1f} s  {name}")


def _costs(reports: Iterable[pytest.TestReport]) -> Iterable[tuple[float, str]]:
    for report in reports:
        yield from (
            (float(str(cost)), report.nodeid) for name, cost in report.user_properties if name == _PROPERTY
        )
