"""The command `capture-app`."""


def main() -> None:
    """Run the command line."""
    raise SystemExit("not built yet")
