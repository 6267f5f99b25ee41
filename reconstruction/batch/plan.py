"""Which units a session has, and how one of them is made: the depth of an instant in a condition."""

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError, IncompleteError
from capture_app.session.files.durable import write_atomic
from capture_app.text import pretty_json
from reconstruction.batch.units import Unit
from reconstruction.common.native_libraries import library_versions
from reconstruction.multiview.command import RESULT as MULTIVIEW_RESULT
from reconstruction.multiview.command import Matcher, MultiviewOptions, multiview
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset

MAKE = "reconstruction.batch.plan:make_depth"
RESULT = "unit.json"
TIMES = ("seconds", "seconds_of")
"""What differs from run to run; kept apart from the results."""


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A unit or a whole session that cannot even be begun; `instant` and `condition` where they are known."""

    name: str
    problem: str
    code: int
    instant: int | None = None
    condition: str = ""


def plan(
    session: Path, conditions: Sequence[Condition], instants: Sequence[int] | None, matcher: str
) -> tuple[list[Unit], list[Failure]]:
    """A session's units: of the instants asked for, or of all that reach far enough into the burst.

    Raises:
        SimulshotError: the session cannot be used at all.
    """
    dataset = Dataset.open(session)
    if len(dataset.cameras) < 2:
        raise BadInputError(
            f"the session has one camera only ({', '.join(dataset.cameras)})",
            hint="depth needs two that see the same from different places",
        )
    name = session.resolve().name
    source = dataset.fingerprint()
    units: list[Unit] = []
    failures: list[Failure] = []
    for condition in conditions:
        refused = None
        before = len(units)
        for instant in range(len(dataset.instants_ns)) if instants is None else instants:
            offsets = condition.offsets_ms(dataset.cameras, instant)
            try:
                condition.check(dataset)
                chosen = dataset.shown_instants(instant, offsets)
            except BadInputError as error:
                refused = Failure(
                    name=name,
                    instant=instant,
                    condition=condition.name,
                    problem=str(error),
                    code=error.exit_code,
                )
                if instants is not None:
                    failures.append(refused)
                continue
            depends = (source, _truth(dataset, chosen), name, instant, condition.name, chosen, matcher)
            units.append(
                Unit(
                    session=str(session.resolve()),
                    name=name,
                    instant=instant,
                    condition=condition.name,
                    offsets_ms=offsets,
                    matcher=matcher,
                    key=hashlib.sha256(repr((*depends, offsets, program())).encode()).hexdigest(),
                )
            )
        if refused is not None and instants is None and len(units) == before:
            failures.append(refused)
    return units, failures


@cache
def program() -> str:
    """A checksum of this program's own text and of the libraries' versions: what else decides a result."""
    digest = hashlib.sha256(repr(sorted(library_versions().items())).encode())
    here = Path(__file__).parents[1]
    for path in sorted(here.rglob("*.py")):
        digest.update(f"{path.relative_to(here)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def make_depth(unit: Unit, folder: Path) -> None:
    """Make depth maps, the fused cloud and unit.json in `folder`.

    Raises:
        SimulshotError: it cannot be done with this session.
    """
    session = Path(unit.session)
    _check_images(session, unit)
    options = MultiviewOptions(
        instant=unit.instant, offsets_ms=unit.offsets_ms, matcher=Matcher(unit.matcher), mesh=False
    )
    result = msgspec.to_builtins(multiview(session, folder, options))
    for name in TIMES:
        del result[name]
    # Large, and made of the pictures and the depth maps.
    shutil.rmtree(folder / "workspace", ignore_errors=True)
    for leftover in ("fused.ply.vis", MULTIVIEW_RESULT):
        (folder / leftover).unlink(missing_ok=True)
    result["files"] = ["fused.ply", RESULT]
    told = {"key": unit.key, "condition": unit.condition, **result}
    write_atomic(folder / RESULT, pretty_json(told))


def _check_images(session: Path, unit: Unit) -> None:
    """The key was made of the checksums that the session tells: they must be those of the images."""
    dataset = Dataset.open(session)
    chosen = dataset.shown_instants(unit.instant, unit.offsets_ms)
    for record in dataset.session.manifest.images:
        if chosen.get(record.camera) == record.instant and not record.substitute:
            path = dataset.session.image_file(record)
            if hashlib.sha256(path.read_bytes()).hexdigest() != record.sha256:
                raise IncompleteError(
                    f"{path} is damaged: its checksum is not the session's",
                    hint="capture-app sessions verify checks every image",
                )


def _truth(dataset: Dataset, chosen: dict[str, int]) -> list[str]:
    """Checksums of the true depths that a unit is judged by."""
    sums = []
    for camera, instant in chosen.items():
        path = dataset.session.ground_truth(camera, instant)
        sums.append(hashlib.sha256(path.read_bytes()).hexdigest() if path is not None else "")
    return sums
