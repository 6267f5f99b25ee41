"""What a seed draws: the rig, what is asked of it, and what befalls it."""

import random
from dataclasses import dataclass, replace
from typing import Any

SETTLE_S = 20.0
"""Time that a rig has to become ready before anything befalls it."""


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that happens: a fault, which is over after `seconds`, or an order of an operator."""

    at_s: float
    kind: str
    target: str = ""
    value: float = 0.0
    seconds: float = 0.0

    def __str__(self) -> str:
        lasting = f" for {self.seconds:.1f} s" if self.seconds else ""
        value = f" {self.value:g}" if self.value else ""
        return f"{self.at_s:.1f} s: {self.kind} {self.target}{value}{lasting}"


@dataclass(frozen=True, slots=True)
class Plan:
    """A rig and its evening."""

    seed: int
    cameras: tuple[str, ...]
    behind_relay: tuple[str, ...]
    """Cameras that join a relay."""
    has_standby: bool
    liars: dict[str, str]
    """How a camera lies, by name."""
    drops: float
    """Fraction of frames that cameras drop."""
    image_bytes: int
    wifi: bool
    """Whether links are as slow and lossy as WiFi."""
    steps: tuple[Step, ...]
    seconds: float
    """Virtual time until everything heals."""
    lopsided: dict[str, float]
    """Cameras whose messages take longer in one direction, by so many ms: to the camera, or from it if
    negative."""
    phones: tuple[str, ...]
    """Cameras with a phone's link, which sleeps: what is sent to them waits for the next beacon."""
    stagger: str
    """Planned order of the cameras' frames, as the option --stagger; empty for none."""
    has_sound: bool
    """Whether the first camera has a microphone."""

    def __str__(self) -> str:
        parts = [f"{len(self.cameras)} cameras"]
        parts += [f"{', '.join(self.behind_relay)} behind a relay"] if self.behind_relay else []
        parts += ["a standby"] if self.has_standby else []
        parts += [f"{name} lies ({how})" for name, how in self.liars.items()]
        parts += [f"{name} is {ms:+.0f} ms lopsided" for name, ms in self.lopsided.items()]
        parts += [f"{', '.join(self.phones)} with a phone's link"] if self.phones else []
        parts += [f"staggered: {self.stagger}"] if self.stagger else []
        parts += [f"{self.cameras[0]} with a microphone"] if self.has_sound else []
        return "; ".join(parts) + "".join(f"\n  {n:3} {step}" for n, step in enumerate(self.steps))

    def only(self, numbers: list[int] | None, seconds: float | None = None) -> "Plan":
        """Return the plan with these of its steps, and until that time."""
        kept = self.steps if numbers is None else tuple(self.steps[n] for n in numbers)
        return replace(self, steps=kept, seconds=self.seconds if seconds is None else seconds)


TWICE = "twice"
"""A lie: each batch has its last image twice."""
LIES = ("nothing", "partial", "silent", "huge", "cut-image", "wrong-size")
_FAULTS: dict[str, tuple[float, tuple[float, float], tuple[float, float]]] = {
    # kind: weight, range of the value, range of the seconds
    "kill": (3, (0, 0), (0.2, 12)),
    "power": (2, (0, 0), (0.5, 12)),
    "kill-at-disk-step": (2, (1, 40), (0.5, 5)),
    "stop": (1, (0, 0), (0.5, 8)),
    "freeze": (2, (0, 0), (0.3, 12)),
    "cut": (3, (0, 0), (0.5, 20)),
    "loss": (2, (0.05, 0.4), (2, 30)),
    "slow-link": (2, (2e3, 2e5), (2, 30)),
    "late-link": (1, (2, 60), (2, 20)),
    "disk-full": (1, (0, 0), (1, 20)),
    "disk-failing": (1, (0, 0), (0.5, 8)),
    "disk-slow": (2, (0.05, 1.0), (2, 20)),
    "camera-stall": (1, (0, 0), (0.2, 6)),
    "camera-lost": (1, (0, 0), (1, 8)),
    "clock-slew": (1, (-500, 500), (2, 20)),
}
_OF_CAMERAS = ("camera-stall", "camera-lost")
_OF_NOBODY_ELSE = ("disk-full", "disk-failing", "disk-slow", "kill-at-disk-step")


