"""The instants that a burst does without, in words."""

from collections import Counter
from collections.abc import Sequence

from capture_app.session.format.manifest import SkippedInstant


def skipped_text(skipped: Sequence[SkippedInstant]) -> str:
    """How many instants were skipped and why: "1 instant skipped: cam03 dropped a frame"; empty for none."""
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
    reasons = [
        f"{camera} dropped {'a frame' if count == 1 else f'{count} frames'}"
        for camera, count in sorted(dropped.items())
    ]
    many = "1 instant" if len(skipped) == 1 else f"{len(skipped)} instants"
    return f"{many} skipped: {', '.join([*reasons, *others]) or 'not every camera had its frame'}"
