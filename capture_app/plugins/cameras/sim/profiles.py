"""Sensor profiles: rows, exposures, frame lengths, latencies, noise; and the simulated models by name.

Frame length = max(frame_length_rows, floor(exposure / row_time) + margin_rows) rows. A long frame's length is
kept for `injection_gain` frames, as measured on real sensors. With a gain of 1.46 the second frame has 0.46
of the stretch, in whole rows.
"""

from dataclasses import dataclass, replace
from math import floor

from msgspec import structs

from capture_app.common.camera_facts import SIMULATED, CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import BadInputError


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorProfile:
    """Properties that all devices of a model share; times in ns, lengths in rows, fractions in [0, 1]."""

    name: str
    model: str
    phase_control: PhaseControl
    row_time_ns: int
    frame_length_rows: int
    """Frame length at short exposures, blanking included: the period in rows."""
    margin_rows: int
    """Rows by which a frame is longer than its exposure; the overhead of an injection."""
    injection_gain: float = 1
    """Number of frames, 1 to 3, that keep the length of a long frame; the last one in part."""
    injection_jitter_ns: int = 0
    """Standard deviation of an injection's phase shift beyond its whole rows."""
    image_width: int = 640
    image_rows: int = 480
    exposure_ns: int = 4_000_000
    min_exposure_ns: int = 100_000
    max_exposure_ns: int = 200_000_000
    min_frame_rows: int | None = None
    """Min length that can be set; None: `frame_length_rows`. The max is 4 * `frame_length_rows`."""
    command_latency_frames: tuple[int, int] = (2, 4)
    """Min and max number of frames from the one exposed when a command arrives to the one that obeys it."""
    start_latency_ns: tuple[int, int] = (0, 0)
    """Mean and standard deviation of the time from the start command to the first frame."""
    timestamp_noise_ns: int = 0
    """Standard deviation of the timestamps."""
    timestamp_quantum_ns: float = 0.0
    """Step of the timestamps, applied after their noise; 0 for ns."""
    timestamps_cut: bool = True
    """Whether timestamps are truncated to their step, as a counter's are, or rounded to the nearest one."""
    stamp_bias_ns: int | None = None
    """Delay of all timestamps, which the camera's facts omit; None: timestamps are exact, and say so."""
    outlier_fraction: float = 0.0
    outlier_ns: int = 1_000_000
    """Max delay of an outlier."""
    drop_fraction: float = 0.0
    period_error_ppm: float = 0.0
    """Max period error of this model's crystals; each device has its own."""

    def __post_init__(self) -> None:
        """Raise BadInputError for an exposure that does not fit a frame."""
        longest_ns = (self.frame_length_rows - self.margin_rows) * self.row_time_ns
        if not self.min_exposure_ns <= self.exposure_ns <= longest_ns:
            raise BadInputError(
                f"exposure of {self.exposure_ns / 1e6:g} ms does not fit a frame of camera model {self.name}",
                hint=f"between {self.min_exposure_ns / 1e6:g} and {longest_ns / 1e6:g} ms",
            )

    @property
    def period_ns(self) -> int:
        """Nominal period of the stream."""
        return self.frame_length_rows * self.row_time_ns

    @property
    def frame_durations_ns(self) -> tuple[int, int] | tuple[None, None]:
        """Min and max frame duration that can be set; None if durations cannot be set."""
        if self.phase_control is not PhaseControl.FRAME_DURATION:
            return None, None
        min_rows = self.min_frame_rows or self.frame_length_rows
        return min_rows * self.row_time_ns, 4 * self.frame_length_rows * self.row_time_ns

    @property
    def neutral_rows(self) -> int:
        """Longest exposure, in rows, that does not stretch a frame (c in the shift's formula)."""
        return self.frame_length_rows - self.margin_rows

    def whole_rows(self, exposure_ns: int) -> int:
        """Return how many whole row times fit in an exposure (ns), once limited to the sensor's range."""
        return min(max(exposure_ns, self.min_exposure_ns), self.max_exposure_ns) // self.row_time_ns

    def stretches_rows(self, exposure_ns: int) -> tuple[int, ...]:
        """Return the rows by which an injected exposure E (ns) lengthens its frame and each later frame.

        Together they are gain * (floor(E / row_time) - c) rows.
        """
        stretch = max(0, self.whole_rows(exposure_ns) - self.neutral_rows)
        whole = floor(self.injection_gain)
        rows = (*([stretch] * whole), round((self.injection_gain - whole) * stretch))
        return tuple(row for row in rows if row)

    def stamp(self, true_ns: int) -> int:
        """Return the timestamp of an instant, in the steps of this model's timestamps."""
        if not self.timestamp_quantum_ns:
            return true_ns
        steps = true_ns / self.timestamp_quantum_ns
        return round((floor(steps) if self.timestamps_cut else round(steps)) * self.timestamp_quantum_ns)


