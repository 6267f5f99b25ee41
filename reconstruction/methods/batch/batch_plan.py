"""Units of a session and their computation: the depth of an instant in a condition."""

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import msgspec

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.common.text import pretty_json
from capture_app.session.files.durable import write_atomic
from reconstruction.common.matchers import Matcher
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.picture_checksums import checked_pictures
from reconstruction.method.interface import find_method
from reconstruction.methods.batch.summary import UnitRow, unit_row
from reconstruction.methods.batch.units import RESULT, Unit
from reconstruction.scene.conditions import SYNCED, Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene

DEPTH_TASK = "reconstruction.methods.batch.batch_plan:compute_depth"
DEPTH_METHOD = "multiview"
"""The method that computes a unit."""
SPLAT_METHOD, SPLAT = "splat", "splat.ply"


@cache
def program_checksum() -> str:
    """Return a checksum of this package's source and the library versions, on which results depend."""
    digest = hashlib.sha256(repr(sorted(library_versions().items())).encode())
    here = Path(__file__).parents[2]
    for path in sorted(path for path in here.rglob("*") if path.suffix in (".py", ".c")):
        digest.update(f"{path.relative_to(here)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class BatchPlan:
    """What a batch computes of each session.

    `instants` None: every instant for which the burst has the condition's images.
    """

    conditions: tuple[Condition, ...] = (Condition(SYNCED),)
    instants: tuple[int, ...] | None = None
    matcher: Matcher = Matcher.AUTO
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """Corrections added to the times of the named cameras."""
    splats: bool = False
    """Whether to make a Gaussian splat of each unit, too."""
    program: str = field(default_factory=program_checksum)
    """Checksum of the program; results of another program are computed again."""

    def units(self, session: Path) -> tuple[list[Unit], list[UnitRow]]:
        """Return a session's units, and rows for units that the burst does not contain.

        Raises:
            SimulshotError: the session cannot be used at all.
            NotApplicableError: the session is valid but has only one camera.
        """
        scene = Scene.open(session, self.time_shifts_ms)
        dataset = scene.dataset
        dataset.require_cameras(2, "depth needs two that see the same from different places")
        name = session.resolve().name
        source = dataset.fingerprint(scene.given)
        matcher, shifts = self.matcher.engine, dict(self.time_shifts_ms)
        units: list[Unit] = []
        failures: list[UnitRow] = []
        for condition in dict.fromkeys(self.conditions):
            made: list[Unit] = []
            refused: list[UnitRow] = []
            for instant in range(len(dataset.instants_ns)) if self.instants is None else self.instants:
                unit = Unit(
                    session=str(session.resolve()),
                    name=name,
                    instant=instant,
                    condition=condition.name,
                    matcher=matcher,
                    time_shifts_ms=shifts,
                    splats=self.splats,
                )
                try:
                    own = condition.named(dataset)
                    unit = replace(unit, offsets_ms=own.offsets_ms(dataset.cameras, instant))
                    chosen = dataset.nearest_instants(instant, unit.offsets_ms)
                except BadInputError as error:
                    refused.append(unit_row(unit, error=str(error), exit_code=error.exit_code))
                else:
                    inputs = (
                        source,
                        _truth_checksums(dataset, chosen),
                        name,
                        instant,
                        condition.name,
                        chosen,
                        str(matcher),
                        unit.offsets_ms,
                        sorted(shifts.items()),
                        self.splats,
                        self.program,
                    )
                    made.append(replace(unit, key=hashlib.sha256(repr(inputs).encode()).hexdigest()))
            units += made
            if self.instants is None:
                refused = [] if made else refused[-1:]
            failures += refused
        return units, failures


def compute_depth(unit: Unit, folder: Path) -> None:
    """Compute depth maps, the fused cloud, the splat if requested, and unit.json into `folder`.

    If a valid session does not permit depth, unit.json says so; that is a result too.

    Raises:
        SimulshotError: the session cannot be used, or an image that the unit shows is damaged.
    """
    scene = Scene.open(Path(unit.session), unit.time_shifts_ms)
    dataset = scene.dataset
    # The unit's key was computed from the checksums. Images of other instants only show what moves.
    with checked_pictures(required=True):
        for image in dataset.nearest_instants(unit.instant, unit.offsets_ms).items():
            if dataset.has_image(*image):
                dataset.checked_bytes(*image)
    method = find_method(
        DEPTH_METHOD,
        instant=unit.instant,
        matcher=Matcher(unit.matcher),
        mesh=False,
        workspace=False,
        time_shifts_ms=unit.time_shifts_ms,
    )
    condition = Condition(unit.condition, listed_ms=unit.offsets_ms)
    try:
        with checked_pictures(required=False):
            result = msgspec.to_builtins(method.make([scene], folder, condition))
    except NotApplicableError as error:
        record = {"key": unit.key, "condition": unit.condition, "not_applicable": str(error)}
        write_atomic(folder / RESULT, pretty_json(record))
        return
    del result["seconds"]  # it differs from run to run
    # PatchMatch leaves one, which is large.
    shutil.rmtree(folder / "workspace", ignore_errors=True)
    (folder / method.result_file).unlink(missing_ok=True)
    result["files"] = ["fused.ply", RESULT]
    if unit.splats:
        result["splat"] = _make_splat(scene, unit, folder, condition)
    write_atomic(folder / RESULT, pretty_json({"key": unit.key, "condition": unit.condition, **result}))


def _make_splat(scene: Scene, unit: Unit, folder: Path, condition: Condition) -> dict[str, object]:
    """Write splat.ply of a unit, and return its facts, or why there is none."""
    method = find_method(SPLAT_METHOD, instant=unit.instant, time_shifts_ms=unit.time_shifts_ms)
    part = folder / SPLAT_METHOD
    try:
        with checked_pictures(required=False):
            made = method.make([scene], part, condition)
        (splat,) = made.instants
        (part / splat.file).replace(folder / SPLAT)
    except NotApplicableError as error:
        return {"not_applicable": str(error)}
    finally:
        shutil.rmtree(part, ignore_errors=True)
    figures = {"gaussians": splat.gaussians, "psnr": splat.psnr, "held_out_psnr": splat.held_out_psnr}
    return {"file": SPLAT, "iterations": made.iterations, "held_out": made.held_out, **figures}


def _truth_checksums(dataset: Dataset, chosen: dict[str, int]) -> list[str]:
    """Return the checksums of the true depths that a unit is compared with."""
    paths = (dataset.ground_truth_file(camera, instant) for camera, instant in chosen.items())
    return [hashlib.sha256(path.read_bytes()).hexdigest() if path is not None else "" for path in paths]