def draw(seed: int) -> Plan:
    """Draw a plan."""
    rng = random.Random(f"plan {seed}")
    cameras = tuple(f"cam{number}" for number in range(rng.choice((2, 2, 3))))
    behind = tuple(name for name in cameras if rng.random() < 0.6) if rng.random() < 0.2 else ()
    has_standby = rng.random() < 0.2
    liars = {cameras[-1]: rng.choice(LIES)} if rng.random() < 0.25 else {}
    if not liars and random.Random(f"twice {seed}").random() < 0.08:
        liars = {cameras[-1]: TWICE}
    seconds = rng.uniform(50, 90)
    machines = ["lead", *cameras, *(["relay"] if behind else []), *(["lead2"] if has_standby else [])]
    steps = [_fault(rng, rng.uniform(SETTLE_S, seconds), machines, cameras) for _ in range(rng.randint(2, 7))]
    steps += [_order(rng, rng.uniform(SETTLE_S - 5, seconds)) for _ in range(rng.randint(3, 7))]
    if has_standby:
        # A leader that comes back while its standby leads takes over again; both are tried.
        steps.append(Step(rng.uniform(SETTLE_S, seconds), "kill", "lead", 0.0, rng.uniform(2, 20)))
    # From a generator of its own, so that a seed keeps what it drew above.
    further = random.Random(f"further {seed}")
    honest = tuple(name for name in cameras if name not in liars)
    steps += _marks(further, steps)
    for follow, chance in ((_dark, 0.25), (_absent, 0.25), (_alone, 0.1)):
        if further.random() < chance:
            steps += follow(further, further.uniform(SETTLE_S, seconds - 10), honest)
    latest = random.Random(f"crash {seed}")
    if latest.random() < 0.15:
        steps += _crash(latest, latest.uniform(SETTLE_S, seconds - 10))
    beheaded = random.Random(f"beheaded {seed}")
    if not has_standby and beheaded.random() < 0.15:
        steps += _beheaded(beheaded, beheaded.uniform(SETTLE_S, seconds - 10), cameras)
    away = random.Random(f"away {seed}")
    if not has_standby and away.random() < 0.2:
        steps += _all_away(away, away.uniform(SETTLE_S, seconds - 10), cameras)
    asleep = random.Random(f"sleeping laptop {seed}")
    if asleep.random() > 0.92:
        steps += _asleep(asleep, asleep.uniform(SETTLE_S, seconds - 10), honest)
    at_end = random.Random(f"away at its end {seed}")
    if not has_standby and at_end.random() < 0.06:
        steps += _away_at_end(at_end, at_end.uniform(SETTLE_S, seconds - 10), cameras)
    lopsided = {further.choice(honest): _lopsided_ms(further)} if further.random() < 0.15 else {}
    return Plan(
        seed,
        cameras,
        behind,
        has_standby,
        liars,
        drops=rng.choice((0.0, 0.01, 0.05)),
        image_bytes=rng.choice((2_000, 10_000, 60_000)),
        wifi=rng.random() < 0.5,
        steps=tuple(sorted(steps, key=lambda step: step.at_s)),
        seconds=seconds,
        lopsided=lopsided,
        phones=tuple(name for name in cameras if further.random() < 0.1),
        stagger=further.choice(("even", "cam0=0ms,cam1=60ms")) if further.random() < 0.12 else "",
        has_sound=further.random() < 0.1,
    )


def _lopsided_ms(rng: random.Random) -> float:
    return rng.choice((-1, 1)) * rng.uniform(4, 25)


def _marks(rng: random.Random, steps: list[Step]) -> list[Step]:
    """Return marks that an operator places during takes and beside them."""
    orders = [step for step in steps if step.kind in ("burst", "recording", "long") and rng.random() < 0.4]
    return [Step(step.at_s + rng.uniform(0, 2), "mark", "desk") for step in orders]


