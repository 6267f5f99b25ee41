"""What came of a job, in a sentence: from the JSON that it printed."""

from collections.abc import Mapping
from typing import Any

import msgspec

from capture_app.text import count
from capture_app.tui.jobs.kinds import JobKind
from capture_app.tui.jobs.panel_result import panel_verdict


def outcome(kind: JobKind, printed: bytes) -> str:
    """The sentence; empty where the output is not what was expected, which is no failure of the job."""
    try:
        found = msgspec.json.decode(printed, type=dict[str, Any])
        return _SENTENCES[kind.command[-1]](found)
    except (msgspec.DecodeError, KeyError, TypeError, ValueError, IndexError):
        return ""


def percent(share: float | None) -> str:
    """A share of 1 in percent, a dash for None: 97 %; neither rounded up to all nor down to nothing."""
    if share is None:
        return "–"
    if 0.99 < share < 1:
        return f"{int(1000 * share) / 10:.1f} %"
    return f"{100 * share:.1f} %" if 0 < share < 0.1 else f"{100 * share:.0f} %"


def moves(found: Mapping[str, Any]) -> bool:
    """Whether a panorama's misfit is known on what moves."""
    on_movers = found["synced"].get("mover_misfit")
    return on_movers is not None and on_movers["median_px"] is not None


def _of_multiview(found: Mapping[str, Any]) -> str:
    if "clouds" in found:
        score = found.get("mover_f_score_1cm")
        truth = "" if score is None else f"; what moves has F {score:.2f} at 1 cm"
        return f"{count(found['clouds'], 'cloud')} of {count(len(found['instants']), 'instant')}{truth}"
    maps = count(len(found["views"]), "depth map")
    right = found.get("within_2pct")
    truth = (
        "" if right is None else f"; {percent(right)} of {found['reference']} within 2 % of the true depth"
    )
    return f"{maps}, {found['fused_points']:,} points{truth}"


def _of_stitch(found: Mapping[str, Any]) -> str:
    text = f"panorama of {count(len(found['used']), 'picture')}"
    what, key = ("what moves fits", "mover_misfit") if moves(found) else ("overlaps fit", "misfit")
    one, late = (side and side[key]["median_px"] for side in (found["synced"], found.get("offset")))
    if one is not None:
        text += f"; {what} to {one:.1f} px"
    if one is not None and late is not None:
        text += f", {found['actual_offset_ms']:.0f} ms late to {late:.1f} px"
    return text


def _of_dose(found: Mapping[str, Any]) -> str:
    tolerated, timing = found["tolerable_offset_ms"], found.get("timing") or {}
    if timing.get("offset"):
        late = timing["late_ms"]
        if late is None:
            return "not synchronized: what moves is lost and off its rows; by how much is not known"
        side = "early" if late < 0 else "late"
        if timing.get("by_depth"):
            return f"not synchronized: {found['other']} is about {abs(late):.0f} ms {side}, known to a frame"
        far = f"{abs(late):.1f} ±{timing['uncertainty_ms']:.1f} ms {side}"
        return f"not synchronized: {found['other']} is {far}"
    if timing and not timing["synchronized"]:
        return f"whether it is synchronized cannot be told: {timing['reason']}"
    if tolerated is None:
        return f"less than a tenth is lost up to {found['points'][-1]['offset_ms']:.0f} ms"
    return f"this motion tolerates a delay of about {tolerated:.1f} ms"


def _of_verify(found: Mapping[str, Any]) -> str:
    return "every file and every number is as it was saved" if found["ok"] else ""


def _of_repair(found: Mapping[str, Any]) -> str:
    (one,) = found["sessions"]
    lost = f", {one['missing']} missing" if one["missing"] else ""
    return f"{'completed' if one['changed'] else 'complete already'}: {count(one['images'], 'image')}{lost}"


def _of_export(found: Mapping[str, Any]) -> str:
    notes = "".join(f"; {note}" for note in found.get("notes", ()))
    return f"{count(found['images'], 'image')} in {found['folder']}{notes}"


_SENTENCES = {
    "compare": lambda found: str(found["verdict"]),
    "multiview": _of_multiview,
    "stitch": _of_stitch,
    "dose": _of_dose,
    "read": panel_verdict,
    "verify": _of_verify,
    "repair": _of_repair,
    "export": _of_export,
}
