"""`capture-app` alone: the terminal UI, with a leader of its own."""

import sys
from pathlib import Path

from capture_app.errors import NotAvailableError
from capture_app.net.address import DEFAULT_PORT


def open_screen() -> None:
    """Open the terminal UI until it is closed. Raises NotAvailableError where there is no terminal."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise NotAvailableError(
            "the screen needs a terminal", hint="use `capture-app leader`, or see capture-app --help"
        )
    from capture_app.tui.app import run_app

    run_app(sessions=Path("sessions"), host="0.0.0.0", port=DEFAULT_PORT)  # noqa: S104 - cameras are other machines
