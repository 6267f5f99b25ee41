"""Fuzz one reader, guided by the coverage of the project's own code: what reaches something new is kept.

    python -m tests.fuzz.run READER [--seconds 60] [--found FOLDER]

Starts from the corpus of the reader and puts what it finds into FOLDER. What broke the reader is written
there as crash-...: put it into the corpus with the repair.
"""

import argparse
import contextlib
import random
import sys
import tempfile
from pathlib import Path

import atheris

CORPUS = Path(__file__).parent / "corpus"
SECONDS_EACH = 20
"""Of one input, before it counts as a hang."""
MEGABYTES = 2048

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("reader")
parser.add_argument("--seconds", type=int, default=60)
parser.add_argument("--found", type=Path, default=Path("fuzz"))


def main() -> None:
    """Run until the time is over or the reader breaks; the exit code is the fuzzer's."""
    # Some readers import what they need when they run.
    with atheris.instrument_imports(include=["capture_app", "reconstruction"]):
        fuzz(parser.parse_args())


def fuzz(arguments: argparse.Namespace) -> None:
    """Never returns: the fuzzer ends the process."""
    from tests.fuzz.mutations import mutate
    from tests.fuzz.readers import READERS

    if arguments.reader not in READERS:
        parser.error(f"no reader {arguments.reader!r}; there are {', '.join(READERS)}")
    read = READERS[arguments.reader]

    def feed(data: bytes) -> None:
        with tempfile.TemporaryDirectory(prefix="simulshot-fuzz-") as folder:
            read(data, Path(folder))

    def change(data: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)
        changed = mutate(data, rng) if rng.random() < 0.5 else atheris.Mutate(data, most)
        return bytes(changed[:most])

    found = arguments.found / arguments.reader
    found.mkdir(parents=True, exist_ok=True)
    options = [
        sys.argv[0],
        str(found),
        str(CORPUS / arguments.reader),
        f"-max_total_time={arguments.seconds}",
        f"-timeout={SECONDS_EACH}",
        f"-rss_limit_mb={MEGABYTES}",
        f"-artifact_prefix={found}/",
        "-max_len=20000",
        "-print_final_stats=1",
    ]
    # What a reader imports when it first runs is no hang.
    with contextlib.suppress(Exception):
        feed(b"")
    atheris.Setup(options, feed, custom_mutator=change)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
