"""`reconstruct batch`: depth of many sessions, instants and conditions, each computed once."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from capture_app.common import system
from capture_app.common.errors import ExitCode, NotApplicableError, SimulshotError
from capture_app.common.text import ProgressStep, rough_time
from capture_app.console.terminal import talk
from capture_app.session.files.output_folder import growing_folder
from reconstruction.methods.batch.batch_plan import DEPTH_TASK, BatchPlan
from reconstruction.methods.batch.summary import (
    NAMES,
    BatchResult,
    UnitRow,
    completed_row,
    group_medians,
    judged_rows,
    unit_row,
    write_summary,
)
from reconstruction.methods.batch.units import UNITS, WORK, Outcome, Shard, Unit, is_done, remove_leftovers
from reconstruction.methods.batch.workers import Workers


def batch(
    sessions: Sequence[Path],
    out: Path,
    plan: BatchPlan,
    workers: Workers,
    task: str = DEPTH_TASK,
    shard: Shard | None = None,
) -> BatchResult:
    """Compute all units that are not in `out` yet, and the summary of all.

    Failed units are listed in the result and do not affect the others. With a `shard`, compute its units
    only, and no summary; other shards may run at the same time.

    Raises:
        BadInputError: `out` cannot be used.
        TryAgainError: another run is writing to `out`, or the shard is running.
    """
    began = system.monotonic_s()
    lock = f"{WORK}/{shard.name if shard else 'batch'}.lock"
    with growing_folder(out, lock, {UNITS, WORK, *NAMES}) as root:
        units, failures = _plan(sessions, plan)
        if shard:
            units = list(shard.units(units))
        missing = [unit for unit in units if not is_done(unit, root)]
        done = len(units) - len(missing)
        for failure in failures:
            talk(f"{failure.label}: {failure.problem}")
        if done:
            talk(f"reusing {done} of {len(units)} results")
        try:
            outcomes = _run_units(missing, done, root, workers, task)
        finally:
            remove_leftovers(root)
        result = _result(out, root, units, outcomes, failures, began)
        if not shard:
            write_summary(root, result)
    return result


def summarize(sessions: Sequence[Path], out: Path, plan: BatchPlan) -> BatchResult:
    """Write the summary of the units that are in `out`, and compute none; missing ones are failures.

    Raises as `batch` does.
    """
    began = system.monotonic_s()
    with growing_folder(out, f"{WORK}/batch.lock", {UNITS, WORK, *NAMES}) as root:
        units, failures = _plan(sessions, plan)
        remove_leftovers(root)
        missing = {
            unit.key: Outcome(key=unit.key, error="it is not computed yet", exit_code=ExitCode.INCOMPLETE)
            for unit in units
            if not is_done(unit, root)
        }
        result = _result(out, root, units, missing, failures, began)
        write_summary(root, result)
    return result


def _result(
    out: Path,
    root: Path,
    units: Sequence[Unit],
    outcomes: Mapping[str, Outcome],
    failures: Sequence[UnitRow],
    began: float,
) -> BatchResult:
    """Return the rows of units, those that this run computed by their `outcomes`, and of failures."""
    rows = judged_rows([*(_row(unit, root, outcomes) for unit in units), *failures])
    skipped = {unit.key for unit, row in zip(units, rows, strict=False) if row.not_applicable}
    computed = sum(outcome.computed for key, outcome in outcomes.items() if key not in skipped)
    return BatchResult(
        out=str(out),
        computed=computed,
        # Includes units that another process finished meanwhile.
        reused=sum(not row.problem for row in rows) - computed,
        failed=sum(bool(row.error) for row in rows),
        not_applicable=sum(bool(row.not_applicable) for row in rows),
        groups=group_medians(rows),
        units=tuple(rows),
        seconds=round(system.monotonic_s() - began, 3),
    )


def exit_code(result: BatchResult) -> ExitCode:
    """Return the exit code of a batch.

    OK without failures; the common code if every unit failed with the same one; else INCOMPLETE. BAD_INPUT if
    no unit is applicable; among units that are done, such a unit is not a failure.
    """
    if not (codes := {row.exit_code for row in result.units if row.error}):
        return ExitCode.BAD_INPUT if 0 < len(result.units) == result.not_applicable else ExitCode.OK
    every_one = result.failed == len(result.units) and len(codes) == 1
    return ExitCode(codes.pop()) if every_one else ExitCode.INCOMPLETE


def _plan(sessions: Sequence[Path], plan: BatchPlan) -> tuple[list[Unit], list[UnitRow]]:
    """Return all units, and rows for sessions and units that cannot be started."""
    units: dict[str, Unit] = {}
    failures: list[UnitRow] = []
    for session in sessions:
        try:
            found, refused = plan.units(session)
        except NotApplicableError as error:
            failures.append(UnitRow(session=session.name, not_applicable=str(error)))
        except (SimulshotError, OSError) as error:
            code = error.exit_code if isinstance(error, SimulshotError) else ExitCode.FAILURE
            failures.append(UnitRow(session=session.name, error=str(error), exit_code=code))
        else:
            # A session named twice counts once.
            units.update((unit.key, unit) for unit in found)
            failures += refused
    return list(units.values()), failures


def _run_units(
    units: Sequence[Unit],
    done: int,
    root: Path,
    workers: Workers,
    task: str,
) -> dict[str, Outcome]:
    """Run the units; `done` existing results count in the progress lines."""
    by_key = {unit.key: unit for unit in units}
    outcomes: dict[str, Outcome] = {}
    began = system.monotonic_s()
    try:
        with closing(workers.run_units(task, units, root)) as running:
            for outcome in running:
                outcomes[outcome.key] = outcome
                row = _row(by_key[outcome.key], root, outcomes)
                how = row.problem or f"{outcome.seconds:.1f} s"
                left_s = (system.monotonic_s() - began) / len(outcomes) * (len(units) - len(outcomes))
                left = f", about {rough_time(left_s)} left" if len(outcomes) < len(units) else ""
                talk(str(ProgressStep(done + len(outcomes), done + len(units), f"{row.label}: {how}{left}")))
    except KeyboardInterrupt:
        saved = sum(not outcome.error for outcome in outcomes.values())
        talk(f"stopping: {saved} of {len(units)} results are saved; repeat the command to compute the others")
        raise
    return outcomes


def _row(unit: Unit, root: Path, outcomes: Mapping[str, Outcome]) -> UnitRow:
    outcome = outcomes.get(unit.key)
    if outcome is None or not outcome.error:
        return completed_row(unit, root)
    return unit_row(unit, error=outcome.error, exit_code=outcome.exit_code)
