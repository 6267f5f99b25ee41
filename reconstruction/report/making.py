"""How a comparison was made: cameras, offset, calibration, software, and the path of every file."""

from html import escape

from reconstruction.report import wording
from reconstruction.scores.compare_results import CompareResult


def making_section(result: CompareResult) -> str:
    """What decides the numbers, the software, and every file beside the page."""
    rows = [("Session", f"<code>{escape(result.session)}</code>")]
    if stereo := result.stereo:
        rows.append(("Depth", _pair((stereo.reference, stereo.other), stereo.synced.instants, stereo.why)))
    if stitch := result.stitch:
        rows.append(("Panorama", _pair(stitch.cameras, stitch.synced.instants, stitch.why)))
    if many := result.multiview:
        width = f", pictures {many.width_px} px wide" if many.width_px else ""
        count = wording.count(many.synced.instants, "instant")
        rows.append(("All cameras", escape(f"{', '.join(many.cameras)}, {count}{width}")))
    elif result.multiview_skipped:
        rows.append(("All cameras", escape(f"not measured: {result.multiview_skipped}")))
    if result.poses_skipped:
        rows.append(("Poses by instant", escape(wording.tie(f"not looked at: {result.poses_skipped}"))))
    asked, actual = (wording.milliseconds(ms) for ms in (result.offset_ms, result.actual_offset_ms))
    frames = wording.count(result.offset_frames, "frame")
    rows.append(("Offset", escape(f"{asked} asked for; {actual} given, which is {frames}")))
    rows.append(("Calibration", escape(result.calibration)))
    sync = wording.synchronization(result.sync_residual_us, result.sync_bound_us)
    rows.append(("Synchronization", escape(sync)))
    rows.append(("Time taken", escape(wording.seconds(result.seconds))))
    if result.versions:
        versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
        rows.append(("Software", escape(versions)))
    entries = "\n".join(f"<dt>{name}</dt><dd>{words}</dd>" for name, words in rows)
    return f"""<section aria-labelledby="making">
<h2 id="making">How it was made</h2>
<dl class="making">
{entries}
</dl>
{_files(result)}
</section>"""


def _pair(cameras: tuple[str, ...], instants: int, why: str) -> str:
    words = f"cameras {' and '.join(cameras)}, {wording.count(instants, 'instant')}"
    return escape(wording.tie(f"{words} (taken for {why})" if why else words))


def _files(result: CompareResult) -> str:
    """Every file of the folder that this page lies in, by what it shows."""
    found: list[tuple[str, tuple[str, ...]]] = [("every number, for programs", ("metrics.json",))]
    found += [(f"{one.title}: synchronized, offset", (one.synced, one.offset)) for one in result.pictures]
    if many := result.multiview:
        found += [(f"{one.title}: {wording.APART}", (one.synced, one.offset)) for one in many.pictures]
    if sweep := result.bullet_time:
        found.append(("from camera to camera, to share", (sweep.file,)))
        found.append(("the same, picture by picture", (*sweep.synced, *sweep.offset)))
    if burst := result.burst:
        found.append(("the burst", tuple(path for row in burst.thumbnails for path in row if path)))
    found.append(("what was worked out on the way, for the next run; may be deleted", ("stages/",)))
    items = "".join(
        f"<dt>{escape(what)}</dt><dd>{' '.join(f'<code>{escape(path)}</code>' for path in paths)}</dd>"
        for what, paths in found
    )
    return f"""<details><summary>Every file beside this page</summary>
<p>The pictures as the cameras took them are in the session, <code>{escape(result.session)}</code>.</p>
<dl class="making files">{items}</dl></details>"""
