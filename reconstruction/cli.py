"""The command `reconstruct`; what is heavy is imported when it is needed."""

import signal
import sys
from collections.abc import Sequence

import click

from capture_app import __version__
from capture_app.terminal import run_command_line
from reconstruction.commands.batch import batch
from reconstruction.commands.calibrate import calibrate
from reconstruction.commands.compare import compare
from reconstruction.commands.dose import dose
from reconstruction.commands.multiview import multiview
from reconstruction.commands.stereo import stereo
from reconstruction.commands.stitch import stitch


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True}
)
@click.version_option(__version__, prog_name="reconstruct")
def app() -> None:
    """Compute depth and panoramas from a session, and measure what synchronization does for them."""


app.add_command(batch)
app.add_command(calibrate)
app.add_command(compare)
app.add_command(dose)
app.add_command(multiview)
app.add_command(stereo)
app.add_command(stitch)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; an error is one line on stderr and an exit code."""
    if arguments is None:
        # Whoever ends this process means it to tidy up as after Ctrl-C.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        arguments = sys.argv[1:]
    code = run_command_line(app, "reconstruct", arguments)
    if code:
        sys.exit(code)


if __name__ == "__main__":
    main()
