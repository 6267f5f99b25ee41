"""Mutation test: flip random operators of a folder's code, one at a time, and see whether the tests notice.

    python -m benchmarks.flip_operators reconstruction/depth --tests tests/unit/reconstruction/depth

A flip is `+` for `-`, `*` for `/`, `<` for `>`, `==` for `!=`, `and` for `or`, `&` for `|`, or a missing sign
or `not`; in C, those operators that have a space on both sides. Each is tried in a copy of the checkout until
the first test fails. `<` for `<=` is not tried: it seldom changes anything. Some flips cannot be noticed, as
`==` in a branch that only saves time.
"""

import argparse
import ast
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tokenize
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
BINARY = {"+": "-", "-": "+", "*": "/", "/": "*", "&": "|", "|": "&", "//": "*"}
COMPARED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "!=", "!=": "=="}
FLIPPED = (
    BINARY | COMPARED | {f"{one}=": f"{other}=" for one, other in BINARY.items()} | {"and": "or", "or": "and"}
)
OPERATORS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//",
    ast.BitAnd: "&", ast.BitOr: "|",
    ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
IN_C = FLIPPED | {"&&": "||", "||": "&&"}
C_OPERATOR = re.compile(r"(?<= )(?:[-+*/]=?|[<>=!]=|[<>]|&&?|\|\|?)(?= )")
Place = tuple[int, int]
"""Line from 1 and column in characters from 0."""


@dataclass(frozen=True)
class Flip:
    """An operator of a file, and what is written instead."""

    file: Path
    place: Place
    old: str
    new: str

    def __str__(self) -> str:
        line = self.file.read_text().splitlines()[self.place[0] - 1].strip()
        return f"{self.file}:{self.place[0]}:{self.place[1]} `{self.old}` -> `{self.new}`  {line}"

    def flipped(self) -> str:
        """Return the file's text with the flip."""
        lines = self.file.read_text().splitlines(keepends=True)
        row, column = self.place[0] - 1, self.place[1]
        lines[row] = lines[row][:column] + self.new + lines[row][column + len(self.old) :]
        return "".join(lines)


def find_flips(file: Path) -> list[Flip]:
    """Return all flips of a file, those in annotations left out."""
    text = file.read_text()
    lines = text.splitlines()
    if file.suffix == ".c":
        return [
            Flip(file, (row, match.start()), match[0], IN_C[match[0]])
            for row, line in enumerate(_without_comments(text).splitlines(), 1)
            for match in C_OPERATOR.finditer(line)
            if not line.startswith("#")
        ]
    with file.open("rb") as opened:
        tokens = [(one.start, one.string) for one in tokenize.tokenize(opened.readline)]
    tree = ast.parse(text)
    notes = {id(node) for annotation in _annotations(tree) for node in ast.walk(annotation)}

    def place(line: int, column: int) -> Place:
        return line, len(lines[line - 1].encode()[:column].decode())

    found = []
    for node in ast.walk(tree):
        for left, right, operator in _operators(node) if id(node) not in notes else ():
            start = place(left.end_lineno or 0, left.end_col_offset or 0)
            end = place(right.lineno, right.col_offset)
            at = next((at for at, string in tokens if start <= at < end and string == operator), None)
            # None inside an f-string, which Python 3.11 reads as one token.
            if at is not None:
                found.append(Flip(file, at, operator, FLIPPED[operator]))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            old = "-" if isinstance(node.op, ast.USub) else "not"
            found.append(Flip(file, place(node.lineno, node.col_offset), old, ""))
    return sorted(found, key=lambda one: one.place)


def _without_comments(text: str) -> str:
    """Return C with its comments blanked, so that all else keeps its place."""
    return re.sub(r"/\*.*?\*/", lambda comment: re.sub(r"\S", " ", comment[0]), text, flags=re.DOTALL)


def _operators(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr, str]]:
    """Yield the operators of a node that can be flipped, each with the operands around it."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS and not _is_text(node):
        operator = OPERATORS[type(node.op)]
        if isinstance(node, ast.BinOp):
            yield node.left, node.right, operator
        else:
            yield node.target, node.value, f"{operator}="
    elif isinstance(node, ast.Compare):
        terms = [node.left, *node.comparators]
        for one, left, right in zip(node.ops, terms, terms[1:], strict=False):
            if type(one) in OPERATORS:
                yield left, right, OPERATORS[type(one)]
    elif isinstance(node, ast.BoolOp):
        for left, right in pairwise(node.values):
            yield left, right, "and" if isinstance(node.op, ast.And) else "or"


def _annotations(tree: ast.AST) -> Iterator[ast.expr]:
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if isinstance(note := getattr(node, name, None), ast.expr):
                yield note


def _is_text(node: ast.BinOp | ast.AugAssign) -> bool:
    """Return whether an operand is a string: a path's part, or a text that is joined."""
    ends = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(
        isinstance(one, ast.JoinedStr) or (isinstance(one, ast.Constant) and isinstance(one.value, str))
        for one in ends
    )


def copy_checkout(target: Path) -> None:
    """Copy the tracked files, and the compiled kernels, which git ignores."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True)
    for name in (
        *filter(None, listed.stdout.split("\0")),
        *(str(one.relative_to(ROOT)) for one in ROOT.glob("reconstruction/depth/kernels.*.library")),
    ):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def run_tests(tests: str, timeout_s: float) -> tuple[bool, str]:
    """Return whether the tests pass, and the first that fails."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *shlex.split(tests)]
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd()), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return False, "it never ended"
    named = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return done.returncode == 0, named[0].split(" - ")[0] if named else done.stdout[-300:]


def main() -> None:
    """Flip, test, and print each flip with what found it; exit with 1 if the unflipped code fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="Folders or files whose operators are flipped.")
    parser.add_argument(
        "--tests",
        action="append",
        required=True,
        help="Arguments of pytest. Repeat for several runs, quickest first: later ones see survivors only.",
    )
    parser.add_argument("--count", type=int, default=40, help="Number of flips, drawn at random.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--timeout-s", type=float, default=600.0)
    asked = parser.parse_args()

    def run_all() -> tuple[bool, str]:
        runs = (run_tests(tests, asked.timeout_s) for tests in asked.tests)
        return next((one for one in runs if not one[0]), (True, ""))

    with tempfile.TemporaryDirectory(prefix="simulshot-flips-") as scratch, chdir(scratch):
        copy_checkout(Path(scratch))
        files = [
            file
            for one in asked.folders
            for file in ([one] if one.is_file() else sorted([*one.rglob("*.py"), *one.rglob("*.c")]))
        ]
        flips = [flip for file in files for flip in find_flips(file)]
        chosen = random.Random(asked.seed).sample(flips, min(asked.count, len(flips)))
        print(f"{len(chosen)} of {len(flips)} flips, seed {asked.seed}", flush=True)
        passes, why = run_all()
        if not passes:
            sys.exit(f"the tests fail without a flip: {why}")
        survived = 0
        for flip in chosen:
            began, text, label = time.monotonic(), flip.file.read_text(), f"{flip}"
            flip.file.write_text(flip.flipped())
            passes, why = run_all()
            flip.file.write_text(text)
            survived += passes
            print(f"{'SURVIVED' if passes else 'found'} {label}", flush=True)
            print(f"    {time.monotonic() - began:.0f} s {'' if passes else why}", flush=True)
    print(f"{len(chosen) - survived} of {len(chosen)} found")


if __name__ == "__main__":
    main()
