"""How the next take will be: frames before and after the key, countdown, mode, name and notes."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

from capture_app.names import is_name
from capture_app.node.wire.messages import BurstRequest
from capture_app.tui.settings import Settings

MOST_BEFORE = 60
"""Frames before the key: a node keeps those of 3 s, and the order takes its time to get there."""
MOST_FRAMES = 300
MOST_NOTE = 1000
COUNTDOWNS_S = (0, 3, 5, 10, 20)
INTERVALS_S = (2.0, 5.0, 10.0, 30.0, 60.0, 300.0)
LENGTHS_S = (0, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600)
"""Of a recording; 0: until it is ended."""
TAKES = (2, 3, 5, 10, 20, 50, 100)


class TakeMode(StrEnum):
    """What one press of the key begins."""

    SINGLE = "single"
    """One take."""
    INTERVAL = "interval"
    """A take every so many seconds, until it is stopped or all are there."""
    SEQUENCE = "sequence"
    """Take after take, each as soon as the one before is saved."""
    RECORDING = "recording"
    """A video with every camera, until it is ended."""


@dataclass(frozen=True, slots=True)
class TakePlan:
    """The settings of the take; times in seconds."""

    frames: int = 8
    """Of each camera, those before the key included."""
    before: int = 3
    mode: TakeMode = TakeMode.SINGLE
    countdown_s: float = 0
    every_s: float = 5.0
    takes: int = 3
    """Of an interval or a sequence."""
    seconds: float = 0
    """Of a recording; 0: until it is ended."""
    name: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        """Keep the numbers in their bounds."""
        frames = min(max(self.frames, 1), MOST_FRAMES)
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "before", min(max(self.before, 0), MOST_BEFORE, frames))

    @classmethod
    def recall(cls, settings: Settings) -> Self:
        """The plan as it was left."""
        plain = cls()
        mode = settings.recall("shoot.mode", str(plain.mode))
        name = settings.recall("shoot.name", plain.name)
        return cls(
            frames=settings.recall("shoot.frames", plain.frames),
            before=settings.recall("shoot.before", plain.before),
            mode=TakeMode(mode) if mode in set(TakeMode) else plain.mode,
            countdown_s=settings.recall("shoot.countdown_s", float(plain.countdown_s)),
            every_s=settings.recall("shoot.every_s", plain.every_s),
            takes=settings.recall("shoot.takes", plain.takes),
            seconds=settings.recall("shoot.seconds", float(plain.seconds)),
            name=name if not name or is_name(name) else "",
        )

    def remember(self, settings: Settings) -> None:
        """Keep it for the next start; notes are about one take."""
        settings.remember("shoot.frames", self.frames)
        settings.remember("shoot.before", self.before)
        settings.remember("shoot.mode", str(self.mode))
        settings.remember("shoot.countdown_s", float(self.countdown_s))
        settings.remember("shoot.every_s", self.every_s)
        settings.remember("shoot.takes", self.takes)
        settings.remember("shoot.seconds", float(self.seconds))
        settings.remember("shoot.name", self.name)

    @property
    def after(self) -> int:
        """Frames from the key on."""
        return self.frames - self.before

    def with_before(self, before: int) -> Self:
        """As many after the key as now, and so many before."""
        before = min(max(before, 0), MOST_BEFORE)
        return replace(self, frames=max(before + self.after, 1), before=before)

    def with_after(self, after: int) -> Self:
        """As many before the key as now, and so many after."""
        return replace(self, frames=max(self.before + max(after, 0), 1))

    def request(self, *, wait_ready_s: float = 0.0, cameras: int = 1) -> BurstRequest:
        """What a leader is asked for; it waits so long until so many cameras are ready."""
        if self.mode is TakeMode.RECORDING:
            return BurstRequest(
                seconds=self.seconds or None,
                spare=0,
                video=True,
                name=self.name,
                note=self.note,
                wait_ready_s=wait_ready_s,
                nodes=max(cameras, 1),
            )
        return BurstRequest(
            frames=self.frames,
            before=self.before,
            name=self.name,
            note=self.note,
            wait_ready_s=wait_ready_s,
            nodes=max(cameras, 1),
        )


def stepped(values: tuple[float, ...], value: float, steps: int) -> float:
    """The value so many steps further among these, from the nearest on."""
    nearest = min(range(len(values)), key=lambda at: abs(values[at] - value))
    return values[min(max(nearest + steps, 0), len(values) - 1)]
