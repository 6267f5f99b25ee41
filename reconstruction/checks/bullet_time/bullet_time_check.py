"""Bullet time: the check."""

from reconstruction.method.interface import Check


class BulletTimeSweep(Check, frozen=True, kw_only=True):
    """One instant from camera to camera, beside delayed cameras."""

    name = "bullet_time"
    study = f"{__package__}.bullet_time_study:BulletTimeStudy"
