"""Whole-screen view of a result: its verdict, tables and notes, and its pictures in both conditions.

All texts are those that the command wrote or printed; nothing is computed here.
"""

import asyncio
import os
import webbrowser
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import msgspec
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from textual import events
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.widget import Widget
from textual.widgets import Static

from capture_app.common.errors import BadInputError
from capture_app.common.text import ProgressStep, printable
from capture_app.session.format.manifest import inside
from capture_app.tui.jobs.run import Run
from capture_app.tui.rig_record import ActionFailed, showing_errors
from capture_app.tui.widgets.cells import Image
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture, Source
from capture_app.tui.widgets.whole_screen import WholeScreen

BLINK_S = 0.8
WIDE = 150
"""Width from which pictures and tables are shown side by side."""
SYNCED, OFFSET = "synchronized", "offset"
_FIRST = ("multiview_depth", "stereo_depth", "panorama", "multiview_movers", "stereo_movers", "stereo_late")
"""Keys of the most informative pictures, shown first."""


@dataclass(frozen=True, slots=True)
class ResultPicture:
    """Picture in both conditions; `offset` is None if only the synchronized one exists."""

    title: str
    caption: str
    synced: Path
    offset: Path | None = None
    synced_label: str = SYNCED
    offset_label: str = OFFSET


class ResultTable(msgspec.Struct, frozen=True):
    """Table of formatted values: headings of the value columns, and rows that start with a name."""

    caption: str
    groups: tuple[str, ...]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class ShownResult(msgspec.Struct, frozen=True):
    """Result of a run as the screen shows it."""

    verdict: str
    pictures: tuple[ResultPicture, ...] = ()
    tables: tuple[ResultTable, ...] = ()
    notes: tuple[str, ...] = ()
    """What was left out, with the reason, and what else the command printed."""


