"""The paper's tables and figures, and more tables of ours beside its numbers: all simulated.

What can be run; without a name all of it runs, one after the other:

"""

import sys
from argparse import Namespace
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.paper import page, scale
from benchmarks.paper.report import PaperReport
from benchmarks.paper.result import Outcome, outcome_lines
from benchmarks.paper.values import FIGURES, TABLES
from benchmarks.report import new_parser, print_table
from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.companions.link.link_command import require_plots
from capture_app.console.terminal import print_json, print_line, talk

STUDIES = {
    "clock-filters": "clock estimators under seven delay distributions: mean, minimum, ours",
    "phase": "frame injections, restarts and frame durations that phase alignment takes",
    "scale": "thousands of clocks for an hour: one leader, and a tree of relays",
}
"""Name and content of each experiment; its module has the same name, with underscores."""
PAPER = "paper"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line names; return the exit code."""
    names = {**STUDIES, PAPER: "every table and figure of the paper on one page, ours beside them"}
    listed = "\n".join(f"  {name:21}{text}" for name, text in names.items())
    parser = new_parser(f"{__doc__}{listed}", seed_of="all trials")
    parser.add_argument("name", nargs="?", choices=names, metavar="NAME")
    parser.add_argument("--trials", type=int, metavar="N", help="number of trials of a study (its own)")
    parser.add_argument("--quick", action="store_true", help="a quarter of the trials")
    of_paper = parser.add_argument_group(PAPER)
    of_paper.add_argument(
        "--out", type=Path, default=Path(PAPER), metavar="DIR", help="folder for the page and its pictures"
    )
    of_paper.add_argument(
        "--only",
        metavar="KEY",
        action="append",
        default=[],
        choices=[one.key for one in (*TABLES, *FIGURES)],
        help="measure this table or figure only, such as table-2; repeat for several",
    )
    of_paper.add_argument(
        "--markdown", metavar="FILE", type=Path, help="write the page here, too, its pictures into images/"
    )
    of_scale = parser.add_argument_group("scale")
    of_scale.add_argument("--clients", metavar="N", type=int, action="append", help="repeat for several rigs")
    of_scale.add_argument("--minutes", type=float, help="simulated time (5)")
    of_scale.add_argument("--shape", choices=scale.SHAPES, help="one leader for all, or a tree of relays")
    of_scale.add_argument(
        "--shards", type=int, metavar="N", help="simulate so many of each rig's shards, for all"
    )
    of_scale.add_argument(
        "--sparing", action="store_true", help="clients ask once a second from the start: for thousands"
    )
    options = parser.parse_args(arguments)
    try:
        _run(options, [options.name] if options.name else list(names))
    except SimulshotError as error:
        talk(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    return ExitCode.OK


def _run(options: Namespace, names: Sequence[str]) -> None:
    """Run the named experiments; the JSON of several is one object, by name."""
    if PAPER in names:
        require_plots(options.out)
    found: dict[str, Any] = {}
    for name in names:
        talk(f"{name} ...")
        if name == PAPER:
            found[name] = page.run(
                options.out,
                quick=options.quick,
                seed=options.seed,
                markdown=options.markdown,
                only=frozenset(options.only),
            )
            if not options.json:
                _print_headlines(found[name], options.out)
            continue
        outcome = _measure(name, options)
        found[name] = outcome.result
        if not options.json:
            print_line("\n".join(outcome_lines(outcome)))
    if options.json:
        print_json(found if len(names) > 1 else found[names[0]])


def _measure(name: str, options: Namespace) -> Outcome:
    study: Any = import_module(f"{__package__}.{name.replace('-', '_')}")
    trials = options.trials
    if trials is None and options.quick:
        trials = max(1, round(page.QUICK_SHARE * study.TRIALS))
    if study is not scale:
        outcome: Outcome = study.run(trials=trials, seed=options.seed)
        return outcome
    size = scale.ScaleOptions(
        sizes=options.clients or scale.SIZES,
        minutes=options.minutes or scale.MINUTES,
        shapes=(options.shape,) if options.shape else scale.SHAPES,
        most_shards=options.shards,
        sparing=options.sparing,
    )
    return scale.run(trials=trials, seed=options.seed, options=size)


def _print_headlines(report: PaperReport, out: Path) -> None:
    rows = [(f"{entry.place}: {row.label}", *page.cells(row)) for entry, row in page.headlines(report)]
    print_table(page.HEAD, rows)
    print_line(f"\n{out / page.PAGE}")


if __name__ == "__main__":
    sys.exit(main())
