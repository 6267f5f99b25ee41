"""`reconstruct batch`: many sessions, instants and conditions, each unit once, whatever comes between."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import BadInputError, ExitCode, SimulshotError
from capture_app.session.files.locks import lock_file
from capture_app.session.files.output_folder import replaces_only
from capture_app.text import ProgressStep
from reconstruction.batch.executors import Executor
from reconstruction.batch.plan import MAKE, Failure, plan
from reconstruction.batch.rows import BatchResult, Row, failed_row, summarize, unit_row
from reconstruction.batch.summary import NAMES, write_summary
from reconstruction.batch.units import UNITS, WORK, Outcome, Unit, is_done, tidy
from reconstruction.session.conditions import SYNCED, Condition

TIMINGS = "timings.csv"


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """What to make of every session; no instants: all that the conditions can be had of."""

    conditions: tuple[Condition, ...] = (Condition(SYNCED),)
    instants: tuple[int, ...] | None = None
    matcher: str = "sweep"


def batch(
    sessions: Sequence[Path],
    out: Path,
    options: BatchOptions,
    executor: Executor,
    say: Callable[[str], None] = lambda text: None,
    make: str = MAKE,
) -> BatchResult:
    """Make all units that are not in `out` yet, and the summary of all; `say` gets the progress lines.

    Units that fail are in the result, and leave the others alone.

    Raises:
        BadInputError: `out` cannot be used or is in use.
    """
    began = time.monotonic()
    conditions = list(dict.fromkeys(options.conditions))
    with _ours(out) as root:
        units, failures = _plan(sessions, conditions, options)
        todo = [unit for unit in units if not is_done(unit, root)]
        there = len(units) - len(todo)
        for failure in failures:
            say(f"failed: {_where(failure)}: {failure.problem}")
        if there:
            say(f"{there} of {len(units)} units are there already")
        try:
            outcomes = _work(todo, there, root, executor, say, make)
        finally:
            tidy(root)
        rows = [_row(unit, root, outcomes) for unit in units] + [failed_row(failure) for failure in failures]
        made = sum(outcome.made for outcome in outcomes.values())
        failed = sum(bool(row.problem) for row in rows)
        result = BatchResult(
            out=str(out),
            made=made,
            # Also what somebody else finished meanwhile.
            there=len(rows) - made - failed,
            failed=failed,
            groups=summarize(rows),
            units=tuple(rows),
            seconds=round(time.monotonic() - began, 3),
        )
        write_summary(root, result)
    return result


def exit_code(result: BatchResult) -> ExitCode:
    """OK; what went wrong where nothing went right; INCOMPLETE where some did."""
    codes = {row.code for row in result.units if row.problem}
    if not codes:
        return ExitCode.OK
    if result.failed == len(result.units) and len(codes) == 1:
        return ExitCode(codes.pop())
    return ExitCode.INCOMPLETE


def _plan(
    sessions: Sequence[Path], conditions: Sequence[Condition], options: BatchOptions
) -> tuple[list[Unit], list[Failure]]:
    units: dict[str, Unit] = {}
    failures: list[Failure] = []
    for session in sessions:
        try:
            found, refused = plan(session, conditions, options.instants, options.matcher)
        except SimulshotError as error:
            failures.append(Failure(name=session.name, problem=str(error), code=error.exit_code))
            continue
        except OSError as error:
            failures.append(Failure(name=session.name, problem=str(error), code=ExitCode.FAILURE))
            continue
        # The same session named twice is one.
        units.update((unit.key, unit) for unit in found)
        failures += refused
    return list(units.values()), failures


def _work(
    units: Sequence[Unit],
    there: int,
    root: Path,
    executor: Executor,
    say: Callable[[str], None],
    make: str,
) -> dict[str, Outcome]:
    labels = {unit.key: unit.label for unit in units}
    outcomes: dict[str, Outcome] = {}
    began = time.monotonic()
    with closing(executor.run(make, units, root)) as running:
        for outcome in running:
            outcomes[outcome.key] = outcome
            label = labels[outcome.key]
            how = f"failed: {outcome.problem}" if outcome.problem else f"{outcome.seconds:.1f} s"
            left = (time.monotonic() - began) / len(outcomes) * (len(units) - len(outcomes))
            ahead = f", about {_duration(left)} left" if len(outcomes) < len(units) else ""
            say(str(ProgressStep(there + len(outcomes), there + len(units), f"{label}: {how}{ahead}")))
            if outcome.made:
                # No reason to stop: on a full disk the units say so.
                with suppress(OSError), (root / WORK / TIMINGS).open("a") as file:
                    file.write(f"{outcome.key},{outcome.seconds:.3f},{label}\n")
    return outcomes


def _row(unit: Unit, root: Path, outcomes: dict[str, Outcome]) -> Row:
    outcome = outcomes.get(unit.key)
    if outcome is not None and outcome.problem:
        failure = Failure(
            name=unit.name,
            instant=unit.instant,
            condition=unit.condition,
            problem=outcome.problem,
            code=outcome.code,
        )
        return failed_row(failure)
    return unit_row(unit, root)


def _where(failure: Failure) -> str:
    instant = f", instant {failure.instant}" if failure.instant is not None else ""
    return f"{failure.name}{instant}{f', {failure.condition}' if failure.condition else ''}"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


@contextmanager
def _ours(out: Path) -> Iterator[Path]:
    """The batch's folder, for one batch at a time."""
    root = out.resolve()
    try:
        if root.exists():
            replaces_only({UNITS, WORK, *NAMES})(root)
        lock = lock_file(root / WORK / "batch.lock")
    except BlockingIOError:
        raise BadInputError(
            f"another batch is at work in {out}", hint="wait for it, or choose another --out"
        ) from None
    except OSError as error:
        raise BadInputError(
            f"cannot write to {out}: {error.strerror or error}", hint="choose another --out"
        ) from error
    try:
        yield root
    finally:
        os.close(lock)
