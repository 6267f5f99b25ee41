"""Skips that CI accepts, each with its reason; any other skipped test fails the run there."""

import os

import pytest

ACCEPTED = {
    "this machine is not of the kind that rendered the samples": "floating point differs by the processor",
    "apt-get install webkit2gtk-driver, xvfb": "not every machine of CI has it",
    "this machine cannot mount ": "containers may not mount, and no kernel knows every file system",
    "the weights of BlazePose were never fetched": "they are downloaded once, and CI may be offline",
    "nerfstudio is not installed": "its PyTorch takes 3 GB",
    "eager tasks came with Python 3.12": "it is tested on newer versions of Python",
}
"""Why a test may be skipped in CI, by the beginning of its reason."""
WITHOUT_RECORDINGS = "no real recordings at "
"""Recordings of others are not published: a CI without them sets `SIMULSHOT_CI_RECORDINGS=none`."""


def refused(reason: str) -> bool:
    """Whether a skip for that reason fails CI."""
    accepted = [*ACCEPTED]
    if os.environ.get("SIMULSHOT_CI_RECORDINGS") == "none":
        accepted.append(WITHOUT_RECORDINGS)
    return not reason.removeprefix("Skipped: ").startswith(tuple(accepted))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run of CI in which a test was skipped for a reason that is not accepted."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if not os.environ.get("CI") or reporter is None or hasattr(session.config, "workerinput"):
        return
    skipped = {(report.nodeid, reason(report)) for report in reporter.getreports("skipped")}
    if wrong := sorted((name, why) for name, why in skipped if refused(why)):
        reporter.section("skipped, and not accepted by tests/skips.py", red=True)
        for name, why in wrong:
            reporter.write_line(f"{name}: {why}")
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Return why a test or a file of tests was skipped."""
    return str(report.longrepr[2]) if isinstance(report.longrepr, tuple) else str(report.longrepr)
