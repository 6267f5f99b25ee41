"""Settings of the next take as a list; arrow keys select and change them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Literal, Self, TypeVar

from textual import events, work
from textual.binding import Binding, BindingType
from textual.content import Content

from capture_app.common.camera_facts import SIMULATED
from capture_app.common.names import is_name, typed_name
from capture_app.common.take_limits import LIMITS
from capture_app.common.text import count, duration, printable
from capture_app.protocol.orders import FLAT_SCENES
from capture_app.protocol.status import RigStatus
from capture_app.rig.motion_watch import WHOLE, Region
from capture_app.rig.taking import TakePlan
from capture_app.session.library.changes import check_note
from capture_app.tui.question import ListQuestion, TextQuestion
from capture_app.tui.screen_settings import Settings
from capture_app.tui.widgets.lines import Lines

V = TypeVar("V")
MAX_BEFORE = 60
"""Max frames before the key press: a node stores frames of 3 s, and the order needs time to reach it."""
MAX_FRAMES = int(LIMITS["frames"][1])
LENGTHS_S = (0.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0)
"""Durations of a recording; 0: until it is stopped."""
NTHS = (1, 2, 3, 5, 10, 15, 30, 60, 150, 300, 900, 1800)
"""Choices of which frames a recording saves: each nth."""
MAX_RENDERED = 1500
"""Maximum frames that a recording leaves simulated cameras to render."""
REGIONS: dict[str, Region] = {
    "whole picture": WHOLE,
    "left half": (0.0, 0.0, 0.5, 1.0),
    "right half": (0.5, 0.0, 1.0, 1.0),
    "upper half": (0.0, 0.0, 1.0, 0.5),
    "lower half": (0.0, 0.5, 1.0, 1.0),
    "middle": (0.25, 0.25, 0.75, 0.75),
}


TakeMode = Literal["single", "interval", "sequence", "motion", "recording"]
"""Effect of one key press."""
MODES: dict[TakeMode, str] = {
    "single": "one take",
    "interval": "a take at a fixed interval (time lapse)",
    "sequence": "take after take, each as soon as the one before is saved",
    "motion": "a take whenever something moves",
    "recording": "a video with every camera, until stopped",
}
"""What each mode does, in words."""
_SERIES: tuple[TakeMode, ...] = ("interval", "sequence", "motion")
_PICTURES: tuple[TakeMode, ...] = ("single", *_SERIES)
LABEL = 10


def _take_name(text: str) -> str:
    return typed_name(text, "take") if text.strip() else ""


TEXTS: dict[str, tuple[str, str, Callable[[str], object]]] = {
    "name": ("name", "Name of the following takes and of their folders. Default: burst.", _take_name),
    "notes": ("note", "Note saved with each following take.", check_note),
}
"""Rows that are texts, by label: field of the settings, explanation, and check."""


@dataclass(frozen=True, slots=True)
class TakeSettings:
    """Settings of the next take; times in seconds."""

    frames: int = 8
    """Frames per camera, including those before the key press."""
    before: int = 3
    mode: TakeMode = "single"
    countdown_s: float = 0.0
    every_s: float = 5.0
    """Time between takes of an interval; minimum time for motion."""
    region: str = next(iter(REGIONS))
    """Region in which motion triggers a take, by its name in REGIONS."""
    takes: int = 3
    """Number of takes in a series."""
    seconds: float = 0.0
    """Duration of a recording; 0: until it is stopped."""
    nth: int = 1
    """A recording saves each nth frame."""
    name: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        """Clamp the numbers to their limits."""
        frames = min(max(self.frames, 1), MAX_FRAMES)
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "nth", max(self.nth, 1))
        object.__setattr__(self, "before", min(max(self.before, 0), MAX_BEFORE, frames))

    @classmethod
    def recall(cls, settings: Settings) -> Self:
        """Return the stored settings."""
        stored = {name: settings.recall(f"shoot.{name}", value) for name, value in cls()._stored().items()}
        valid = {
            "mode": stored["mode"] in MODES,
            "region": stored["region"] in REGIONS,
            "name": is_name(stored["name"]),
        }
        return cls(**{name: value for name, value in stored.items() if valid.get(name, True)})

    def remember(self, settings: Settings) -> None:
        """Store the settings for the next start, except the note, which belongs to one take."""
        for name, value in self._stored().items():
            settings.remember(f"shoot.{name}", value)

    def _stored(self) -> dict[str, Any]:
        return {name: value for name, value in asdict(self).items() if name != "note"}

    @property
    def after(self) -> int:
        """Frames from the key press on."""
        return self.frames - self.before

    def with_before(self, before: int) -> Self:
        """Return the settings with this many frames before the key press, and unchanged frames after it."""
        before = min(max(before, 0), MAX_BEFORE)
        return replace(self, frames=max(before + self.after, 1), before=before)

    def with_after(self, after: int) -> Self:
        """Return the settings with this many frames after the key press, and unchanged frames before it."""
        return replace(self, frames=max(self.before + max(after, 0), 1))

    def plan(self, max_s: float | None = None, period_ns: int | None = None) -> TakePlan:
        """Return the plan of a take with these settings; `period_ns` is the rig's.

        A recording of all frames lasts at most `max_s` seconds.
        """
        pictures: dict[str, Any] = {"frames": self.frames, "before": self.before}
        video: dict[str, Any] = {
            "video": True,
            "seconds": min(filter(None, (self.seconds, (max_s or 0.0) * self.nth)), default=None),
            "interval_s": self.nth * period_ns * 1e-9 if period_ns and self.nth > 1 else None,
        }
        return TakePlan(
            name=self.name,
            note=self.note,
            countdown_s=self.countdown_s,
            repeat=self.takes if self.mode in _SERIES else 1,
            every_s=self.every_s if self.mode in ("interval", "motion") else None,
            on_motion=REGIONS[self.region] if self.mode == "motion" else None,
            **(video if self.mode == "recording" else pictures),
        )


def render_limit_s(status: RigStatus) -> float | None:
    """Return the longest recording, in s, that leaves the rig MAX_RENDERED frames of a scene to render.

    None without a simulated camera of a scene on the leader's machine: a test card is drawn while it records.
    """
    rendered = sum(
        node.camera.kind == SIMULATED
        and "scene=" in node.spec
        and not any(f"scene={flat}" in node.spec for flat in FLAT_SCENES)
        for node in status.cameras
    )
    return (
        round(MAX_RENDERED * status.period_ns / rendered / 1e9, 1) if rendered and status.period_ns else None
    )


def stepped(values: tuple[float, ...], value: float, steps: int) -> float:
    """Return the value `steps` after the nearest one in `values`, clamped at the ends."""
    nearest = min(range(len(values)), key=lambda at: abs(values[at] - value))
    return values[min(max(nearest + steps, 0), len(values) - 1)]


@dataclass(frozen=True, slots=True)
class _Row:
    label: str
    text: Callable[[TakeSettings, int | None], str]
    change: Callable[[TakeSettings, int], TakeSettings] | None = None
    """None for a line of text."""
    modes: Sequence[TakeMode] = tuple(MODES)


def _frames(number: int, period_ns: int | None, sign: str) -> str:
    return f"{number:<2} {sign}{duration(number * period_ns)}" if period_ns and number else str(number)


def _next(values: Sequence[V], value: V, steps: int) -> V:
    """Return the value `steps` after this one in `values`, cyclically."""
    return values[(values.index(value) + steps) % len(values)]


ROWS = (
    _Row(
        "before",
        lambda p, ns: _frames(p.before, ns, "-"),
        lambda p, by: p.with_before(p.before + by),
        _PICTURES,
    ),
    _Row(
        "after",
        lambda p, ns: _frames(p.after, ns, "+"),
        lambda p, by: p.with_after(p.after + by),
        _PICTURES,
    ),
    _Row(
        "length",
        lambda p, _: f"{p.seconds:g} s" if p.seconds else "until Space",
        lambda p, by: replace(p, seconds=stepped(LENGTHS_S, p.seconds, by)),
        ("recording",),
    ),
    _Row(
        "rate",
        lambda p, ns: f"{1e9 / ns / p.nth:.3g} fps" if ns else f"1 of {count(p.nth, 'frame')}",
        lambda p, by: replace(p, nth=int(stepped(NTHS, p.nth, -by))),
        ("recording",),
    ),
    _Row(
        "countdown",
        lambda p, _: f"{p.countdown_s:g} s" if p.countdown_s else "none",
        lambda p, by: replace(p, countdown_s=stepped((0.0, 3.0, 5.0, 10.0, 20.0), p.countdown_s, by)),
    ),
    _Row("mode", lambda p, _: p.mode, lambda p, by: replace(p, mode=_next(tuple(MODES), p.mode, by))),
    _Row(
        "every",
        lambda p, _: f"{p.every_s:g} s",
        lambda p, by: replace(p, every_s=stepped((2.0, 5.0, 10.0, 30.0, 60.0, 300.0), p.every_s, by)),
        ("interval", "motion"),
    ),
    _Row(
        "where",
        lambda p, _: p.region,
        lambda p, by: replace(p, region=_next(list(REGIONS), p.region, by)),
        ("motion",),
    ),
    _Row(
        "takes",
        lambda p, _: str(p.takes),
        lambda p, by: replace(p, takes=int(stepped((2, 3, 5, 10, 20, 50, 100), p.takes, by))),
        _SERIES,
    ),
    _Row("name", lambda p, _: p.name or ("recording" if p.mode == "recording" else "burst")),
    _Row("notes", lambda p, _: p.note or "–"),
)


class PlanPanel(Lines, can_focus=True):
    """List of the next take's settings, which the user can change."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "choose(-1)", "Setting above", id="plan.up", show=False),
        Binding("down", "choose(1)", "Setting below", id="plan.down", show=False),
        Binding("left", "change(-1)", "Less", id="plan.less", show=False),
        Binding("right", "change(1)", "More", id="plan.more", show=False),
        Binding("enter", "edit", "Edit", id="plan.edit", show=False),
    ]

    def __init__(self, settings: Settings) -> None:
        super().__init__(id="plan")
        self.settings = TakeSettings.recall(settings)
        self._store = settings
        self.border_title = "Next take"
        self._chosen = 0
        self._period_ns: int | None = None
        self.max_s: float | None = None
        """Maximum length of a recording; None without a limit."""
        self._show()

    def watch_has_focus(self, has_focus: bool) -> None:
        """Mark or unmark the selected setting."""
        super().watch_has_focus(has_focus)
        self._show()

    def on_click(self, event: events.Click) -> None:
        """Select a setting; on the selected one, decrease it on the left half, increase it on the right."""
        at = event.y - 1
        if at == self._chosen:
            self.action_change(1 if event.x > self.size.width // 2 else -1)
        elif 0 <= at < len(self._rows()):
            self._chosen = at
            self._show()

    def show_rig(self, status: RigStatus) -> None:
        """Show the durations of the frame counts at the rig's period, and how long it can record."""
        now = status.period_ns, render_limit_s(status)
        if now != (self._period_ns, self.max_s):
            self._period_ns, self.max_s = now
            self._show()

    @property
    def advice(self) -> str:
        """What limits the next take, in words; empty if nothing does."""
        return (
            ""
            if self.settings.mode != "recording" or self.max_s is None
            else f"A recording of simulated cameras ends after {self.max_s * self.settings.nth:.0f} s:"
            f" rendering its {MAX_RENDERED} frames takes minutes. Fewer cameras record longer; the scene"
            " bars has no limit."
        )

    def plan(self) -> TakePlan:
        """Return the plan of the next take."""
        return self.settings.plan(self.max_s, self._period_ns)

    def change(self, settings: TakeSettings) -> None:
        """Use these settings from now on, and store them."""
        if settings != self.settings:
            chosen, self.settings = self._rows()[self._chosen], settings
            rows = self._rows()
            self._chosen = rows.index(chosen) if chosen in rows else min(self._chosen, len(rows) - 1)
            self._show()
            settings.remember(self._store)

    def action_choose(self, by: int) -> None:
        """Select another setting."""
        self._chosen = min(max(self._chosen + by, 0), len(self._rows()) - 1)
        self._show()

    def action_change(self, by: int) -> None:
        """Change the selected setting."""
        if (change := self._rows()[self._chosen].change) is None:
            self.action_edit()
        else:
            self.change(change(self.settings, by))

    @work(group="asking")
    async def action_edit(self, what: str = "") -> None:
        """Edit the `name`, the `notes` or the `mode` of the following takes; by default, the selected one."""
        what = what or self._rows()[self._chosen].label
        typed, field = None, what
        if what == "mode":
            modes: dict[str, tuple[str, str]] = {mode: (mode, does) for mode, does in MODES.items()}
            typed = await self.app.push_screen_wait(ListQuestion("Space takes", modes, self.settings.mode))
        elif what in TEXTS:
            field, words, check = TEXTS[what]
            now = getattr(self.settings, field)
            question = TextQuestion(words, now, check=check, title=what.capitalize())
            typed = await self.app.push_screen_wait(question)
        if typed is not None:
            changed: Any = {field: _take_name(typed) if field == "name" else typed.strip()}
            self.change(replace(self.settings, **changed))

    def _rows(self) -> tuple[_Row, ...]:
        return tuple(row for row in ROWS if self.settings.mode in row.modes)

    def _show(self) -> None:
        self.show(
            self._line(row, is_here=at == self._chosen and self.has_focus)
            for at, row in enumerate(self._rows())
        )

    def _line(self, row: _Row, *, is_here: bool) -> Content:
        value = printable(row.text(self.settings, self._period_ns))
        if is_here:
            value = f"{value} …" if row.change is None else f"‹ {value} ›"
        return Content.assemble(
            (f"{row.label:<{LABEL}}", "$foreground-muted"),
            (value, "bold $primary" if is_here else "$foreground"),
        )
