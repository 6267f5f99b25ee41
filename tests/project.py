"""Places of this project that tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_sessions"
JUMPER = SAMPLES / "jumper"
