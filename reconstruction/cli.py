"""The command `reconstruct`; what is heavy is imported when it is needed."""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from capture_app import __version__
from capture_app.errors import ExitCode, SimulshotError
from reconstruction.commands.arguments import Finite, Offsets, Pair
from reconstruction.commands.batch import batch
from reconstruction.commands.calibrate import calibrate
from reconstruction.commands.dose import dose
from reconstruction.commands.multiview import multiview
from reconstruction.commands.stereo import stereo
from reconstruction.commands.stitch import stitch


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="reconstruct")
def app() -> None:
    """Depth and panoramas from a session, and what synchronization does to them."""


@app.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--offset-ms",
    type=Finite(min=0, min_open=True, max=1e6),
    default=66.0,
    show_default=True,
    help="How late the second camera is in the offset condition, ms; the nearest whole frame is taken.",
)
@click.option("--stereo", type=Pair(), help="The two cameras for depth [default: chosen by what they see].")
@click.option("--stitch", type=Pair(), help="The two cameras for the panorama [default: likewise].")
@click.option(
    "--instants",
    type=click.IntRange(min=1),
    default=16,
    show_default=True,
    help="Use at most so many instants, spread over the burst.",
)
@click.option(
    "--offsets-ms",
    type=Offsets(),
    multiple=True,
    help="A further condition: how late each camera is, ms; may be given several times.",
)
@click.option(
    "--drawn", is_flag=True, help="A further condition: every camera off by one of -66, -33, 0, 33, 66 ms."
)
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    help="A further condition: another session of the same cameras, such as one without synchronization.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the result.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def compare(
    session: Path,
    offset_ms: float,
    stereo: tuple[str, str] | None,
    stitch: tuple[str, str] | None,
    instants: int,
    offsets_ms: tuple[tuple[tuple[str, float], ...], ...],
    drawn: bool,
    against: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    """Compare SESSION's images of the same instant with images taken some time apart.

    Writes metrics.json, pictures and a report.html that explains itself into the --out folder.
    """
    import msgspec

    from reconstruction.compare import CompareOptions
    from reconstruction.compare import compare as run
    from reconstruction.conditions import Condition

    options = CompareOptions(
        offset_ms=offset_ms,
        stereo=stereo,
        stitch=stitch,
        most_instants=instants,
        conditions=tuple(
            Condition(" ".join(f"{camera}={late:g}" for camera, late in listed), listed)
            for listed in offsets_ms
        ),
        drawn=drawn,
        against=against,
    )
    result = run(session, out, options)
    if as_json:
        click.echo(msgspec.json.encode(result).decode())
        return
    click.echo(result.verdict)
    click.echo(f"report: {out / result.report}")


app.add_command(batch)
app.add_command(calibrate)
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
