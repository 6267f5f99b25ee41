"""Keeps a camera's stream on the rig's grid: its aligner, commands to the camera, events of both."""

import random
from collections import deque
from dataclasses import dataclass

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.stamps import PhaseEstimate
from capture_app.sync.rig.events import AlignmentFailed, PhaseCorrected
from capture_app.sync.rig.frame_selection import RING_BYTES, RING_NS, CameraGrid
from capture_app.sync.wire.camera_commands import CameraCommand
from capture_app.sync.wire.messages import Report


@dataclass(frozen=True, slots=True)
class ClientConfig:
    """What a client is; times in ns."""

    name: str
    instance: int
    camera: CameraFacts
    tolerance_ns: int
    ring_ns: int = RING_NS
    """How far back its frames are kept, to be picked for a burst in the past."""
    ring_bytes: int = RING_BYTES
    """The most memory that they may take."""
    injection_profile: InjectionProfile | None = None
    """What is known from before about what a long frame does to this camera."""
    start_latencies_ns: tuple[int, ...] = ()
    """How long starts of such a camera took before, from the command to the first frame, newest last."""


class PhaseLoop:
    """One camera's aligner with its commands; `now_ns` is the node's own clock."""

    def __init__(self, config: ClientConfig, rng: random.Random) -> None:
        camera = config.camera
        self.aligner = Aligner(
            camera, tolerance_ns=config.tolerance_ns, rng=rng, profile=config.injection_profile
        )
        for latency_ns in config.start_latencies_ns:
            self.aligner.learn_start_latency(latency_ns)
        self.can_move = camera.phase_control != PhaseControl.NONE
        self._restarts = camera.phase_control == PhaseControl.RESET
        self._reported_problem = ""
        self._reported = False
        """Whether the leader was told the phase as it is now."""
        self._answered = False
        """Whether it has answered since."""
        self.commands: deque[CameraCommand] = deque()
        """For the camera."""
        self.events: deque[PhaseCorrected | AlignmentFailed] = deque()

    @property
    def ready(self) -> bool:
        """Whether the stream is aligned as nearly as it can be, or will be by the time of a burst."""
        aligner = self.aligner
        return aligner.window.within_window or aligner.meets_bursts or (aligner.settled and not self.can_move)

    @property
    def fleetingness(self) -> str:
        """For how long the stream stays aligned where that is short, in plain words; empty if it is held."""
        return self.aligner.window.fleetingness if self.can_move else ""

    def waits_for_others(self, grid: CameraGrid) -> bool:
        """Whether this client may not move its stream yet: a restart waits for a time that suits all."""
        return self._restarts and not (self._answered and grid.meeting_leader_ns is not None)

    def phase(self, grid: CameraGrid, time_map: TimeMap, local_ns: int) -> PhaseEstimate | None:
        """The stream's phase error and drift at a local time in ns; None while they are not known."""
        at_leader_ns = time_map.leader_from_local(local_ns)
        return self.aligner.estimate(time_map, grid.grid_of_stamps, at_leader_ns)

    def report(self, report: Report, grid: CameraGrid | None, phase: PhaseEstimate | None) -> Report:
        """Add the camera's part to a report of a node's time; `phase` is the present one."""
        report = replace(
            report,
            corrections=self.aligner.corrections,
            frames=self.aligner.phase.frames,
            drops=self.aligner.phase.drops,
            tolerance_ns=self.aligner.window.tolerance_ns,
            stamp_quantum_ns=round(self.aligner.phase.quantum_ns),
        )
        if phase is None or grid is None:
            return report
        frame_leader_ns = grid.rig_grid.instant(grid.rig_grid.index_of(phase.at_leader_ns)) + phase.error_ns
        return replace(
            report,
            phase_error_ns=phase.error_ns,
            period_ns=phase.period_ns,
            drift_ppm=phase.drift_ppm,
            frame_leader_ns=frame_leader_ns if self.aligner.settled else None,
        )

    def note_join(self) -> None:
        """Note that another leader is followed, which does not know the phase yet."""
        self._reported = self._answered = False

    def note_report(self) -> None:
        """Note that the leader is told the phase as it is now."""
        self._reported = self.aligner.settled

    def note_answer(self) -> bool:
        """Note an answer of the leader; whether it is the first since the phase as it is was reported."""
        first = self._reported and not self._answered
        self._answered = self._answered or first
        return first

    def step(
        self, grid: CameraGrid, time_map: TimeMap, now_ns: int, *, burst_leader_ns: tuple[int, int] | None
    ) -> bool:
        """Command the camera what its stream needs; whether to report to the leader at once.

        `burst_leader_ns` are the first and last instant of a burst that is near, None where none is.
        """
        was_ready, aligner = self.ready, self.aligner
        before, corrections = self.phase(grid, time_map, now_ns), aligner.corrections
        aligner.settle_command(now_ns)
        if not aligner.settled:
            self._reported = self._answered = False
        news = aligner.settled and not self._reported
        command = aligner.next_command(
            time_map,
            grid.grid_of_stamps,
            now_ns,
            hold=self.waits_for_others(grid),
            burst_leader_ns=burst_leader_ns,
            meeting_leader_ns=grid.meeting_leader_ns,
        )
        if command is not None:
            self.commands.append(command)
        if aligner.corrections > corrections and command is not None:
            self.events.append(PhaseCorrected(command, before))
            news = True
        if aligner.problem != self._reported_problem:
            self._reported_problem = aligner.problem
            if aligner.problem:
                self.events.append(AlignmentFailed(aligner.problem))
        return news or was_ready is not self.ready
