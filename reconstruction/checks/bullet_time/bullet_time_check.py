"""Bullet time: the check and its option."""

from typing import Annotated

from reconstruction.common.options import flag
from reconstruction.method.interface import Check


class BulletTimeSweep(Check, frozen=True, kw_only=True):
    """One instant from camera to camera, beside delayed cameras."""

    name = "bullet_time"
    study = f"{__package__}.bullet_time_study:BulletTimeStudy"

    between: Annotated[
        int,
        flag(
            "--between-cameras",
            "between_cameras",
            ge=0,
            le=12,
            metavar="N",
            help="Also render N views between neighbouring cameras for the bullet-time animation, which "
            "takes depth of all cameras twice.",
        ),
    ] = 0
