"""Director's monitor: the feed of a rig, and the server of the page that shows it to each monitor.

The feed keeps only the newest of each message and picture, so a monitor on a slow link skips some.
"""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Sequence
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal

import msgspec
from aiohttp import WSMsgType, web
from msgspec import Struct

from capture_app.common import system
from capture_app.common.child import LOWEST_PRIORITY, ask_reconstruct
from capture_app.common.errors import IncompleteError, SimulshotError, UnknownMachineError
from capture_app.common.names import natural_order
from capture_app.common.tasks import Background, end
from capture_app.common.text import UNREADABLE
from capture_app.common.walk import SKELETONS, WALK
from capture_app.companions.monitor.people_feed import PeopleFeed
from capture_app.protocol.orders import EndBurst
from capture_app.protocol.status import BurstStatus, Preview, RigStatus
from capture_app.rig.instant_previews import APART_S, Gathering, LeaderMoments, old_from_s
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.rig.rig_time import PlacedMark
from capture_app.rig.taking import Begun, Countdown, Failed, Moved, TakeEvent, TakePlan, Taking, Waiting
from capture_app.session.library.changes import results_folder
from capture_app.session.reading.decoding import encode_image
from capture_app.session.reading.take_sheet import (
    TakeSheet,
    contact_sheet,
    depth_picture,
    encode_animation,
    wiggle_frames,
)
from capture_app.web.admission import Admission
from capture_app.web.paired_page import ListeningPage, PageLink, PairedPage

WIDTH_PX, FPS = 384, 5.0
"""Width and maximum rate of the live pictures of all cameras."""
CLOSE_WIDTH_PX = 1280
"""Width of a camera's that is looked at closely."""
LIVE = "live"
"""Type of the message that ends pictures which are shown together."""
PEOPLE = "people"
"""Type of the message with the people in 3D."""
SHEET_WIDTH_PX, SHEET_ROWS = 240, 6
WIGGLE_WIDTH_PX, WIGGLE_STEP_MS = 480, 125
DEPTH_RUNS = ("moment", "multiview")
"""Results of a session with depth, the quickest first."""


class LivePicture(Struct, frozen=True):
    """A camera's preview, and the moment that it shows by this machine's monotonic clock, in ns."""

    jpeg: bytes
    moment_ns: int


