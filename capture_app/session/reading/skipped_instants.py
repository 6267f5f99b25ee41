"""The instants that a burst does without, in words."""

from collections import Counter
from collections.abc import Sequence

from capture_app.session.format.manifest import SkippedInstant
from capture_app.text import count


def skipped_text(skipped: Sequence[SkippedInstant]) -> str:
    """How many instants were skipped and why: "1 instant skipped: cam03 dropped 1 frame"; empty for none."""
    if not skipped:
        return ""
    dropped: Counter[str] = Counter()
    others: dict[str, None] = {}
    for instant in skipped:
        for gap in instant.missing:
            if gap.dropped:
                dropped[gap.camera] += 1
            else:
                others[f"{gap.camera}: {gap.reason}"] = None
    reasons = [f"{camera} dropped {count(frames, 'frame')}" for camera, frames in sorted(dropped.items())]
    why = ", ".join([*reasons, *others]) or "not every camera had its frame"
    return f"{count(len(skipped), 'instant')} skipped: {why}"
