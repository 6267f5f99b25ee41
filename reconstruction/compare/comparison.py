"""`reconstruct compare`: the effect of synchronization on one burst, measured by all installed studies."""

import time
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Self

from msgspec import structs

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.console.terminal import Progress, talk
from reconstruction.calibration.calibrated_rig import Rig
from reconstruction.calibration.stored import choose_calibration
from reconstruction.common.memory import usable_cores
from reconstruction.common.options import compare_keywords
from reconstruction.common.outputs import STAGES, comparison_folder, write_metrics
from reconstruction.common.worker_pool import worker_pool
from reconstruction.compare.method import compare_options
from reconstruction.compare.study import TIMING, ConditionStudy, Context, PairStudy, Study
from reconstruction.compare.tolerance_study import measure_curve, whole_frame_offsets
from reconstruction.report.comparison_report import report_words, write_report
from reconstruction.report.findings import verdict
from reconstruction.report.page import REPORT
from reconstruction.report.study_report import study_reports
from reconstruction.scores.comparison_results import CompareResult, ConditionResult
from reconstruction.scores.timing import measure_pair_timing, measure_rig_timing, with_depth
from reconstruction.session.conditions import (
    DEFAULT_OFFSET_MS,
    Condition,
    evenly_spaced,
    nearest_frame_offset,
)
from reconstruction.session.dataset import Dataset
from reconstruction.session.instant_choice import fixed_offsets_ms
from reconstruction.session.provenance import with_provenance
from reconstruction.time_offsets.pair_offset import PairOffsets

TOLERANCE_INSTANTS = 6
"""Instants of the tolerance curve in a comparison; `reconstruct tolerance` uses more."""
MAX_SIDE_BY_SIDE = 4
"""Maximum number of studies at a time, at most one a core."""
CORE_STEPS = 6
"""Progress lines of a comparison besides the lines of its studies."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of a comparison; `of` combines them with the studies' own options."""

    offset_ms: float = DEFAULT_OFFSET_MS
    max_instants: int = 16
    conditions: tuple[Condition, ...] = ()
    """Further conditions besides each study's own."""
    against: Path | None = None
    """Another session to compare with."""
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """Corrections added to the times of the named cameras."""
    studies: tuple[str, ...] = ()
    """Names of the studies to make; empty = all."""
    of_studies: Mapping[str, Any] = field(default_factory=dict)
    """Options of studies, by their keywords."""

    @classmethod
    def of(cls, **options: Any) -> Self:
        """Create options by name, including the studies' options.

        Raises:
            BadInputError: no installed study has such an option.
        """
        own = {name: options.pop(name) for name in cls.__dataclass_fields__ if name in options}
        known = [keyword for kind in compare_options() for keyword in compare_keywords(kind)]
        if unknown := [name for name in options if name not in known]:
            raise BadInputError(
                f"{unknown[0]} is not an option of a comparison",
                hint=f"studies have {', '.join(dict.fromkeys(known))}",
            )
        return cls(**own, of_studies=options)


