"""All cameras' offsets against the first, also through others where two have nothing in common."""

import math
from collections.abc import Callable, Sequence

from capture_app.session.format.common_times import REFERENCE, CameraTimes


def chain_cameras(names: Sequence[str], against: Callable[[str, str], CameraTimes]) -> dict[str, CameraTimes]:
    """Each camera's times against the first's; `against` measures a pair, the second against the first.

    A camera that cannot be measured against the first is so against those that could; errors then add up.
    """
    reference = names[0]
    known = {
        reference: CameraTimes(offset_ns=0, uncertainty_ns=0, rate_uncertainty_ppm=0.0, source=REFERENCE)
    }
    why: dict[str, str] = {}
    asked: set[tuple[str, str]] = set()
    progress = True
    while progress:
        progress = False
        for through in list(known):
            for name in names:
                if name in known or (through, name) in asked:
                    continue
                asked.add((through, name))
                found = against(through, name)
                if found.offset_ns is None:
                    why.setdefault(name, found.reason)
                    continue
                known[name] = found if through == reference else compose(known[through], found)
                progress = True
    return {name: known.get(name) or CameraTimes(reason=why.get(name, "")) for name in names}


def compose(outer: CameraTimes, inner: CameraTimes) -> CameraTimes:
    """The times of a camera against the reference, from those against another camera and that one's."""
    epoch = inner.epoch_local_ns
    middle_ns = inner.leader_from_local(epoch)
    outer_error = outer.uncertainty_at_ns(middle_ns) or 0
    return CameraTimes(
        offset_ns=outer.leader_from_local(middle_ns) - epoch,
        uncertainty_ns=round(math.hypot(outer_error, inner.uncertainty_ns or 0)),
        rate_ppm=outer.rate_ppm + inner.rate_ppm,
        rate_uncertainty_ppm=math.hypot(outer.rate_uncertainty_ppm or 0.0, inner.rate_uncertainty_ppm or 0.0),
        epoch_local_ns=epoch,
        source=inner.source,
    )
