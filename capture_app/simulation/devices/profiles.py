"""The simulated camera models by name.

All run at 33.333 ms, made of different whole rows, as the mixed devices of a real rig would be set up.
"""

from capture_app.camera_facts import SIMULATED, CameraFacts, PhaseControl, TimestampSource
from capture_app.errors import BadInputError
from capture_app.simulation.devices.sensor_profile import SensorProfile

_MODELS = (
    SensorProfile(
        name="phone-a",
        model="Simulated phone A",
        phase_control="injection",
        row_time_ns=10_840,
        frame_length_rows=3075,
        margin_rows=19,
        injection_gain=2,
        start_latency_ns=(650_000_000, 40_000_000),
        timestamp_noise_ns=3_000,
        outlier_share=0.01,
        drop_share=0.01,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="phone-b",
        model="Simulated phone B",
        phase_control="injection",
        row_time_ns=12_300,
        frame_length_rows=2710,
        margin_rows=34,
        injection_gain=1,
        start_latency_ns=(720_000_000, 50_000_000),
        timestamp_noise_ns=3_000,
        outlier_share=0.01,
        drop_share=0.01,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="pi",
        model="Simulated Raspberry Pi camera",
        phase_control="frame-duration",
        row_time_ns=11_111,
        frame_length_rows=3000,
        margin_rows=4,
        min_frame_rows=1500,
        start_latency_ns=(400_000_000, 20_000_000),
        timestamp_noise_ns=2_000,
        outlier_share=0.002,
        drop_share=0.002,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="webcam",
        model="Simulated USB webcam",
        phase_control="reset",
        row_time_ns=10_250,
        frame_length_rows=3252,
        margin_rows=8,
        max_exposure_ns=33_000_000,
        start_latency_ns=(275_000_000, 5_000_000),
        timestamp_noise_ns=20_000,
        outlier_share=0.01,
        drop_share=0.01,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="perfect",
        model="Simulated perfect camera",
        phase_control="injection",
        row_time_ns=11_111,
        frame_length_rows=3000,
        margin_rows=0,
        injection_gain=1,
        command_latency_frames=(2, 2),
    ),
)

PROFILES: dict[str, SensorProfile] = {profile.name: profile for profile in _MODELS}


def find_profile(name: str) -> SensorProfile:
    """The profile of that name. Raises BadInputError that lists those there are."""
    try:
        return PROFILES[name]
    except KeyError:
        raise BadInputError(
            f"unknown simulated camera {name!r}", hint=f"there are {', '.join(PROFILES)}"
        ) from None


def facts_of(profile: SensorProfile, *, width: int, height: int) -> CameraFacts:
    """The facts that a camera of that model reports, for pictures of so many pixels.

    Gain and overhead of its injections are not among them.
    """
    return CameraFacts(
        kind=SIMULATED,
        model=profile.model,
        width=width,
        height=height,
        pixel_format="JPEG",
        period_ns=profile.period_ns,
        timestamp_source=TimestampSource.START_OF_EXPOSURE,
        phase_control=PhaseControl(profile.phase_control),
        row_time_ns=profile.row_time_ns,
        exposure_ns=profile.whole_rows(profile.exposure_ns) * profile.row_time_ns,
        min_exposure_ns=profile.min_exposure_ns,
        max_exposure_ns=profile.max_exposure_ns,
        min_frame_duration_ns=profile.min_frame_duration_ns,
        max_frame_duration_ns=profile.max_frame_duration_ns,
    )
