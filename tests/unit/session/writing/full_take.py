"""A session with everything in it: pictures, truth, events, a plan and a calibration."""

import asyncio
from pathlib import Path

from capture_app.common.address import Address
from capture_app.common.errors import DiskFullError
from capture_app.machine.repair import repair
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.manifest import BurstRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import calibration_of, camera_record, jpeg

PERIOD_NS = 33_000_000


class Take:
    """Two cameras, three instants, each with a picture, truth, events, a plan and a calibration."""

    names = ("cam0", "cam1")
    instants = 3

    def __init__(self, root: Path) -> None:
        self.folder = root / "take"
        self.places = [(name, instant) for instant in range(self.instants) for name in self.names]
        self.confirmed: dict[tuple[str, int], bytes] = {}

    def begin(self) -> SessionWriter:
        writer = SessionWriter.create(self.folder.parent, self.folder.name)
        plan = BurstPlan(
            name="take",
            created=writer.created,
            software=writer.software,
            leader=1,
            number=1,
            burst=self.burst,
            cameras=tuple(CameraPlan(camera=camera_record(name)) for name in self.names),
        )
        try:
            writer.set_plan(plan)
        except DiskFullError:
            writer.discard()
            raise
        return writer

    @property
    def burst(self) -> BurstRecord:
        return BurstRecord(
            instants_ns=tuple(PERIOD_NS * n for n in range(self.instants)), period_ns=PERIOD_NS
        )

    def add(self, writer: SessionWriter, name: str, instant: int) -> None:
        data = jpeg(instant)
        at_ns, truth = PERIOD_NS * instant, b"truth" * 99
        writer.add_image(
            data, camera=name, instant=instant, leader_ns=at_ns, gain=0.1, truth=truth, true_ns=at_ns
        )
        self.confirmed[name, instant] = data

    def end(self, writer: SessionWriter, *missing: MissingImage) -> Session:
        writer.set_calibration(calibration_of("cam0"))
        writer.add_event({"event": "joined"}, {"event": "clock-synced", "offset_ns": 12})
        cameras = [camera_record(name) for name in self.names]
        return writer.finish(cameras, self.burst, missing, origin="simulated", note="a note")

    def write(self) -> Session:
        writer = self.begin()
        for name, instant in self.places:
            self.add(writer, name, instant)
        return self.end(writer)

    def check_repaired(self) -> Session:
        """Repair, and see that all that was confirmed is there as it was, and that nothing lies."""
        results = asyncio.run(repair(self.folder, wait_s=0, address=Address("127.0.0.1", 0), log=Log()))
        assert results[0].ok, results
        session = Session.open(self.folder)
        assert verify(session) == []
        images = {(image.camera, image.instant): image for image in session.manifest.images}
        for of, data in self.confirmed.items():
            assert session.image_file(images[of]).read_bytes() == data
        return session
