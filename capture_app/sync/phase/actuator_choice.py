"""Which actuator moves the phase of a camera."""

import random

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.sync.phase.actuator import PhaseActuator
from capture_app.sync.phase.frame_duration import FrameDurationActuator
from capture_app.sync.phase.injection import InjectionActuator
from capture_app.sync.phase.injection_history import InjectionProfile
from capture_app.sync.phase.reset import ResetActuator


def choose_actuator(
    camera: CameraFacts, *, rng: random.Random, profile: InjectionProfile | None, aimed: bool
) -> PhaseActuator | None:
    """Return the actuator of a camera, None where its phase cannot be moved.

    `profile` is what is known from before of its injections; `aimed=False` restarts at random times.
    """
    match camera.phase_control:
        case PhaseControl.INJECTION:
            return InjectionActuator(
                period_ns=camera.period_ns,
                row_time_ns=camera.row_time_ns,
                min_exposure_ns=max(camera.min_exposure_ns or 0, camera.exposure_ns or 0),
                max_exposure_ns=camera.max_exposure_ns,
                profile=profile,
            )
        case PhaseControl.RESET:
            return ResetActuator(rng=rng, aimed=aimed)
        case PhaseControl.FRAME_DURATION:
            return FrameDurationActuator(
                period_ns=camera.period_ns,
                row_time_ns=camera.row_time_ns,
                min_duration_ns=camera.min_frame_duration_ns,
                max_duration_ns=camera.max_frame_duration_ns,
            )
        case PhaseControl.NONE:
            return None
