"""The command `reconstruct`; what is heavy is imported when it is needed."""

import os
import signal
import sys
from collections.abc import Sequence

import click

from capture_app import __version__
from capture_app.errors import ExitCode, SimulshotError
from reconstruction.commands.batch import batch
from reconstruction.commands.calibrate import calibrate
from reconstruction.commands.compare import compare
from reconstruction.commands.dose import dose
from reconstruction.commands.multiview import multiview
from reconstruction.commands.stereo import stereo
from reconstruction.commands.stitch import stitch


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="reconstruct")
def app() -> None:
    """Depth and panoramas from a session, and what synchronization does to them."""


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
    try:
        app.main(args=arguments, prog_name="reconstruct", standalone_mode=False)
    except SimulshotError as error:
        _fail(str(error), error.exit_code)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        _fail("interrupted", ExitCode.INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(ExitCode.FAILURE)
    except OSError as error:
        _fail(str(error), ExitCode.FAILURE)


def _fail(what: str, code: int) -> None:
    click.echo(f"reconstruct: error: {' '.join(what.split())}", err=True)
    sys.exit(int(code))


if __name__ == "__main__":
    main()