_PHONE_A = SensorProfile(
    name="phone-a",
    model="Simulated phone A",
    phase_control=PhaseControl.INJECTION,
    row_time_ns=10_840,
    frame_length_rows=3075,
    margin_rows=19,
    injection_gain=2,
    start_latency_ns=(650_000_000, 40_000_000),
    timestamp_noise_ns=3_000,
    outlier_fraction=0.01,
    drop_fraction=0.01,
    period_error_ppm=20.0,
)
_MODELS = (
    _PHONE_A,
    replace(
        _PHONE_A,
        name="phone-b",
        model="Simulated phone B",
        row_time_ns=12_300,
        frame_length_rows=2710,
        margin_rows=34,
        injection_gain=1,
        start_latency_ns=(720_000_000, 50_000_000),
    ),
    SensorProfile(
        name="pi",
        model="Simulated Raspberry Pi camera",
        phase_control=PhaseControl.FRAME_DURATION,
        row_time_ns=11_111,
        frame_length_rows=3000,
        margin_rows=4,
        min_frame_rows=1500,
        start_latency_ns=(400_000_000, 20_000_000),
        timestamp_noise_ns=2_000,
        outlier_fraction=0.002,
        drop_fraction=0.002,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="webcam",
        model="Simulated USB webcam",
        phase_control=PhaseControl.RESET,
        row_time_ns=10_250,
        frame_length_rows=3252,
        margin_rows=8,
        max_exposure_ns=33_000_000,
        start_latency_ns=(275_000_000, 5_000_000),
        timestamp_noise_ns=20_000,
        outlier_fraction=0.01,
        drop_fraction=0.01,
        period_error_ppm=20.0,
    ),
    SensorProfile(
        name="perfect",
        model="Simulated perfect camera",
        phase_control=PhaseControl.INJECTION,
        row_time_ns=11_111,
        frame_length_rows=3000,
        margin_rows=0,
        injection_gain=1,
        command_latency_frames=(2, 2),
    ),
)

PROFILES: dict[str, SensorProfile] = {profile.name: profile for profile in _MODELS}
"""Profiles by name. All run at 33.333 ms, made of different whole rows, as a rig of mixed devices would."""


def find_profile(name: str) -> SensorProfile:
    """Return the profile of that name. Raises BadInputError that lists the known ones."""
    if name not in PROFILES:
        raise BadInputError(f"unknown simulated camera {name!r}", hint=f"there are {', '.join(PROFILES)}")
    return PROFILES[name]


def facts_of(profile: SensorProfile, *, width: int, height: int) -> CameraFacts:
    """Return the facts that a camera of this sensor profile reports, for images of that size in pixels.

    They omit the gain and overhead of its injections, and the delay of its timestamps.
    """
    facts = CameraFacts(
        kind=SIMULATED,
        model=profile.model,
        width=width,
        height=height,
        pixel_format="JPEG",
        period_ns=profile.period_ns,
        timestamp_source=TimestampSource.START_OF_EXPOSURE,
        phase_control=profile.phase_control,
        row_time_ns=profile.row_time_ns,
        exposure_ns=profile.whole_rows(profile.exposure_ns) * profile.row_time_ns,
        min_exposure_ns=profile.min_exposure_ns,
        max_exposure_ns=profile.max_exposure_ns,
        min_frame_duration_ns=profile.frame_durations_ns[0],
        max_frame_duration_ns=profile.frame_durations_ns[1],
    )
    return facts if profile.stamp_bias_ns is None else structs.replace(facts, stamp=facts.assumed_stamp)
