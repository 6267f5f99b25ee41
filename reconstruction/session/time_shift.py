"""Corrected times of cameras: which of their images then belong to which instant."""

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from capture_app.errors import BadInputError
from capture_app.session.format.manifest import ImageRecord


def shift_times(
    records: Iterable[ImageRecord],
    shifts_ms: Mapping[str, float],
    instants_ns: Sequence[int],
    period_ns: int,
) -> dict[tuple[str, int], ImageRecord]:
    """The images by camera and the instant they are nearest to, with each camera's shift added to its times.

    An image that is further than half a period from every instant is left out, as is one whose instant
    has a nearer one of its camera. Records keep the instant they were saved under.

    Raises:
        BadInputError: a shift leaves a camera without any image.
    """
    placed: dict[tuple[str, int], ImageRecord] = {}
    for record in records:
        shift_ns = round(shifts_ms.get(record.camera, 0.0) * 1e6)
        if not shift_ns:
            placed[record.camera, record.instant] = record
            continue
        leader_ns = record.leader_ns + shift_ns
        instant = min(range(len(instants_ns)), key=lambda k: abs(instants_ns[k] - leader_ns))
        start = record.exposure_start_ns
        moved = msgspec.structs.replace(
            record,
            leader_ns=leader_ns,
            residual_ns=leader_ns - instants_ns[instant],
            exposure_start_ns=None if start is None else start + shift_ns,
        )
        other = placed.get((record.camera, instant))
        if abs(moved.residual_ns) <= period_ns / 2 and (
            other is None or abs(moved.residual_ns) < abs(other.residual_ns)
        ):
            placed[record.camera, instant] = moved
    for camera, shift_ms in shifts_ms.items():
        if shift_ms and not any(name == camera for name, _ in placed):
            raise BadInputError(
                f"--time-shift-ms {camera}={shift_ms:g} leaves no image of {camera} at any instant",
                hint=f"the burst is {(instants_ns[-1] - instants_ns[0]) / 1e6:.0f} ms long",
            )
    return placed