class MonitorFeed:
    """Newest messages and pictures of one rig, and the take that a monitor has ordered."""

    def __init__(self, link: RigLink, *, is_local: bool) -> None:
        """Create a feed; `is_local`: the rig saves its sessions on this machine."""
        self.texts: dict[str, str] = {}
        """Newest message of each type, as JSON."""
        self.pictures: dict[str, bytes] = {}
        """Images of the last take, `take/NAME/KIND`, once a monitor has asked for them."""
        self.live: dict[str, LivePicture] = {}
        """Newest picture of each camera; pictures of one instant are replaced together."""
        self.people = PeopleFeed(link, partial(self._say, PEOPLE))
        self._gathering = Gathering()
        self._moments = LeaderMoments()
        self._link, self._is_local = link, is_local
        self._readers: set[asyncio.Event] = set()
        self._background = Background()
        self._rig: RigStatus | None = None
        self._taking: Taking | None = None
        self._ended = ""
        """Name of the last recording that a monitor has ended; its frames may arrive for minutes."""
        self._course = ""
        """State of the take ordered here that has not begun: ordered, countdown, waiting, idle or failed."""
        self._sheet: TakeSheet | None = None
        self._session = ""
        """Path of the last session."""
        self._making: set[str] = set()
        self._is_computing = False
        self._say_course("idle")

    async def run(self) -> None:
        """Follow the rig and update messages and pictures, until cancelled."""
        self._background.start(self.people.run())
        try:
            async for update in self._link.updates():
                match update:
                    case Preview():
                        self._show_live(self._gathering.add(update)[0])
                    case LinkLost():
                        self._moments = LeaderMoments()
                        self.people.follow(None)
                        self._say("lost", reason=update.reason)
                    case RigStatus():
                        self._moments.hear(update.now_ns, system.monotonic_ns())
                        self._say("lost", reason="")
                        self._show_status(update)
        finally:
            await self._background.end()

    @contextlib.asynccontextmanager
    async def reader(self) -> AsyncIterator[asyncio.Event]:
        """Return an event that is set by each change; live pictures are requested while anyone reads."""
        changed = asyncio.Event()
        changed.set()
        self._readers.add(changed)
        try:
            await self._want_previews()
            yield changed
        finally:
            self._readers.discard(changed)
            await self._want_previews()

    async def look_closely(self, camera: str) -> None:
        """Request larger pictures of a camera, until cancelled; they come with the others' pictures."""
        link = self._link.another()
        await link.want_previews(cameras=(camera,), width=CLOSE_WIDTH_PX, fps=FPS)
        async with contextlib.aclosing(link.updates()) as updates:
            async for _ in updates:
                pass

    def take(self, plan: TakePlan) -> None:
        """Take pictures; if an earlier order waits until cameras are ready, take at once."""
        if self._taking is not None and self._taking.is_waiting:
            self._taking.take_now()
        elif self._course in ("idle", "failed"):
            self._taking = Taking(self._link, plan.when_ready(self._rig))
            self._say_course("ordered")
            self._background.start(self._follow(self._taking))

    async def stop(self) -> None:
        """Stop the take that has not begun, else end the recording. Raises SimulshotError."""
        burst = None if self._rig is None else self._rig.burst
        if self._taking is not None and self._taking.is_open:
            self._taking.stop()
            self._say_course("idle")
        elif burst is not None and self._is_recording(burst):
            await self._link.order(EndBurst(burst=burst.burst))
            self._ended = burst.name

    def _is_recording(self, burst: BurstStatus) -> bool:
        """Return whether a burst is a recording whose end is neither ordered nor reported."""
        return burst.recording and not (burst.done or burst.ended) and burst.name != self._ended

    async def mark(self, text: str) -> PlacedMark:
        """Note an event now, in the take under way. Raises SimulshotError."""
        return await self._link.mark(text)

    def request_picture(self, key: str) -> None:
        """Make a picture of the last take, unless it is there or being made."""
        if key not in self.pictures and key not in self._making:
            self._background.start(self._make_picture(key))

    async def _want_previews(self) -> None:
        await self._link.want_previews(cameras=None, width=WIDTH_PX, fps=FPS if self._readers else 0)

    async def _follow(self, taking: Taking) -> None:
        """Show the course of a take until it is saved."""
        try:
            async for event in taking:
                if taking is self._taking:
                    self._show_event(event, taking)
        finally:
            if taking is self._taking and self._course != "failed":
                self._say_course("idle")

    def _show_event(self, event: TakeEvent, taking: Taking) -> None:
        match event:
            case Countdown(seconds=seconds):
                self._say_course("countdown", seconds=seconds)
            case Waiting(reason=reason):
                self._say_course("waiting", words=reason, can_hurry=taking.is_waiting)
            case Moved(camera=camera):
                title = self._rig.titles.get(camera, camera) if self._rig else camera
                self._say_course("ordered", words=f"something moves in front of {title}")
            case Begun():
                self._say_course("waiting" if taking.is_open else "idle")
            case Failed(error=error):
                self._say_course("failed", words=str(error))

    def _show_status(self, rig: RigStatus) -> None:
        self._rig = rig
        self.people.follow(rig)
        cameras, titles = {node.name: node for node in rig.cameras}, rig.titles
        self._say(
            "rig",
            leader=rig.leader,
            advice=rig.advice,
            old_s=old_from_s(rig),
            apart_s=APART_S,
            cameras=[
                {
                    "name": name,
                    "title": titles[name],
                    "state": cameras[name].state,
                    "message": cameras[name].message,
                }
                for name in sorted(cameras, key=natural_order)
            ],
        )
        self.live = {name: shown for name, shown in self.live.items() if name in cameras}
        if (burst := rig.burst) is not None:
            self._say(
                "burst",
                name=burst.name,
                received=burst.received,
                expected=burst.expected,
                is_recording=self._is_recording(burst),
                seconds=round(burst.instants * (rig.period_ns or 0) / 1e9),
                is_done=burst.done,
            )
        if rig.sessions and rig.sessions[-1] != self._session:
            self._session = rig.sessions[-1]
            self._background.start(self._open_session(Path(rig.sessions_folder, Path(self._session).name)))

    async def _open_session(self, folder: Path) -> None:
        grade, words = "unknown", "Its pictures are on the leader's machine."
        self._sheet = None
        if self._is_local:
            try:
                self._sheet = await asyncio.to_thread(TakeSheet.open, folder)
                grade, words = self._sheet.verdict.grade, self._sheet.verdict.headline
            except SimulshotError as error:
                words = str(error)
        self.pictures.clear()
        self._say("take", name=folder.name, grade=grade, words=words, has_pictures=self._sheet is not None)

    async def _make_picture(self, key: str) -> None:
        sheet, kind = self._sheet, key.rpartition("/")[2]
        if sheet is None or key != f"take/{sheet.session.manifest.name}/{kind}" or kind not in _PICTURES:
            return
        self._making.add(key)
        try:
            self._show(key, await asyncio.to_thread(_PICTURES[kind], sheet))
        except (*UNREADABLE, SimulshotError, OSError, LookupError, TypeError) as error:
            is_uncomputed = isinstance(error, IncompleteError) and kind == "depth"
            self._say("absent", picture=key, words=str(error), can_compute=is_uncomputed)
        finally:
            self._making.discard(key)

    def compute_depth(self) -> None:
        """Compute the depth of the last take's middle instant, unless it is being computed."""
        if self._sheet is not None and not self._is_computing:
            self._background.start(self._compute_depth(self._sheet))

    async def _compute_depth(self, sheet: TakeSheet) -> None:
        session, self._is_computing = sheet.session.folder, True
        key = f"take/{sheet.session.manifest.name}/depth"
        self._say("absent", picture=key, words="Computing the depth …", can_compute=False)
        asked = ("multiview", str(session), "--out", str(results_folder(session) / DEPTH_RUNS[0]))
        how = ("--instant", str(sheet.instants // 2), "--quick", "--page", "--calibrated")
        try:
            await ask_reconstruct((*asked, *how), dict[str, Any], niceness=LOWEST_PRIORITY)
            await self._make_picture(key)
        except SimulshotError as error:
            self._say("absent", picture=key, words=str(error), can_compute=False)
        finally:
            self._is_computing = False

    def _say_course(self, state: str, **fields: object) -> None:
        self._course = state
        self._say("course", state=state, **fields)

    def _say(self, kind: str, **fields: object) -> None:
        text = msgspec.json.encode({"type": kind, **fields}).decode()
        if self.texts.get(kind) != text:
            self.texts[kind] = text
            self._notify()

    def _show_live(self, previews: Sequence[Preview]) -> None:
        now_ns = system.monotonic_ns()
        for each in previews:
            self.live[each.camera] = LivePicture(each.jpeg, self._moments.here_ns(each.leader_ns, now_ns))
        if previews:
            self._notify()

    def _show(self, key: str, picture: bytes) -> None:
        self.pictures[key] = picture
        self._notify()

    def _notify(self) -> None:
        for changed in self._readers:
            changed.set()


def _contact_sheet(sheet: TakeSheet) -> bytes:
    instants = range(0, sheet.instants, max(1, math.ceil(sheet.instants / SHEET_ROWS)))
    return encode_image(contact_sheet(sheet, SHEET_WIDTH_PX, instants=instants))


def _wiggle(sheet: TakeSheet) -> bytes:
    return encode_animation(
        wiggle_frames(sheet, sheet.instants // 2, WIGGLE_WIDTH_PX), ".webp", WIGGLE_STEP_MS, WIGGLE_STEP_MS
    )


def _depth(sheet: TakeSheet) -> bytes:
    results = results_folder(sheet.session.folder)
    for run in DEPTH_RUNS:
        if (result := results / run / "multiview.json").is_file():
            return depth_picture(result)
    raise IncompleteError("No depth of this take has been computed")


_PICTURES = {"sheet": _contact_sheet, "wiggle": _wiggle, "depth": _depth}


class MarkPost(Struct, frozen=True):
    """Body of `POST /mark`: the secret of a code, the program's own key, and the mark's text.

    A secret admits one key, which needs none from then on.
    """

    key: str
    text: str
    secret: str = ""


class PageOrder(Struct, frozen=True):
    """Order of a monitor's page.

    seen    acknowledges a picture, `live` pictures together or `people`: the next ones may be sent
    look    requests larger pictures of one camera; an empty name ends them
    open    shows a picture of the last take, by its key; empty: none
    take    takes pictures by a plan
    stop    stops the take that has not begun, or the recording
    depth   computes the depth of the last take
    people  shows people in 3D, or ends that
    """

    type: Literal["seen", "look", "open", "take", "stop", "depth", "people"]
    picture: str = ""
    camera: str = ""
    plan: TakePlan = TakePlan()
    is_shown: bool = False


_DECODER = msgspec.json.Decoder(PageOrder)


class MonitorPage(PairedPage):
    """Serves the page; any number of monitors share one feed."""

    def __init__(self, admission: Admission, feed: MonitorFeed) -> None:
        super().__init__(admission, Path(__file__).parent / "page", shared=(WALK, SKELETONS))
        self._feed = feed

    def add_routes(self, app: web.Application) -> None:
        """Add `POST /mark`, for devices without a page."""
        app.router.add_post("/mark", self._mark)

    async def _mark(self, request: web.Request) -> web.Response:
        """Note an event for a program that was admitted, as pages are, by a code's secret and its own key."""
        try:
            asked = msgspec.json.decode(await request.read(), type=MarkPost)
            self.admission.admit(asked.secret, asked.key, "program")
            placed = await self._feed.mark(asked.text)
        except UNREADABLE:
            words = "Send JSON with secret, key (32 hexadecimal digits) and text."
            return web.json_response({"words": words}, status=HTTPStatus.BAD_REQUEST)
        except UnknownMachineError as error:
            return web.json_response({"words": str(error)}, status=HTTPStatus.FORBIDDEN)
        except SimulshotError as error:
            return web.json_response({"words": str(error)}, status=HTTPStatus.BAD_REQUEST)
        return web.json_response(msgspec.to_builtins(placed))

    async def serve_link(self, link: PageLink) -> None:
        """Send the feed to a monitor and obey its orders until its page closes the link."""
        async with self._feed.reader() as changed:
            monitor = _Monitor(link, self._feed, changed)
            sending = asyncio.create_task(monitor.send())
            try:
                async for message in link.socket:
                    if message.type is not WSMsgType.TEXT:
                        raise ValueError("a monitor sends text only")
                    try:
                        await monitor.obey(_DECODER.decode(message.data))
                    except SimulshotError as error:
                        await link.send(
                            msgspec.json.encode({"type": "refused", "words": str(error)}).decode()
                        )
            finally:
                self._feed.people.show_to(monitor, is_shown=False)
                await end(sending, *monitor.looking)


class _Monitor:
    """One open monitor page: what was sent to it, and the pictures that it has not acknowledged."""

    def __init__(self, link: PageLink, feed: MonitorFeed, changed: asyncio.Event) -> None:
        self._link, self._feed, self._changed = link, feed, changed
        self._sent: dict[str, str | bytes] = {}
        """Newest message of each type, and newest picture by key, that the page has got."""
        self._unacknowledged = {PEOPLE}
        """What must not be sent again yet; people are sent to pages that show them alone."""
        self._open = ""
        self.looking: set[asyncio.Task[None]] = set()
        """Task that requests larger pictures of one camera, if any."""

    async def send(self) -> None:
        """Send what changes, forever: of each camera the newest picture, once the last was acknowledged."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            for kind, text in tuple(self._feed.texts.items()):
                if self._sent.get(kind) != text and kind not in self._unacknowledged:
                    self._sent[kind] = text
                    if kind == PEOPLE:
                        self._unacknowledged.add(kind)
                    await self._link.send(text)
            await self._send_live()
            taken = self._feed.pictures.get(self._open)
            is_seen = self._open not in self._unacknowledged
            if taken is not None and taken is not self._sent.get(self._open) and is_seen:
                self._unacknowledged.add(self._open)
                await self._send_picture(self._open, taken)

    async def _send_live(self) -> None:
        """Send the cameras' newest pictures, which the page shows together, once it has shown the last."""
        new = {
            name: shown
            for name, shown in self._feed.live.items()
            if shown.jpeg is not self._sent.get(f"live/{name}")
        }
        if not new or LIVE in self._unacknowledged:
            return
        self._unacknowledged.add(LIVE)
        for name, shown in new.items():
            await self._send_picture(f"live/{name}", shown.jpeg)
        now_ns = system.monotonic_ns()
        ages_s = {name: round((now_ns - shown.moment_ns) * 1e-9, 3) for name, shown in new.items()}
        await self._link.send(msgspec.json.encode({"type": LIVE, "ages_s": ages_s}).decode())

    async def _send_picture(self, key: str, picture: bytes) -> None:
        self._sent[key] = picture
        name = key.encode()
        await self._link.send(bytes([len(name)]) + name + picture)

    async def obey(self, order: PageOrder) -> None:
        """Carry out an order of the monitor's page. Raises SimulshotError."""
        match order.type:
            case "seen":
                self._unacknowledged.discard(order.picture)
                self._changed.set()
            case "look":
                await end(*self.looking)
                self.looking.clear()
                if order.camera:
                    self.looking.add(asyncio.create_task(self._feed.look_closely(order.camera)))
            case "open":
                self._open = order.picture
                self._sent.pop(order.picture, None)
                self._feed.request_picture(order.picture)
                self._changed.set()
            case "take":
                self._feed.take(order.plan)
            case "stop":
                await self._feed.stop()
            case "depth":
                self._feed.compute_depth()
            case "people":
                self._sent.pop(PEOPLE, None)
                (self._unacknowledged.discard if order.is_shown else self._unacknowledged.add)(PEOPLE)
                self._feed.people.show_to(self, is_shown=order.is_shown)
                self._changed.set()


@contextlib.asynccontextmanager
async def serving_monitor(link: RigLink, page: ListeningPage, *, is_local: bool) -> AsyncIterator[None]:
    """Serve the monitors of a rig while the block runs; `is_local`: it saves sessions on this machine."""
    feed = MonitorFeed(link, is_local=is_local)
    following = asyncio.create_task(feed.run())
    try:
        async with MonitorPage(page.admission, feed).serving(page.socket, page.tls, page.names):
            yield
    finally:
        await end(following)
