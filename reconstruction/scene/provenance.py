"""Provenance of a result: what every command records about its own run, filled in one place."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeVar

from msgspec import Struct, structs

from capture_app.common import system
from reconstruction.common.memory import memory_budget
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.picture_checksums import picture_checks


class Provenance(Struct, frozen=True, kw_only=True):
    """Provenance of a result; `with_provenance` fills it."""

    labels: dict[str, str] = {}
    """What people call cameras, by name; only of cameras with another name."""
    time_shifts_ms: dict[str, float] = {}
    """Shifts added to the times of these cameras."""
    seconds: float = 0.0
    """Wall time of the whole run."""
    memory_notes: tuple[str, ...] = ()
    """Changes due to the memory budget."""
    changed_pictures: tuple[str, ...] = ()
    """Files whose bytes differ from what was saved."""
    versions: dict[str, str] = {}
    """Versions of the libraries used, by name."""


R = TypeVar("R", bound=Provenance)


def with_provenance(
    result: R, began_s: float, time_shifts_ms: Mapping[str, float] = MappingProxyType({})
) -> R:
    """Return the result of a run that began at `began_s` (`monotonic_s`), with its provenance until now."""
    return structs.replace(
        result,
        time_shifts_ms=dict(time_shifts_ms),
        seconds=round(system.monotonic_s() - began_s, 3),
        memory_notes=memory_budget().notes,
        changed_pictures=picture_checks().changed,
        versions=library_versions(),
    )