def read_result(run: Run, log: Sequence[str] = ()) -> ShownResult:
    """Read a run's result; `log` is its output. Raises BadInputError if it is missing or unreadable."""
    path = run.result
    if path is None:
        raise BadInputError(f"{run.command.title} of {run.session.name} has no result", hint="run it again")
    try:
        found = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        words, labels = found.get("words") or {}, found.get("labels", {})
        skipped = (
            f"no {one['name']}: {one['skipped']}" for one in found.get("studies", ()) if one["skipped"]
        )
        left_out = (
            f"{labels.get(name, name)} is left out: {why}" for name, why in found.get("left_out", {}).items()
        )
        printed = [line for line in log if ProgressStep.parse(line) is None] if not words else ()
        return ShownResult(
            run.message,
            tuple(_pictures(found, words, path.parent)),
            msgspec.convert(words.get("tables", ()), tuple[ResultTable, ...]),
            tuple(
                note
                for note in dict.fromkeys((*skipped, *left_out, *words.get("remarks", ()), *printed))
                if note != run.message
            ),
        )
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}", hint="run it again") from error
    except (msgspec.DecodeError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise BadInputError(f"{path} is not a result of this version", hint="run it again") from error


def _pictures(found: dict[str, Any], words: dict[str, Any], folder: Path) -> Iterator[ResultPicture]:
    """Yield the pictures of a comparison, a panorama or depth maps, the most informative first."""
    studied = [
        (one, words.get("unsynchronized" if len(study["cameras"]) > 2 else "offset", OFFSET))
        for study in found.get("studies", ())
        for one in study["pictures"]
    ]
    for one, label in sorted(studied, key=lambda each: (*_FIRST, each[0]["key"]).index(each[0]["key"])):
        paths = inside(folder, one["synced"]), inside(folder, one["offset"])
        yield ResultPicture(one["title"], one["caption"], *paths, words.get("synced", SYNCED).lower(), label)
    synced, offset = found.get("synced", {}), found.get("offset") or {}
    for key, title in (("panorama", "Panorama"), ("ghosts", "Ghosts: where pictures do not fit")):
        if key in synced:
            other = inside(folder, offset[key]) if key in offset else None
            label = f"{found['actual_offset_ms']:.0f} ms offset"
            yield ResultPicture(title, "", inside(folder, synced[key]), other, SYNCED, label)
    for view in found.get("views", ()):
        caption = f"{found['nearest']:.3g} to {found['farthest']:.3g} {found['unit']}; dark: no distance"
        title = f"Distance, {found.get('labels', {}).get(view['camera'], view['camera'])}"
        yield ResultPicture(title, caption, inside(folder, view["picture"]))


def figures(result: ShownResult) -> Iterator[RenderableType]:
    """Yield the verdict, the tables and the notes."""
    first, dot, rest = printable(result.verdict).partition(". ")
    yield Text.assemble((first + dot, "bold"), rest + "\n")
    for table in result.tables:
        drawn = Table("", box=box.SIMPLE_HEAD, title=Text(printable(table.caption)), title_justify="left")
        for group, column in zip(table.groups, table.columns, strict=True):
            drawn.add_column(Text(printable(f"{group}\n{column}".strip())), justify="right")
        for row in table.rows:
            drawn.add_row(*(Text(printable(cell)) for cell in row))
        yield drawn
    yield from (Text(printable(note), style="dim") for note in result.notes)


class ResultScreen(WholeScreen[None]):
    """Screen of one result; Escape closes it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "switch", "Synced/offset", id="result.switch", key_display="space"),
        Binding("right", "move(1)", "Next picture", id="result.next", key_display="→"),
        Binding("left", "move(-1)", "Previous picture", id="result.previous", show=False, key_display="←"),
        Binding("b", "blink", "Blink", id="result.blink", tooltip="alternate both conditions"),
        Binding("tab", "figures", "Figures", id="result.figures"),
        Binding("o", "report", "Report", id="result.report"),
        Binding("escape,backspace", "dismiss", "Back", id="result.back", key_display="esc"),
    ]

    def __init__(self, run: Run, result: ShownResult) -> None:
        self._labels = Lines(id="result-labels")
        self._picture = Picture(words="no picture", id="result-picture")
        self._caption = Lines(id="result-caption")
        self._text = VerticalScroll(Static(Group(*figures(result)), id="result-figures"), id="result-words")
        self._pictures = Vertical(self._labels, self._picture, self._caption, id="result-pictures")
        super().__init__(Horizontal(self._text, self._pictures))
        self._run, self._result = run, result
        self._at = 0
        self.shows_offset = False
        """Whether the offset condition is shown."""
        self._figures = not result.pictures
        self._blinks = False
        self._sources: dict[Path, Source] = {}

    def on_mount(self) -> None:
        """Start the timer that blinks the conditions."""
        self.set_interval(BLINK_S, self._blink)
        title = printable(f" {self._run.command.title} · {self._run.session.name} · {self._run.out}")
        self.title_line.show([Content.styled(title, "bold")])

    @property
    def picture(self) -> ResultPicture | None:
        """Picture on display."""
        return next(iter(self._result.pictures[self._at :]), None)

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only what this result contains."""
        seen = not self._figures or self._is_wide
        has_two = seen and self.picture is not None and self.picture.offset is not None
        return {
            "switch": has_two,
            "blink": has_two,
            "move": seen and len(self._result.pictures) > 1,
            "figures": bool(self._result.pictures) and not self._is_wide,
            "report": self._run.report is not None,
        }.get(action, True)

    def action_switch(self) -> None:
        """Show the other condition."""
        self._blinks, self.shows_offset = False, not self.shows_offset
        self._show_picture()

    def action_blink(self) -> None:
        """Start or stop alternating between both conditions."""
        self._blinks = not self._blinks
        self._show_picture()

    def action_move(self, by: int) -> None:
        """Show another picture in the same condition."""
        self._at = (self._at + by) % len(self._result.pictures)
        self._show_picture()

    def on_click(self, event: events.Click) -> None:
        """Switch the condition after a click on the picture or on the labels above it."""
        if event.widget in (self._picture, self._labels) and self.check_action("switch", ()):
            self.action_switch()

    def action_figures(self) -> None:
        """Switch between tables and pictures."""
        self._figures = not self._figures
        self._lay_out()

    def action_report(self) -> None:
        """Open the report in the browser."""
        open_report(self, self._run.report)

    # Drawing

    @property
    def _is_wide(self) -> bool:
        return self.size.width >= WIDE

    def _lay_out(self) -> None:
        self.set_class(self._is_wide, "-wide")
        both = self._is_wide and bool(self._result.pictures)
        self._text.display = both or self._figures
        self._pictures.display = both or not self._figures
        if self._figures and not both:
            self._text.focus()
        self.call_after_refresh(self._show_picture)

    on_resize = _lay_out

    def _show_picture(self) -> None:
        picture = self.picture
        if picture is None:
            return
        path = picture.offset if picture.offset is not None and self.shows_offset else picture.synced
        self.shows_offset = path is picture.offset
        source = self._sources.setdefault(path, partial(_read, path))
        self._picture.show(
            source,
            "" if path.is_file() else f"{path.name} no longer exists: run the job again",
            sharp=None if self._blinks else source,
        )
        labels = [
            (f" {'●' if seen else '○'} {label} ", f"reverse bold {style}" if seen else "$foreground-muted")
            for label, seen, style in (
                (picture.synced_label, not self.shows_offset, "$success"),
                (picture.offset_label, self.shows_offset, "$error"),
            )
            if picture.offset is not None
        ]
        place = f" {self._at + 1}/{len(self._result.pictures)}  {printable(picture.title)}"
        self._labels.show([Content.assemble(*labels, (place, "bold"))])
        width = max(24, self._caption.scrollable_content_region.width)
        self._caption.show(Content.styled(printable(picture.caption), "$foreground-muted").wrap(width)[:3])
        self.refresh_bindings()

    def _blink(self) -> None:
        if self._blinks:
            self.shows_offset = not self.shows_offset
            self._show_picture()


def open_report(widget: Widget, report: Path | None) -> None:
    """Open a report in the browser; over SSH, or without a browser, show its path and copy it."""
    if report is None or not report.is_file():
        error = BadInputError("the report no longer exists", hint="run the job again: key 4, then r")
        widget.post_message(ActionFailed(error))
        return
    path = report.resolve()
    if "SSH_CONNECTION" in os.environ or "SSH_TTY" in os.environ or not _has_browser():
        widget.app.copy_to_clipboard(str(path))
        widget.app.notify(f"The file is on this machine:\n{path}", markup=False, timeout=30)
    else:
        widget.app.open_url(path.as_uri())
        widget.app.notify(f"Opened\n{path}", markup=False)


def _has_browser() -> bool:
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def _read(path: Path) -> bytes | Image | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


async def show_result(widget: Widget, run: Run, log: Sequence[str]) -> None:
    """Show a run's result on the whole screen, or an error if it cannot be read; `log` is its output."""
    with showing_errors(widget):
        await widget.app.push_screen(ResultScreen(run, await asyncio.to_thread(read_result, run, log)))