def _dark(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a take after which a camera is cut off, and loses its power before it is connected again."""
    camera = rng.choice(cameras)
    cut_s = at_s + rng.uniform(0.4, 1.5)
    power_s = cut_s + rng.uniform(2, 8)
    return [
        Step(at_s, "burst", "desk", float(rng.randint(2, 8))),
        Step(cut_s, "cut", camera, 0.0, power_s - cut_s + rng.uniform(0, 4)),
        Step(power_s, "power", camera, 0.0, rng.uniform(0.5, 4)),
    ]


def _absent(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a take while a camera is lost."""
    kind = rng.choice(("kill", "power", "cut", "freeze"))
    seconds = rng.uniform(6, 12)
    return [
        Step(at_s, kind, rng.choice(cameras), 0.0, seconds),
        Step(at_s + rng.uniform(3, seconds - 1), "burst", "desk", float(rng.randint(1, 6))),
    ]


def _crash(rng: random.Random, at_s: float) -> list[Step]:
    """Return a take whose leader loses its power while its slow disk still writes the images."""
    return [
        Step(at_s, "disk-slow", "lead", rng.uniform(0.1, 0.6), 8.0),
        Step(at_s + 0.5, "burst", "desk", float(rng.randint(3, 8))),
        Step(at_s + rng.uniform(2, 6), "power", "lead", 0.0, rng.uniform(0.5, 5)),
    ]


def _alone(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a recording during which all cameras are cut off from their leader, as by an access point."""
    seconds = rng.uniform(15, 30)
    cut_s, lasts_s = at_s + rng.uniform(1, 8), rng.uniform(4, 20)
    return [
        Step(at_s, "recording", "desk", 0.0, seconds),
        *(Step(cut_s, "cut", camera, 0.0, lasts_s) for camera in cameras),
    ]


def _beheaded(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a recording of an ordered length whose leader is lost while its cameras are cut off from it."""
    cut_s, lasts_s = at_s + rng.uniform(2, 8), rng.uniform(8, 25)
    kind, after_s = rng.choice(("kill", "power")), rng.uniform(0.2, lasts_s)
    return [
        Step(at_s, "recording", "desk", rng.uniform(20, 40)),
        *(Step(cut_s, "cut", camera, 0.0, lasts_s) for camera in cameras),
        Step(cut_s + after_s, kind, "lead", 0.0, rng.uniform(0.5, 15)),
    ]


def _all_away(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a recording whose cameras are all started again at once, as those of one machine or one hub.

    Their leader may be on that machine, too. Most have an ordered length; others are ended by the operator.
    """
    ends_s = rng.uniform(25, 45)
    ordered_s, ended_s = (ends_s, 0.0) if rng.random() < 0.75 else (0.0, ends_s)
    away_s, lasts_s = at_s + rng.uniform(2, 10), rng.uniform(0.5, 8)
    kind, has_leader = rng.choice(("kill", "kill", "power", "stop")), bool(ordered_s) and rng.random() < 0.3
    # One may still have frames of before when it is asked for the rest.
    slow = [Step(max(0.0, away_s - 3), "slow-link", rng.choice(cameras), rng.uniform(2e3, 1e4), lasts_s + 25)]
    return [
        Step(at_s, "recording", "desk", ordered_s, ended_s),
        *(slow if rng.random() < 0.3 else []),
        *(Step(away_s, kind, name, 0.0, lasts_s) for name in (*cameras, *(["lead"] if has_leader else []))),
    ]


def _asleep(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a take within which a camera's machine sleeps, as a laptop whose lid is closed."""
    take = (
        Step(at_s, "recording", "desk", rng.uniform(8, 20))
        if rng.random() < 0.7
        else Step(at_s, "burst", "desk", 8.0)
    )
    machine, error_s = rng.choice((*cameras, "lead")), rng.uniform(-1, 1)
    # What a leader's clock is off is found after a take that ends meanwhile (docs/accuracy.md).
    error_s = 0.0 if machine == "lead" else error_s
    return [take, Step(at_s + rng.uniform(0.2, 5), "sleep", machine, error_s, rng.uniform(1, 15))]


def _away_at_end(rng: random.Random, at_s: float, cameras: tuple[str, ...]) -> list[Step]:
    """Return a recording of an ordered length that all cameras leave before its end, and rejoin after it."""
    ends_s = rng.uniform(8, 20)
    away_s, kind = at_s + ends_s - rng.uniform(1, 4), rng.choice(("kill", "power", "stop"))
    return [
        Step(at_s, "recording", "desk", ends_s),
        *(Step(away_s, kind, name, 0.0, rng.uniform(6, 12)) for name in cameras),
    ]


def _fault(rng: random.Random, at_s: float, machines: list[str], cameras: tuple[str, ...]) -> Step:
    kinds = list(_FAULTS)
    kind = rng.choices(kinds, [_FAULTS[of][0] for of in kinds])[0]
    _, values, spans = _FAULTS[kind]
    if kind in _OF_CAMERAS:
        target = rng.choice(cameras)
    elif kind in _OF_NOBODY_ELSE:
        target = rng.choice([name for name in machines if name != "relay"])
    else:
        target = rng.choice(machines)
    return Step(at_s, kind, target, _between(rng, values), rng.uniform(*spans))


def _between(rng: random.Random, values: tuple[float, float]) -> float:
    low, high = values
    if low > 0 and high / low > 50:
        return float(low * (high / low) ** rng.random())
    return rng.uniform(low, high)


def _order(rng: random.Random, at_s: float) -> Step:
    kind = rng.choices(("burst", "series", "recording", "long", "cancel"), (5, 2, 2, 1, 1))[0]
    value: Any = {
        "burst": rng.randint(1, 8),
        "series": rng.randint(2, 4),
        "recording": 0,
        "long": rng.randint(25, 40),
        "cancel": 3,
    }[kind]
    return Step(
        at_s, kind, "desk", float(value), rng.uniform(1, 5) if kind in ("recording", "series") else 0.0
    )
