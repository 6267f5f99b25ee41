"""Clips of two cameras that were recorded together, by their names, their clocks or their order.

Two cameras' clocks often differ by whole hours, or by any constant: then dates pair some clips with those of
the wrong take. One difference that is common to all takes pairs them all. Where dates allow several
pairings, what was heard in both decides.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

_SLACK_S = 2.0
_HEARD_PAIRS = 3
"""Number of pairs of each pairing that are compared by sound."""
_COUNTER = re.compile(r"(?!take|run)[A-Za-z]{0,4}_?\d{3,}", re.IGNORECASE)
"""A name that cameras count, such as IMG_0001 or C0017: equal ones of two cameras mean nothing."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A video: its length, and its start by its camera's clock, s; the start is None if unknown."""

    path: Path
    seconds: float
    began_s: float | None

    def together(self, other: "Clip") -> bool:
        """Return whether both were recorded at the same time, by their dates."""
        if self.began_s is None or other.began_s is None:
            return False
        apart_s = other.began_s - self.began_s
        return apart_s <= self.seconds + _SLACK_S if apart_s >= 0 else -apart_s <= other.seconds + _SLACK_S


Key = tuple[str, ...]
Pairs = tuple[tuple[Clip, Clip], ...]
Heard = Callable[[Path, Path], bool]
"""Returns whether two videos recorded the same sound."""


def take_keys(cameras: Mapping[str, Sequence[Clip]]) -> dict[Clip, Key]:
    """Return the words of each clip's name with its camera's own one blanked: equal for clips of one take.

    A camera's own word is its label, or a word that all of its clips have and no other camera's. Where two
    clips of a camera have the same words, the types of file tell clips apart.
    """
    words = {clip: _words(clip) for clips in cameras.values() for clip in clips}
    keys: dict[Clip, Key] = {}
    for name, clips in cameras.items():
        others = {word for clip, of in words.items() if clip not in clips for word in of}
        common = set.intersection(*(set(words[clip]) for clip in clips))
        learned = {word for word in common - others if not (word.isdecimal() or _COUNTER.fullmatch(word))}
        own = common & {name.casefold()} or learned
        for clip in clips:
            key = tuple("" if word in own else word for word in words[clip])
            # Without its learned word, a name must still say which take it is.
            keys[clip] = key if any(key) or name.casefold() in own else words[clip]
    twice = {key for clips in cameras.values() for key, n in Counter(keys[c] for c in clips).items() if n > 1}
    return {clip: (*key, clip.path.suffix.casefold()) if key in twice else key for clip, key in keys.items()}


def is_counted(clip: Clip) -> bool:
    """Return whether a clip's name is one that cameras count, which says nothing of another camera's."""
    return _COUNTER.fullmatch(clip.path.stem) is not None


def _words(clip: Clip) -> Key:
    return tuple(re.split(r"[\s_\-.]+", clip.path.stem.casefold()))


def pair_clips(
    names: tuple[str, str],
    first: Sequence[Clip],
    clips: Sequence[Clip],
    heard: Heard,
    keys: Mapping[Clip, Key] | None = None,
) -> tuple[Pairs, str]:
    """Return the clips of two cameras that belong together, and what this assumes; empty if nothing.

    `names` are the cameras'. Clips of both are in the order of their names. `keys` are their `take_keys`.
    """
    key = keys or take_keys({names[0]: first, names[1]: clips})
    named = tuple((clip, other) for clip in first for other in clips if key[clip] == key[other])
    counted = all(is_counted(clip) for clip, _ in named)
    if len(named) == min(len(first), len(clips)) and not counted:
        return named, ""
    if all(clip.began_s is not None for clip in (*first, *clips)):
        dated, note = _by_clocks(names, first, clips, heard)
        taken = {clip for pair in named for clip in pair if not counted}
        return (*(() if counted else named), *(pair for pair in dated if taken.isdisjoint(pair))), note
    if named or len(first) != len(clips):
        return named, ""
    by_order = tuple(zip(first, clips, strict=True))
    return by_order, f"the clips of {' and '.join(names)} are paired by their order"


def _by_clocks(
    names: tuple[str, str], first: Sequence[Clip], clips: Sequence[Clip], heard: Heard
) -> tuple[Pairs, str]:
    """Pair clips by their dates, or by a constant difference of the clocks that pairs all of them."""
    fewest = min(len(first), len(clips))
    straight = _at_difference(first, clips, 0.0)
    # A difference that pairs all clips pairs the first one of the camera with fewer.
    anchor = min(first, clips, key=len)[0]
    pairs = ((clip, other) for clip in first for other in clips if anchor in (clip, other))
    later_s = sorted(
        ((other.began_s or 0.0) - (first_clip.began_s or 0.0) for first_clip, other in pairs), key=abs
    )
    shifted = {tuple(_at_difference(first, clips, by_s)): by_s for by_s in reversed(later_s)}
    complete = {pairs: by_s for pairs, by_s in shifted.items() if len(pairs) == fewest}
    if len(straight) == fewest or not complete:
        return straight, ""
    possible = {**complete, **({straight: 0.0} if straight else {})}
    scores = {
        pairs: sum(heard(first_clip.path, other.path) for first_clip, other in pairs[:_HEARD_PAIRS])
        for pairs in (possible if len(possible) > 1 else ())
    }
    leading = [pairs for pairs, score in scores.items() if score == max(scores.values()) > 0]
    is_heard, likeliest = len(leading) == 1, straight if len(complete) > 1 else next(iter(complete))
    chosen = leading[0] if is_heard else likeliest
    by_s = possible.get(chosen) or min(complete.values(), key=abs)
    by, apart = "sound" if is_heard else "dates alone", timedelta(seconds=round(abs(by_s)))
    if chosen == straight:
        return (
            chosen,
            f"by their {by}, {' and '.join(names)} have equal clocks, and do not differ by {apart} h",
        )
    ahead, behind = names[::-1] if by_s > 0 else names
    sure = "; otherwise each missed a take" if straight and not is_heard else ""
    return (
        chosen,
        f"by their {by}, the clock of {ahead} is {apart} h ahead of that of {behind} in all takes{sure}",
    )


def _at_difference(first: Sequence[Clip], clips: Sequence[Clip], later_s: float) -> Pairs:
    """Return the clips that were recorded together if the second camera's clock is `later_s` ahead."""
    pairs: list[tuple[Clip, Clip]] = []
    left = list(clips)
    for clip in first:
        at = replace(clip, began_s=(clip.began_s or 0.0) + later_s)
        if (other := next(filter(at.together, left), None)) is not None:
            pairs.append((clip, other))
            left.remove(other)
    return tuple(pairs)
