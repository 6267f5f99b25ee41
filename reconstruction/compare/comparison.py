"""`reconstruct compare`: the effect of synchronization on one burst, measured by all installed studies."""

from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Self, TypeVar

from msgspec import structs

from capture_app.common import system
from capture_app.common.errors import BadInputError
from capture_app.common.instants import COMPARED_MS
from capture_app.console.terminal import Progress, talk
from capture_app.session.files.output_folder import OutputFolder
from reconstruction.common.options import compare_keywords
from reconstruction.common.outputs import REPORT, comparison_folder, write_metrics
from reconstruction.common.worker_pool import worker_pool
from reconstruction.compare.tolerance_study import measure_curve, whole_frame_offsets
from reconstruction.method.comparison_results import CompareResult, ConditionResult
from reconstruction.method.interface import scored
from reconstruction.method.score import TIMING, Context, Score, say_all, study_reports
from reconstruction.method.timing import Timing, measure_pair_timing, measure_rig_timing, with_depth
from reconstruction.report.comparison_report import report_words, write_report
from reconstruction.report.findings import verdict
from reconstruction.scene.conditions import (
    Condition,
    evenly_spaced,
    nearest_frame_offset,
)
from reconstruction.scene.instant_choice import fixed_offsets_ms
from reconstruction.scene.provenance import with_provenance
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.pair_offset import PairOffsets

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of a comparison; `of` combines them with the studies' own options."""

    offset_ms: float = COMPARED_MS
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
        known = [keyword for kind in scored() for keyword in compare_keywords(kind)]
        if unknown := [name for name in options if name not in known]:
            raise BadInputError(
                f"{unknown[0]} is not an option of a comparison",
                hint=f"studies have {', '.join(dict.fromkeys(known))}",
            )
        return cls(**own, of_studies=options)


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder is written atomically.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or a requested feature is not
          available here.
    """
    with comparison_folder(out) as output:
        comparison = Comparison(session, output, options)
        comparison.calibrate()
        with closing(comparison.measure_studies()) as steps:
            for running in steps:
                if comparison.write_page(running):
                    talk(f"first pictures, more follow: {out / REPORT}")
        comparison.measure_further_conditions()
        return comparison.write()


def run_in_order(
    needs: Mapping[str, Sequence[str]], run: Callable[[str], T]
) -> Generator[tuple[str, T], None, None]:
    """Run tasks side by side, each as soon as the tasks that it needs are done; yield names and results.

    Of several that may start, the first of `needs` starts first.

    Raises:
        BadInputError: tasks need each other.
    """
    order, running = TopologicalSorter(needs), dict[Future[T], str]()
    try:
        order.prepare()
    except CycleError as error:
        raise BadInputError(
            f"studies need each other's results: {', '.join(error.args[1])}",
            hint="leave one out: --study names those to make",
        ) from error
    with worker_pool(min(4, len(system.usable_cores()))) as pool:
        while order.is_active():
            for name in sorted(order.get_ready(), key=list(needs).index):
                running[pool.submit(run, name)] = name
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                name = running.pop(future)
                yield name, future.result()
                order.done(name)


class Comparison:
    """A session under two conditions, and what each method's study has found so far."""

    def __init__(self, session: Path, output: OutputFolder, options: CompareOptions) -> None:
        """Open the session, and check everything that can be refused before it takes long; see `compare`."""
        self._began_s = system.monotonic_s()
        scene = Scene.open(session, options.time_shifts_ms)
        self.against = None if options.against is None else Scene.open(options.against)
        for opened in filter(None, (scene, self.against)):
            opened.given  # noqa: B018  (refuses one that does not fit the images)
        dataset = scene.dataset
        offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
        conditions = tuple(condition.named(dataset) for condition in options.conditions)
        self.output, self.options = output, replace(options, conditions=conditions)
        self.context = Context(
            scene=scene,
            step=offset.step,
            offset=offset,
            middle=offset.pairs[len(offset.pairs) // 2][0],
            max_instants=options.max_instants,
            options=options.of_studies,
            studies=options.studies,
            folder=output.folder,
            progress=Progress(6),
        )
        self.studies = {name: kind(self.context) for name, kind in study_reports().items()}
        self.chosen = _chosen(self.studies, options.studies)
        for study in self.chosen.values():
            study.check()
        self.known: dict[str, Any] = {
            "session": str(session),
            "labels": dataset.other_labels,
            "origin": dataset.session.manifest.origin,
            "camera_count": len(dataset.cameras),
            "instant_count": len(dataset.instants_ns),
            "offset_ms": offset.asked_ms,
            "offset_frames": offset.frames,
            "actual_offset_ms": offset.actual_ms,
            "unsynchronized": dataset.unsynchronized,
            "staggered": dataset.staggered,
            "sync_residual_us": dataset.worst_residual_us(),
            "sync_bound_us": dataset.worst_hard_bound_us(),
            "imported_error": dataset.imported_error,
            "studies": (),
        }
        """Fields of the result, as far as they are found."""

    def calibrate(self) -> None:
        """Detect motion and calibrate; without a calibration, studies that need one are skipped."""
        scene, offset, progress = self.context.scene, self.context.offset, self.context.progress
        progress.total += sum(study.steps for study in self.chosen.values()) + len(self.options.conditions)
        progress.total += (self.against is not None) + (len(scene.dataset.cameras) > 2)
        progress.step(f"detecting motion in {scene.dataset.name}")
        shown = [k for k, _ in evenly_spaced(offset.pairs if offset else (), 4)]
        self.known["moving_share"] = self.context.compared.moving_share(shown)
        progress.step("calibration")
        for judged in filter(None, (self.against, self.context.compared)):
            if judged.given is not None and judged.check.by_lenses and not judged.check.holds:
                raise BadInputError(
                    f"the calibration of {judged.dataset.name} does not hold for its pictures: "
                    f"{judged.check}",
                    hint=f"calibrate again: reconstruct calibrate {judged.dataset.session.folder} --replace",
                )
        if not scene.problem:
            check = self.context.compared.check
            px = None if check.error_px is None else round(check.error_px, 3)
            self.known |= {"rest_error_px": px, "rest_points": check.points}
        progress.step("choosing cameras")

    def measure_studies(self) -> Generator[tuple[str, ...], None, None]:
        """Measure both conditions with every study, side by side; yield the subjects that are left.

        Raises:
            NotAvailableError: nothing could be made, as the calibration needs a package that is missing.
        """
        # A pair's depth gives the first pictures soon; the others begin with the last, which are quick.
        pairs = [name for name, study in self.chosen.items() if study.of_pair]
        names = [*pairs, *(name for name in reversed([*self.chosen]) if name not in pairs)]
        known = (*names, TIMING)
        needs = {name: [need for need in self.chosen[name].needs if need in known] for name in names}
        left = {name: self.chosen[name].text.subject for name in names} | {TIMING: "time offsets"}
        with closing(run_in_order(needs | {TIMING: pairs}, self._measure)) as steps:
            for name, result in steps:
                del left[name]
                added = result if name == TIMING else {"studies": (*self.known["studies"], result)}
                self.known = self.known | added  # a new one: studies that run read the one before
                yield tuple(left.values())
        if not self._has_measures:
            with suppress(BadInputError):
                self.context.scene.calibration  # noqa: B018  (raises why there is none)
        self.known["studies"] += tuple(
            study.found for name, study in self.studies.items() if name not in self.chosen
        )

    def _measure(self, name: str) -> Any:
        """Return the result of one study, or the fields that the measurement of time offsets adds."""
        if name == TIMING:
            return _measure_timing(self.context, self.chosen)
        study = self.chosen[name]
        return study.run(_limited(self.known, study))

    @property
    def _has_measures(self) -> bool:
        return any(study.measures for study in self.known["studies"])

    def measure_further_conditions(self) -> None:
        """Compare the requested conditions, and another session, with every study."""
        made = [study for study in self.chosen.values() if study.has_conditions and not study.found.skipped]
        scene, step, against = self.context.scene, self.context.progress.step, self.against
        compared = []
        for condition in self.options.conditions:
            step(f"condition {condition.name}")
            studies = tuple(study.compare_condition(condition) for study in made)
            offsets_ms = fixed_offsets_ms(condition, scene.dataset)
            compared.append(ConditionResult(name=condition.name, offsets_ms=offsets_ms, studies=studies))
        if against is not None:
            name, folder = against.dataset.name, str(against.dataset.session.folder)
            step(f"session {name}")
            # The other session uses its own calibration if it has one, else this session's.
            known = against.given or (None if scene.problem else scene.calibration)
            studies = tuple(study.compare_session(against.calibrated(known)) for study in made)
            compared.append(ConditionResult(name=name, session=folder, studies=studies))
        self.known["conditions"] = tuple(compared)

    def write_page(self, running: Sequence[str]) -> bool:
        """Write the page if something is measured, and show it in the target; return whether it is new.

        `running`: the subjects that are still measured.
        """
        if not self._has_measures:
            return False
        write_report(self._result(), self.output.folder, running)
        return self.output.show_early(REPORT)

    def write(self) -> CompareResult:
        """Write the report and the metrics, and return the result."""
        self.context.progress.last("report")
        result = self._result(report=REPORT)
        write_report(result, self.output.folder)
        write_metrics(self.output.folder, result)
        return result

    def _result(self, **more: Any) -> CompareResult:
        """Return everything found so far, in the studies' order, and its words."""
        order = [*self.studies]
        made = tuple(sorted(self.known["studies"], key=lambda study: order.index(study.name)))
        scene = self.context.scene
        fields = self.known | {"studies": made, "calibration": scene.source, "lenses": scene.lenses}
        result = with_provenance(CompareResult(**fields, **more), self._began_s, self.options.time_shifts_ms)
        return structs.replace(result, verdict=say_all(result, verdict), words=say_all(result, report_words))


def _chosen(studies: Mapping[str, Score], names: Sequence[str]) -> dict[str, Score]:
    """Return the named studies and all that they need, in order; all studies if no name is given."""
    if unknown := [name for name in names if name not in studies and name != TIMING]:
        raise BadInputError(
            f"{unknown[0]!r} is not a study of a comparison", hint=f"installed: {', '.join(studies)}"
        )
    requested = set[str](names or studies)
    while needed := {need for name in requested & studies.keys() for need in studies[name].needs} - requested:
        requested |= needed
    return {name: study for name, study in studies.items() if name in requested}


def _limited(known: Mapping[str, Any], study: Score) -> CompareResult:
    """Return the known results without those that a study does not need."""
    unneeded = () if TIMING in study.needs else ("timing", "rig_timing", "tolerance")
    needed = tuple(other for other in known["studies"] if other.name in study.needs)
    return CompareResult(**{k: v for k, v in known.items() if k not in unneeded} | {"studies": needed})


def _measure_timing(context: Context, studies: Mapping[str, Score]) -> dict[str, Any]:
    """Measure the time offsets on the first pair studied, and the delay that its depth tolerates.

    Returns these fields of `CompareResult`; none without a calibration.
    """
    if context.scene.problem:
        return {}
    offsets = PairOffsets(context.compared)
    pairs = (study for study in studies.values() if study.of_pair and not study.found.skipped)
    study = next(pairs, None)
    fields: dict[str, Any] = {}
    with worker_pool(1) as pool:
        if len(context.scene.views) > 2:
            context.progress.step("time offsets of all cameras")
            rig = pool.submit(measure_rig_timing, offsets, study.pair if study else None)
        if study:
            fields |= _measure_pair_timing(context, offsets, study)
        if len(context.scene.views) > 2:
            fields["rig_timing"] = rig.result()
            if study:
                fields["timing"] = _naming_the_odd_one(offsets, fields["timing"], rig.result().reference)
    return fields


def _naming_the_odd_one(offsets: PairOffsets, timing: Timing, reference: str) -> Timing:
    """Return a pair's judgement, of its first camera if the second is the rig's reference."""
    if timing.other != reference or not timing.offset or timing.by_depth or timing.late_ms is None:
        return timing
    turned = measure_pair_timing(offsets, timing.cameras[::-1])
    return turned if turned.offset else timing


def _measure_pair_timing(context: Context, offsets: PairOffsets, study: Score) -> dict[str, Any]:
    """Measure the time offset of a study's pair, and the delay that its depth tolerates."""
    first, second = (context.scene.dataset.labels[name] for name in study.cameras)
    context.progress.step(f"time offset of {second} against {first}")
    timing = measure_pair_timing(offsets, study.pair)
    if not study.measures_delay or context.scene.lenses.doubt():
        return {"timing": timing}
    timing = with_depth(timing, study.found)
    context.progress.step("depth at different offsets")
    with suppress(ValueError, BadInputError):
        delay_ms = max(context.offset.actual_ms if context.offset else 0.0, COMPARED_MS)
        # `reconstruct tolerance` uses more.
        quiet = replace(
            context,
            max_instants=min(6, context.max_instants),
            progress=Progress(0, silent=True),
        )
        steps = whole_frame_offsets(context.scene.dataset, delay_ms)
        curve = measure_curve(type(study), quiet, study.pair, steps, timing)
        return {"tolerance": curve, "timing": curve.timing}
    return {"timing": timing}