def installed_studies() -> list[type[Study]]:
    """Return the classes of the studies that a comparison makes, in order."""
    return [kind for kind in study_reports().values() if issubclass(kind, Study)]


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder is written atomically.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or a requested feature is not
          available here.
    """
    began = time.monotonic()
    dataset = Dataset.open(session, options.time_shifts_ms)
    choose_calibration(dataset)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    for condition in options.conditions:
        condition.check(dataset)
    against = Dataset.open(options.against) if options.against is not None else None
    with comparison_folder(out) as output:
        context = Context(
            rig=Rig(dataset, output.folder / STAGES, offset.step),
            offset=offset,
            middle=offset.pairs[len(offset.pairs) // 2][0],
            max_instants=options.max_instants,
            options=options.of_studies,
            folder=output.folder,
            progress=Progress(CORE_STEPS),
        )
        studies = {kind.text.name: kind(context) for kind in installed_studies()}
        asked = _chosen(studies, options.studies)
        for study in asked.values():
            study.check()
        context.progress.total += (
            sum(study.steps for study in asked.values())
            + len(options.conditions)
            + (against is not None)
            + (len(dataset.cameras) > 2)
        )
        known = CompareResult(
            session=str(session),
            origin=dataset.session.manifest.origin,
            camera_count=len(dataset.cameras),
            instant_count=len(dataset.instants_ns),
            offset_ms=offset.asked_ms,
            offset_frames=offset.frames,
            actual_offset_ms=offset.actual_ms,
            unsynchronized=dataset.unsynchronized,
            sync_residual_us=dataset.worst_residual_us(),
            sync_bound_us=dataset.worst_hard_bound_us(),
        )

        def filled(known: CompareResult, **more: Any) -> CompareResult:
            """Return the result with everything found so far, in the studies' order, and its words."""
            found = structs.replace(
                known,
                studies=tuple(sorted(known.studies, key=lambda one: [*studies].index(one.name))),
                calibration=context.rig.source,
                **more,
            )
            found = with_provenance(found, began, options.time_shifts_ms)
            return structs.replace(found, verdict=verdict(found), words=report_words(found))

        with closing(_run_studies(context, asked, known)) as steps:
            for known, running in steps:
                # The page appears with the first measurement.
                if any(one.measures for one in known.studies):
                    write_report(filled(known), output.folder, running)
                    if output.show_early(REPORT):
                        talk(f"first pictures, more follow: {out / REPORT}")
        unasked = [study.found for name, study in studies.items() if name not in asked]
        known = structs.replace(known, studies=(*known.studies, *unasked))
        further_found = _further_conditions(context, list(asked.values()), options.conditions, against)
        context.progress.last("report")
        result = filled(known, conditions=further_found, report=REPORT)
        write_report(result, output.folder)
        write_metrics(output.folder, result)
    return result


def _chosen(studies: Mapping[str, Study], names: Sequence[str]) -> dict[str, Study]:
    """Return the named studies and all that they need, in order; all studies if no name is given."""
    if unknown := [name for name in names if name not in studies and name != TIMING]:
        raise BadInputError(
            f"{unknown[0]!r} is not a study of a comparison", hint=f"installed: {', '.join(studies)}"
        )
    requested = set[str](names or studies)
    while needed := {one for name in requested & studies.keys() for one in studies[name].needs} - requested:
        requested |= needed
    return {name: study for name, study in studies.items() if name in requested}


def _run_studies(
    context: Context, studies: Mapping[str, Study], known: CompareResult
) -> Generator[tuple[CompareResult, tuple[str, ...]], None, None]:
    """Run each study as soon as those that it needs are done; skip an impossible one with its reason.

    Yields after each study what is known, with all results, and the subjects of the studies that are left.

    Raises:
        NotAvailableError: the calibration needs a package that is not installed, and nothing could be made.
    """
    rig, offset = context.rig, context.offset
    context.progress.step(f"detecting motion in {rig.dataset.name}")
    moving = rig.moving_share([k for k, _ in evenly_spaced(offset.pairs if offset else (), 4)])
    context.progress.step("calibration")
    no_views: BadInputError | NotAvailableError | None = None
    try:
        rig.calibrate()
    except (BadInputError, NotAvailableError) as error:
        no_views, rig.problem = error, str(error)
    known = structs.replace(known, moving_share=moving)
    context.progress.step("choosing cameras")
    # A pair's depth is quick and gives the first pictures; the others begin with the last, which are quick.
    pairs = [name for name, study in studies.items() if isinstance(study, PairStudy)]
    names = [*pairs, *(name for name in reversed([*studies]) if name not in pairs)]
    left = {**{name: studies[name].text.subject for name in names}, TIMING: "time offsets"}
    order, running = _order(studies), dict[Future[dict[str, Any]], str]()

    def run(name: str, known: CompareResult) -> dict[str, Any]:
        """Return the fields of the result that one step adds or extends."""
        if name == TIMING:
            return _measure_timing(context, studies)
        return {"studies": (studies[name].run(_limited(known, studies[name])),)}

    with worker_pool(min(MAX_SIDE_BY_SIDE, len(usable_cores()))) as pool:
        while order.is_active():
            for name in sorted(order.get_ready(), key=list(left).index):
                running[pool.submit(run, name, known)] = name
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                name, found = running.pop(future), future.result()
                del left[name]
                order.done(name)
                made = known.studies + found.pop("studies", ())
                known = structs.replace(known, studies=made, **found)
            yield known, tuple(left.values())
    if isinstance(no_views, NotAvailableError) and not any(one.measures for one in known.studies):
        raise no_views


