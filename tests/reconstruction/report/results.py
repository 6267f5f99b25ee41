"""A comparison with little in it, to be changed by a test."""

import msgspec

from reconstruction.scores.compare_results import CompareResult
from reconstruction.scores.depth_results import DepthScores, StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison, PanoramaScores
from reconstruction.scores.results import Picture

NASTY = "jump <script>alert('x')</script> & \"pinwheel\" $css {x}"


def depth(**changes: float | None) -> DepthScores:
    scores = DepthScores(
        mover_coverage=0.999,
        static_coverage=0.745,
        mover_within_2pct=0.981,
        static_within_2pct=0.673,
        mover_epipolar_px=0.26,
        instants=5,
    )
    return msgspec.structs.replace(scores, **changes)


STEREO = StereoComparison(
    reference="cam2",
    other="cam3",
    synced=depth(),
    offset=depth(
        mover_coverage=0.405, static_coverage=0.733, mover_within_2pct=0.0112, mover_epipolar_px=17.7
    ),
)

STITCH = PanoramaComparison(
    cameras=("cam0", "cam4"),
    synced=PanoramaScores(
        overlap_flow_p95_px=1.31, static_overlap_mad=4.2, mover_overlap_mad=6.1, instants=5
    ),
    offset=PanoramaScores(
        overlap_flow_p95_px=23.4, static_overlap_mad=4.3, mover_overlap_mad=31.7, instants=5
    ),
)

RESULT = CompareResult(
    session=NASTY,
    offset_ms=66,
    offset_frames=2,
    actual_offset_ms=66.6,
    verdict="Synchronized cameras measure moving things. Late ones <do not>.",
    calibration="the session's own (calibration.json)",
    stereo=STEREO,
    stitch=STITCH,
    sync_residual_us=85.2,
    sync_bound_us=1912,
    seconds=14.24,
    versions={"opencv": "5.0.0"},
)


def with_pictures(result: CompareResult, *pictures: Picture) -> CompareResult:
    stereo = msgspec.structs.replace(result.stereo, pictures=pictures)
    return msgspec.structs.replace(result, stereo=stereo)
