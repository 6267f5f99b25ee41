"""Details of one camera, over the mode from which it was opened."""

import asyncio
from typing import ClassVar

from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical
from textual.content import Content

from capture_app.common.camera_facts import Control, describe, describe_stamp, parse_settings
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import WITHOUT_CAMERA
from capture_app.common.text import NO_VALUE, clock_offset, count, duration, printable
from capture_app.protocol.orders import DetailRequest
from capture_app.protocol.status import NodeDetail, NodeStatus, Preview
from capture_app.rig.rig_link import CamerasControls, RigLink
from capture_app.tui.question import TextQuestion
from capture_app.tui.rig_record import RecordChanged, RigRecord, showing_errors
from capture_app.tui.signs import SIGNS
from capture_app.tui.widgets.dialog import Dialog
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.lines import Lines, fitting, log_lines, write_border
from capture_app.tui.widgets.picture import Picture
from capture_app.tui.widgets.plots import (
    TYPICAL_TOLERANCE_NS,
    histogram_rows,
    histogram_title,
    wedge_rows,
    wedge_title,
)

ASK_S = 0.7
"""Interval between detail requests, in seconds."""
PREVIEW_FPS, PREVIEW_WIDTH = 2.5, 320


class CameraScreen(Dialog[None]):
    """Screen of a camera's details, which it requests at intervals while it is shown."""

    AUTO_FOCUS: ClassVar[str | None] = ""
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,backspace,enter", "leave", "Back", key_display="esc", id="camera.back"),
        Binding("left,up,k", "move(-1)", "Previous", id="camera.previous"),
        Binding("right,down,j", "move(1)", "Next", id="camera.next"),
        Binding(
            "X",
            "set",
            "Exposure",
            id="camera.set",
            tooltip="sets exposure, gain, white balance, focus",
        ),
        Binding(
            "C",
            "match",
            "Set all like this",
            id="camera.match",
            tooltip="all cameras get its exposure and colour",
        ),
    ]

    def __init__(self, name: str, source: RigLink, record: RigRecord) -> None:
        self._facts = Lines(id="camera-facts")
        self._wedge, self._histogram, self._log = Lines(), Lines(), Lines()
        self._picture = Picture(words="waiting for a picture", id="camera-picture")
        shown = {"wedge": self._wedge, "view": self._picture, "histogram": self._histogram, "log": self._log}
        self._panels = [Vertical(one, id=f"camera-{what}", classes="panel") for what, one in shown.items()]
        super().__init__(self._facts, Container(*self._panels, id="camera-grid"), KeyFooter(id="footer"))
        self._camera = name
        self._source = source
        self._record = record
        self._detail = NodeDetail(camera=name)
        self._problem = ""
        """Reason why the details are unknown."""

    def on_mount(self) -> None:
        """Start requesting details."""
        self._ask()

    def on_screen_resume(self, _: events.ScreenResume) -> None:
        """Resume the previews."""
        self._watch((self._camera,))

    def on_screen_suspend(self, _: events.ScreenSuspend) -> None:
        """Stop this screen's previews, unless another mode is shown now, which requests its own."""
        if self.app.current_mode == "rig":
            self._watch(None)

    def on_resize(self) -> None:
        """Redraw for the new size."""
        self.call_after_refresh(self._draw)

    def on_record_changed(self, message: RecordChanged) -> None:
        """Update the camera's facts and preview."""
        if not isinstance(message.what, Preview):
            self._draw_facts()
        elif message.what.camera == self._camera:
            self._picture.show(message.what.jpeg)

    # Actions

    def action_leave(self) -> None:
        """Return to the list of cameras."""
        self._watch(None)
        self.dismiss(None)

    def action_move(self, step: int) -> None:
        """Switch to another camera."""
        names = [node.name for node in self._members]
        if names:
            at = names.index(self._camera) if self._camera in names else 0
            self._camera = names[(at + step) % len(names)]
            self._detail = NodeDetail(camera=self._camera)
            self._picture.show(None)
            self._watch((self._camera,))
            self._draw()
            self._ask()

    @work(exclusive=True, group="match")
    async def action_match(self) -> None:
        """Copy this camera's exposure, gain, white balance and focus to all others; show what failed."""
        with showing_errors(self):
            found = await self._source.match_cameras(self._camera)
            self._report(found, f"{count(len(found), 'camera')} set like {self._record.title(self._camera)}")

    @work(exclusive=True, group="match")
    async def action_set(self) -> None:
        """Ask for this camera's exposure, gain, white balance and focus, and set them; show what failed."""
        camera, can = self._camera, [state for state in self._detail.controls if state.can_be_set]
        ranges = [f"{one.control}: {describe(one)}; {one.minimum:g} to {one.maximum:g}" for one in can]
        now = (
            f"{one.control}={'auto' if one.automatic else f'{one.value:g}'}"
            for one in can
            if one.automatic or one.value is not None
        )
        question = TextQuestion(
            "\n".join([*(ranges or ["Its driver offers no control."]), "", "CONTROL=VALUE, auto or hold."]),
            " ".join(now),
            check=lambda text: parse_settings(text.split()),
            title=f"Set {self._record.title(camera)}",
        )
        if text := await self.app.push_screen_wait(question):
            with showing_errors(self):
                found = await self._source.set_camera(camera, parse_settings(text.split()))
                self._report(found, f"{self._record.title(camera)} is set; C sets all like it")

    def _report(self, found: CamerasControls, words: str) -> None:
        """Say what was set, and each reason why something was not."""
        problems = [
            f"\n{self._record.title(name)}: {why}"
            for name, state in found.items()
            for why in dict.fromkeys(state.problems.values())
        ]
        self.notify(
            printable("".join([words, ", except:" * bool(problems), *problems])),
            severity="warning" if problems else "information",
            markup=False,
            timeout=20,
        )

    @work(exclusive=True, group="detail")
    async def _ask(self) -> None:
        while True:
            if self.is_current:
                try:
                    self._detail = await self._source.ask(DetailRequest(camera=self._camera), NodeDetail)
                    self._problem = ""
                except SimulshotError as error:
                    self._problem = printable(str(error))
                self._draw()
            await asyncio.sleep(ASK_S)

    def _watch(self, cameras: tuple[str, ...] | None) -> None:
        asking = self._source.want_previews(
            cameras=cameras, width=PREVIEW_WIDTH, fps=0.0 if cameras is None else PREVIEW_FPS
        )
        self.run_worker(asking, group="previews")

    # Drawing

    @property
    def _members(self) -> tuple[NodeStatus, ...]:
        return self._record.status.nodes if self._record.status else ()

    @property
    def _node(self) -> NodeStatus | None:
        return next((node for node in self._members if node.name == self._camera), None)

    def _draw(self) -> None:
        self._draw_facts()
        node, detail = self._node, self._detail
        tolerance = (node and node.tolerance_ns) or TYPICAL_TOLERANCE_NS
        wedge, view, histogram, log = self._panels
        titles = {
            wedge: wedge_title(detail.samples),
            view: "picture",
            histogram: histogram_title(detail.phase_errors_ns, tolerance),
            log: "log",
        }
        for panel, title in titles.items():
            write_border(panel, title)
        self._wedge.show(wedge_rows(detail.samples, *wedge.size))
        self._histogram.show(histogram_rows(detail.phase_errors_ns, tolerance, *histogram.size))
        lines = log_lines(detail.log, log.size.width)[-max(log.size.height, 1) :]
        if self._problem:
            lines = Content.styled(self._problem, "$warning").wrap(log.size.width or 1)
        self._log.show(lines or [Content.styled("No log lines yet.", "$foreground-muted")])

    def _draw_facts(self) -> None:
        node, detail = self._node, self._detail
        if node is None:
            words = Content.styled(f"{printable(self._camera)} has left the rig.", "bold")
            self._facts.show([words, Content(""), Content("")])
            return
        sign = SIGNS[node.state]
        first = [
            (f"{printable(node.camera.called(node.name))}  ", "bold $primary"),
            (str(sign), f"bold {sign.style}"),
        ]
        if node.message:
            first.append((f"  {printable(node.message)}", sign.style))
        bound = "" if node.hard_bound_ns is None else f", at most ±{duration(node.hard_bound_ns)}"
        clock = f"clock ±{duration(node.uncertainty_ns)}" if node.uncertainty_ns is not None else "clock –"
        second = [
            f"phase {duration(node.phase_error_ns, signed=True).replace('-', '−')}",
            clock + bound,
            f"{NO_VALUE if node.fps is None else f'{node.fps:.3g}'} fps",
            count(node.drops, "drop"),
            f"clock offset {clock_offset(node.offset_ns)}",
        ]
        facts = node.camera
        third = [f"{printable(facts.model)} {facts.width}x{facts.height}"]
        if facts.kind not in WITHOUT_CAMERA and not facts.stamp_accuracy.is_exact:
            third.append(f"stamps {describe_stamp(facts.stamp_accuracy)}")
        shown = {state.control: f"{state.control} {describe(state)}" for state in detail.controls}
        if Control.EXPOSURE not in shown and node.exposure_ns:
            third.append(f"exposure {duration(node.exposure_ns)}")
        if Control.GAIN not in shown and node.gain is not None:
            third.append(f"gain {node.gain:.1f}")
        third += map(printable, shown.values())
        if node.disk_free_bytes is not None:
            third.append(f"{node.disk_free_bytes / 1e9:.0f} GB free")
        if detail.spool:
            third.append(f"unsent images in {printable(detail.spool)}")
        lines = [
            Content("   ").join(fitting(map(Content, facts), "   ", self._facts.size.width))
            for facts in (second, third)
        ]
        self._facts.show([Content.assemble(*first), lines[0], lines[1].stylize("$foreground-muted")])
