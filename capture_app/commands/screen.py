"""`capture-app` alone: the terminal UI, with a leader of its own."""


def open_screen() -> None:
    """Open the terminal UI until it is closed."""
    from capture_app.tui.app import run_app

    run_app()