def _order(studies: Mapping[str, Study]) -> TopologicalSorter[str]:
    """Return the studies in the order of their needs; `TIMING` follows all pair studies."""
    graph = {
        name: [one for one in study.needs if one in studies or one == TIMING]
        for name, study in studies.items()
    }
    graph[TIMING] = [name for name, study in studies.items() if isinstance(study, PairStudy)]
    order = TopologicalSorter(graph)
    try:
        order.prepare()
    except CycleError as error:
        raise BadInputError(
            f"studies need each other's results: {', '.join(error.args[1])}",
            hint="leave one out: --study names those to make",
        ) from error
    return order


def _limited(known: CompareResult, study: Study) -> CompareResult:
    """Return the known results without those that a study does not need."""
    needed = tuple(one for one in known.studies if one.name in study.needs)
    unneeded = {} if TIMING in study.needs else dict.fromkeys(("timing", "rig_timing", "tolerance"))
    return structs.replace(known, studies=needed, **unneeded)


def _measure_timing(context: Context, studies: Mapping[str, Study]) -> dict[str, Any]:
    """Measure the time offsets on the first pair studied, and the delay that its depth tolerates.

    Returns these fields of `CompareResult`; none without a calibration.
    """
    if context.rig.problem:
        return {}
    offsets = PairOffsets(context.rig)
    pairs = (one for one in studies.values() if isinstance(one, PairStudy) and not one.found.skipped)
    study = next(pairs, None)
    found: dict[str, Any] = {}
    with worker_pool(1) as pool:
        if len(context.rig.views) > 2:
            context.progress.step("time offsets of all cameras")
            rig = pool.submit(measure_rig_timing, offsets, study.cameras[0] if study else None)
        if study:
            found |= _measure_pair_timing(context, offsets, study)
        if len(context.rig.views) > 2:
            found["rig_timing"] = rig.result()
    return found


def _measure_pair_timing(context: Context, offsets: PairOffsets, study: PairStudy) -> dict[str, Any]:
    """Measure the time offset of a study's pair, and the delay that its depth tolerates."""
    context.progress.step(f"time offset of {study.cameras[1]} against {study.cameras[0]}")
    timing = measure_pair_timing(offsets, study.cameras)
    if not study.measures_delay:
        return {"timing": timing}
    timing = with_depth(timing, study.found)
    context.progress.step("depth at different offsets")
    with suppress(ValueError, BadInputError):
        delay_ms = max(context.offset.actual_ms if context.offset else 0.0, DEFAULT_OFFSET_MS)
        quiet = replace(
            context,
            max_instants=min(TOLERANCE_INSTANTS, context.max_instants),
            progress=Progress(0, silent=True),
        )
        steps = whole_frame_offsets(context.rig.dataset, delay_ms)
        curve = measure_curve(type(study), quiet, study.cameras, steps, timing)
        return {"tolerance": curve, "timing": curve.timing}
    return {"timing": timing}


def _further_conditions(
    context: Context, studies: Sequence[Study], conditions: Sequence[Condition], against: Dataset | None
) -> tuple[ConditionResult, ...]:
    """Compare the requested conditions, and another session, with every study."""
    made = [one for one in studies if isinstance(one, ConditionStudy) and not one.found.skipped]
    found = []
    for condition in conditions:
        context.progress.step(f"condition {condition.name}")
        compared = tuple(study.compare_condition(condition) for study in made)
        found.append(
            ConditionResult(
                name=condition.name,
                offsets_ms=fixed_offsets_ms(condition, context.rig.dataset),
                studies=compared,
            )
        )
    if against is not None:
        context.progress.step(f"session {against.name}")
        # The other session uses its own calibration if it has one, else this session's.
        rig = Rig(against, context.rig.stages.folder, context.offset.step if context.offset else 1)
        if calibration := against.calibration() or context.rig.calibration:
            rig.use_calibration(calibration)
        compared = tuple(study.compare_session(rig) for study in made)
        found.append(
            ConditionResult(name=against.name, session=str(against.session.folder), studies=compared)
        )
    return tuple(found)
