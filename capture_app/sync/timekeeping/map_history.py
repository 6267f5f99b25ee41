"""Time maps that a node used lately: what a wrong one has touched is found when a better one contradicts it.

A clock that stepped or was slewed, or a leader that was suspended, is noticed some samples later. Frames that
were timed meanwhile have error bars that are too small.
"""

from collections import deque

from capture_app.common.bounds import MAX_COUNT
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.clock_events import TimesDoubted

HISTORY_NS = 90_000_000_000
"""Time for which maps are kept: the longest window of a line, from which a change is found."""
LOOK_BACK_NS = 15_000_000_000
"""Time within which a change of a clock's rate is noticed: 80 ppm on recorded WiFi take so long."""


class MapHistory:
    """The maps of the last HISTORY_NS, each with the local time from which it was used."""

    def __init__(self) -> None:
        self._maps: deque[tuple[int, TimeMap]] = deque()

    def clear(self) -> None:
        """Forget all maps: times of another root follow."""
        self._maps.clear()

    def add(self, time_map: TimeMap, now_ns: int) -> None:
        """Note a map that is used from now on. The last one stays, however old it is: holdover has no end."""
        while len(self._maps) > 1 and self._maps[1][0] < now_ns - HISTORY_NS:
            self._maps.popleft()
        self._maps.append((now_ns, time_map))

    def doubt(
        self, new: TimeMap, now_ns: int, *, after_ns: int | None = None, is_changed: bool = False
    ) -> TimesDoubted | None:
        """Return what the maps until now got wrong according to a new map; None if it agrees with them.

        Maps are contradicted where the error bars do not overlap; if a clock `is_changed` for certain, within
        LOOK_BACK_NS also where the old bar does not contain the new time, and for as long again before. The
        interval reaches back to where the new line crosses the old ones, as a slewed clock's does, or agrees
        with them; or to `after_ns`, the last sample that agreed with the old maps: a stepped clock was
        right until then.
        """
        begins_ns = ends_ns = until_ns = now_ns
        errors, bounds = [0.0], [0.0]
        for used_ns, old in reversed(self._maps):
            from_ns = used_ns if after_ns is None else max(used_ns, after_ns)
            if from_ns >= until_ns:
                break
            apart = [new.leader_from_local(at) - old.leader_from_local(at) for at in (from_ns, until_ns)]
            is_known = is_changed or begins_ns < ends_ns
            if not any(
                abs(error) > old.uncertainty_at(at) + _slack(new, at, now_ns, is_known=is_known)
                for error, at in zip(apart, (from_ns, until_ns), strict=True)
            ):
                if begins_ns < ends_ns or not is_changed or now_ns - from_ns > LOOK_BACK_NS:
                    break
                begins_ns = ends_ns = until_ns = from_ns
                continue
            crosses = (apart[0] < 0) is not (apart[1] < 0)
            begins_ns = (
                until_ns - round((until_ns - from_ns) * apart[1] / (apart[1] - apart[0]))
                if crosses
                else from_ns
            )
            for at, error in ((begins_ns, 0 if crosses else apart[0]), (until_ns, apart[1])):
                errors.append(abs(error) + new.uncertainty_at(at))
                bounds.append(abs(error) + new.hard_bound_at(at))
            if crosses:
                break
            until_ns = from_ns
        if begins_ns == ends_ns:
            return None
        if is_changed and after_ns is None:
            # So soon the new line's slope is known to a factor of two: so is where it leaves the old one.
            begins_ns -= min(ends_ns - begins_ns, LOOK_BACK_NS)
        error_ns, bound_ns = (min(round(max(values)), MAX_COUNT) for values in (errors, bounds))
        return TimesDoubted(begins_ns, ends_ns, error_ns, bound_ns, after_ns is not None)


def _slack(new: TimeMap, at_ns: int, now_ns: int, *, is_known: bool) -> float:
    """Return the part of a new map's error that a contradiction must exceed: its growth if one is known."""
    return new.uncertainty_at(at_ns) - (new.uncertainty_at(now_ns) if is_known else 0.0)
