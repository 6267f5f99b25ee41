"""The bullet-time sweep's part of a report: two reels of pictures that go from camera to camera together."""

from html import escape
from pathlib import Path

from reconstruction.report import wording
from reconstruction.report.burst import embed
from reconstruction.scores.compare_results import BulletTime


def bullet_time_section(sweep: BulletTime | None, out: Path, sides: wording.Sides) -> str:
    """Both reels and their controls; nothing where there is none.

    Without scripts and in print each reel is a strip of its pictures. Raises BadInputError where a picture
    is missing.
    """
    if sweep is None:
        return ""
    order = "in the order of their places" if sweep.by_place else "by name"
    held = (
        "Each picture is turned and zoomed as a whole so that what moves stays in its place; nothing in it "
        "is made up."
        if sweep.steady
        else "The pictures are as the cameras took them."
    )
    late = "" if sides.together else "; these did not, so what moves jumps"
    steps = _steps(sweep)
    times = [wording.timeliness(ms) for ms in sweep.late_ms]
    reels = _reel("synced", sides.first, sweep.synced, [""] * len(times), sweep, out)
    reels += _reel("offset", "Apart", sweep.offset, times, sweep, out)
    last = len(sweep.cameras) - 1
    return f"""<section aria-labelledby="sweep">
<h2 id="sweep">From camera to camera</h2>
<p>Time stands still while the view goes from camera to camera, {order}: the effect called bullet time. It
takes cameras that fire together{late}. Beside it, each camera is late or early by another time, as when
nobody synchronizes them (its picture is taken from another instant of the burst): what stands still looks the
same, what moves jumps.</p>
<figure class="sweep" aria-label="From camera to camera">
<div class="reels">{reels}</div>
<div class="controls">
<button type="button" class="play">Play</button>
<button type="button" class="step" data-step="-1" aria-label="Previous camera">◂</button>
<input class="at" type="range" min="0" max="{last}" step="1" value="0" aria-label="Camera">
<button type="button" class="step" data-step="1" aria-label="Next camera">▸</button>
<span class="where" aria-hidden="true"></span>
</div>
<figcaption>Instant {sweep.instant}. {held}{steps}
As a file to share: <code>{escape(sweep.file)}</code>.</figcaption>
</figure>
</section>"""


def _steps(sweep: BulletTime) -> str:
    """How far what moves goes from picture to picture, where that tells the two apart."""
    before, after = sweep.synced_step_px, sweep.offset_step_px
    if before is None or after is None or after < 1.5 * before:
        return ""
    return escape(
        f" The largest thing that moves goes {wording.quantity(before, 'px')} at most from one picture to "
        f"the next; with the cameras apart, {wording.quantity(after, 'px')}."
    )


def _reel(
    side: str, title: str, paths: tuple[str, ...], times: list[str], sweep: BulletTime, out: Path
) -> str:
    frames = []
    for camera, path, time in zip(sweep.cameras, paths, times, strict=True):
        data, (wide, high) = embed(out / path)
        words = escape(f"{camera}, {time}" if time else camera)
        frames.append(
            f'<span class="frame" data-camera="{escape(camera)}" data-time="{escape(time)}">'
            f'<img alt="{words}" width="{wide}" height="{high}" src="{data}"><small>{words}</small></span>'
        )
    return f"""<div class="side {side}"><span class="tag">{title}<span class="now"></span></span>
<div class="reel">{"".join(frames)}</div></div>
"""
