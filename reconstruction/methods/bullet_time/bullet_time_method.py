"""Bullet time: the method and its option."""

from typing import Annotated

import msgspec

from reconstruction.common.options import flag
from reconstruction.compare.method import Method


class BulletTimeOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of the bullet-time sweep."""

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


class BulletTimeSweep(Method):
    """One instant from camera to camera, beside delayed cameras."""

    name = "bullet_time"
    Options = BulletTimeOptions
    study = f"{__package__}.bullet_time_study:BulletTimeStudy"
