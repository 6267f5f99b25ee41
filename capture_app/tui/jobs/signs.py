"""The state of a job as a word, a glyph and a colour; and how far it is."""

from textual.content import Content

from capture_app.text import printable
from capture_app.tui.drawing.line_parts import filled_cells
from capture_app.tui.jobs.job import Job, JobState
from capture_app.tui.states import Sign

SIGNS = {
    JobState.WAITING: Sign("○", "waiting", "$foreground-muted"),
    JobState.RUNNING: Sign("▶", "running", "$primary"),
    JobState.PAUSED: Sign("⏸", "paused", "$warning"),
    JobState.DONE: Sign("✔", "done", "$success"),
    JobState.FAILED: Sign("✖", "failed", "$error"),
    JobState.CANCELLED: Sign("◌", "cancelled", "$foreground-muted"),
}


def rough_time(seconds: float) -> str:
    """A time to wait or waited, as roughly as it is known: 8 s, 2 min, 1 h 20 min."""
    if seconds < 99.5:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def progress_bar(share: float | None, width: int) -> Content:
    """A bar of cells that is filled as far as the share."""
    full = filled_cells(share or 0.0, width)
    return Content.assemble((full, "$primary"), ("─" * (width - len(full)), "$border"))


def progress_words(job: Job) -> str:
    """How far it is, in words: 43 % · 2 min left · stereo cam00-cam01."""
    parts = []
    if job.share is not None and not job.state.is_over:
        parts.append(f"{100 * job.share:.0f} %")
    if (left := job.seconds_left) is not None:
        parts.append(f"about {rough_time(left)} left")
    if job.step is not None and not job.state.is_over:
        parts.append(printable(job.step.text))
    return " · ".join(parts)


def job_tag(job: Job) -> Content:
    """What a list of sessions says of a job: its glyph, and how far it is."""
    sign = SIGNS[job.state]
    share = f" {100 * job.share:.0f} %" if job.share is not None and not job.state.is_over else ""
    return Content.styled(f"{sign.glyph} {job.kind.title.lower()}{share}", sign.style)
