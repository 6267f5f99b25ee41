"""Bullet time: the method."""

import msgspec

from reconstruction.compare.method import Method


class BulletTimeSweep(Method):
    """One instant from camera to camera, beside delayed cameras."""

    name = "bullet_time"
    Options = msgspec.Struct
    study = f"{__package__}.bullet_time_study:BulletTimeStudy"
