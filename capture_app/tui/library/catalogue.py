"""Which sessions are listed and in what order, and which of them is the best synchronized."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import capture_app
from capture_app.names import natural_order
from capture_app.session.library.listing import SessionCard, SessionState, best_synchronized

SAMPLES = "sample_sessions"


class Order(StrEnum):
    """How sessions are sorted."""

    NEWEST = "newest first"
    SYNCHRONIZED = "best synchronized first"
    NAME = "by name"

    @property
    def following(self) -> "Order":
        """The next one, round and round."""
        orders = list(Order)
        return orders[(orders.index(self) + 1) % len(orders)]


@dataclass(frozen=True, slots=True)
class Entry:
    """One session of the list."""

    card: SessionCard
    is_sample: bool = False
    """It came with the program, and stays as it is."""
    is_best: bool = False
    """The best synchronized of those that are listed."""

    @property
    def key(self) -> str:
        """What tells it from others."""
        return str(self.card.folder.absolute())


def arrange(
    sessions: Sequence[SessionCard], samples: Sequence[SessionCard], order: Order, words: str = ""
) -> list[Entry]:
    """The sessions that have all the words in what is shown of them, sorted; samples come last."""
    found = [card for card in sessions if _matches(card, words)]
    best = best_synchronized(found)
    return [
        *(Entry(card, is_best=card is best) for card in _sort(found, order)),
        *(Entry(card, is_sample=True) for card in _sort([c for c in samples if _matches(c, words)], order)),
    ]


def find_samples(sessions: Path) -> Path | None:
    """The folder of the bundled samples: here, else beside the program; None where they are not there."""
    for folder in (Path(SAMPLES), Path(capture_app.__file__).parents[1] / SAMPLES):
        if folder.is_dir() and folder.resolve() != sessions.resolve():
            return folder
    return None


def _sort(cards: Sequence[SessionCard], order: Order) -> list[SessionCard]:
    by_name = sorted(cards, key=lambda card: natural_order(card.name))
    if order is Order.NAME:
        return by_name
    if order is Order.SYNCHRONIZED:
        return sorted(by_name, key=lambda card: (card.worst_ns is None, card.worst_ns or 0))
    # What is being saved has no date yet and is the newest of all.
    return sorted(by_name, key=lambda card: (card.state is SessionState.WRITING, card.created), reverse=True)


def _matches(card: SessionCard, words: str) -> bool:
    text = " ".join((card.name, card.note, card.origin, card.state, card.created[:10], *card.cameras))
    return all(word in text.casefold() for word in words.casefold().split())
