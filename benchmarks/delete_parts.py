"""Mutation test: delete parts of a folder's functions, one at a time, and list those that no test notices.

    python -m benchmarks.delete_parts capture_app/node/burst --tests tests/unit/node

A part is the body of a private function, a branch, or an exception handler; `suppress` then suppresses
nothing. With `--fine` it is a single statement, or a half of an `and` or `or`, or a comparison has its limit
on the other side. Tests are imported once. Each deletion is made in a process forked from there, which runs
the tests that call the function, cheapest first, until one fails. Programs that tests start have no deletion:
what only these show survives here. Some deletions change nothing but time, as that of a cache.
"""

import argparse
import ast
import os
import random
import select
import signal
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, TextIO

import pytest

from tests.virtual.planted import code_of, live_function

ROOT = Path(__file__).parents[1]
MIN_TESTS_S, SLOWER = 30.0, 20.0
"""Least time for a deletion's tests, in s, or so many times what they cost. What never ends is noticed."""
Function = ast.FunctionDef | ast.AsyncFunctionDef
Key = tuple[str, int]
"""File and first line of a function's code."""
Parts = Iterator[tuple[int, str, ast.AST, str, Any]]
"""Parts of a function: line, what it is, and the field that loses it with what that has instead."""
STEPS = (
    ast.Assign | ast.AugAssign | ast.AnnAssign | ast.Return | ast.Expr | ast.Continue | ast.Break | ast.Raise
)
BESIDE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
"""Each comparison, and that which differs at its limit."""


@dataclass(frozen=True)
class Deletion:
    """A part of a function, and how its tree is changed and changed back."""

    file: Path
    line: int
    what: str
    function: str
    """Qualified name of the outermost function."""
    tree: ast.Module
    node: Any
    field: str
    after: Any
    """What the node has in that field instead."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.what} of {self.function}"

    def code(self) -> CodeType:
        """Return the function's code without the part."""
        before = getattr(self.node, self.field)
        setattr(self.node, self.field, self.after)
        try:
            return code_of(
                compile(ast.fix_missing_locations(self.tree), str(ROOT / self.file), "exec"), self.function
            )
        finally:
            setattr(self.node, self.field, before)

    def live(self) -> FunctionType:
        """Return the function that runs."""
        module = import_module(self.file.with_suffix("").as_posix().replace("/", "."))
        return live_function(module, self.function)


def find_deletions(file: Path, *, fine: bool = False) -> list[Deletion]:
    """Return the deletions of a file, by its path below the checkout, in the order of its lines.

    `fine` ones are of single statements and of halves of conditions.
    """
    tree = ast.parse((ROOT / file).read_text())
    return sorted(
        (
            Deletion(file, line, what, name, tree, node, field, after)
            for name, function in _functions(tree)
            for line, what, node, field, after in (_fine_parts if fine else _parts)(function)
        ),
        key=lambda of: of.line,
    )


def _functions(node: ast.AST, above: str = "") -> Iterator[tuple[str, Function]]:
    """Yield the outermost functions below a node with their qualified names."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from _functions(child, f"{above}{child.name}.")
        elif isinstance(child, Function):
            yield f"{above}{child.name}", child


def _fine_parts(function: Function) -> Parts:
    """Yield each statement that holds no others, each half of a condition, and each limit of a comparison."""
    for node in ast.walk(function):
        for field in ("body", "orelse", "finalbody"):
            steps = getattr(node, field, ())
            for place, step in enumerate(steps if isinstance(steps, list) else ()):
                # Neither a docstring nor the declaration of a variable does anything.
                is_idle = isinstance(getattr(step, "value", step), ast.Constant | None)
                if isinstance(step, STEPS) and not (is_idle and isinstance(step, ast.Expr | ast.AnnAssign)):
                    kept = [*steps[:place], ast.Pass(), *steps[place + 1 :]]
                    yield step.lineno, f"statement {ast.unparse(step)[:40]!r}", node, field, kept
        if isinstance(node, ast.BoolOp):
            for place, half in enumerate(node.values):
                always = ast.Constant(isinstance(node.op, ast.And))
                kept = [*node.values[:place], always, *node.values[place + 1 :]]
                yield half.lineno, f"condition {ast.unparse(half)[:40]!r}", node, "values", kept
        elif isinstance(node, ast.Compare):
            for place, way in enumerate(node.ops):
                if (beside := BESIDE.get(type(way))) is not None:
                    kept = [*node.ops[:place], beside(), *node.ops[place + 1 :]]
                    yield node.lineno, f"limit of {ast.unparse(node)[:40]!r}", node, "ops", kept


def _parts(function: Function) -> Parts:
    """Yield the parts of which each is a behaviour of its own."""
    if function.name.startswith("_") and not function.name.endswith("__"):
        yields = any(isinstance(node, ast.Yield | ast.YieldFrom) for node in ast.walk(function))
        nothing = [ast.Return(), *([ast.Expr(ast.Yield())] if yields else [])]
        yield function.lineno, "body", function, "body", nothing
    for node in ast.walk(function):
        if isinstance(node, ast.If):
            yield node.lineno, "branch", node, "body", [ast.Pass()]
            if node.orelse and not isinstance(node.orelse[0], ast.If):
                yield node.orelse[0].lineno, "other branch", node, "orelse", []
        elif isinstance(node, ast.match_case):
            yield node.pattern.lineno, "case", node, "body", [ast.Pass()]
        elif isinstance(node, ast.ExceptHandler) and ast.unparse(node.body[0]) != "raise":
            yield node.lineno, "handler", node, "body", [ast.Raise()]
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "suppress":
            yield node.lineno, "suppression", node, "args", []


class Hunt:
    """Plugin of pytest that makes deletions in place of running the tests once."""

    def __init__(self, deletions: Sequence[Deletion], talk: TextIO) -> None:
        self._deletions, self._talk = deletions, talk
        self.survived: list[Deletion] = []
        self._failed = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note the first failure of a process."""
        if report.failed:
            self._failed = self._failed or report.nodeid

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Find which tests call which function, then make each deletion."""
        items = session.items
        said = _in_child(lambda write: self._trace(items, write), timeout_s=3600)
        calls = defaultdict[Key, list[tuple[float, int]]](list)
        for line in said.splitlines():
            number, seconds, called, first = line.split("\t")
            calls[called, int(first)].append((float(seconds), int(number)))
        failed = sorted(number for _, number in calls.pop(("failed", 0), []))
        self._say(f"{len(items)} tests, {len(self._deletions)} deletions")
        for place in failed:
            self._say(f"fails without a deletion, and is left out: {items[place].nodeid}")
        for of in self._deletions:
            function = of.live().__code__
            tests = sorted(calls[function.co_filename, function.co_firstlineno])
            chosen = [items[number] for _, number in tests if number not in failed]
            began = time.monotonic()
            limit_s = max(MIN_TESTS_S, SLOWER * sum(seconds for seconds, _ in tests))
            why = self._try(of, chosen, limit_s) if chosen else ""
            if not why:
                self.survived.append(of)
            result = f"found {of}: {why}" if why else f"SURVIVED {of}: {len(chosen)} tests call it"
            self._say(f"{result}, {time.monotonic() - began:.1f} s")
        return True

    def _say(self, line: str) -> None:
        print(line, file=self._talk, flush=True)

    def _try(self, of: Deletion, items: Sequence[pytest.Item], limit_s: float) -> str:
        """Return the first test that notices a deletion; empty for none."""
        try:
            code = of.code()
        except SyntaxError as error:
            return str(error)

        def run(write: Callable[[str], None]) -> None:
            of.live().__code__ = code
            self._run(items)
            write(self._failed)

        if len(code.co_freevars) != len(of.live().__code__.co_freevars):
            return "not tried: it closes over other names"
        return _in_child(run, limit_s)

    def _run(self, items: Sequence[pytest.Item]) -> None:
        for item, after in zip(items, (*items[1:], None), strict=True):
            item.ihook.pytest_runtest_protocol(item=item, nextitem=after)
            if self._failed:
                return

    def _trace(self, items: Sequence[pytest.Item], write: Callable[[str], None]) -> None:
        """Run all tests; write a line for each and each function of the deletions' files that it calls."""
        files = {str(ROOT / of.file) for of in self._deletions}
        seen = set[CodeType]()

        # Not sys.settrace, which hypothesis uses itself.
        def profile(frame: FrameType, event: str, _: Any) -> None:
            if event == "call" and frame.f_code not in seen and frame.f_code.co_filename in files:
                seen.add(frame.f_code)

        threading.setprofile(profile)
        sys.setprofile(profile)
        for number, (item, after) in enumerate(zip(items, (*items[1:], None), strict=True)):
            began = time.process_time()
            item.ihook.pytest_runtest_protocol(item=item, nextitem=after)
            seconds = time.process_time() - began
            for code in tuple(seen):
                write(f"{number}\t{seconds:.3f}\t{code.co_filename}\t{code.co_firstlineno}\n")
            if self._failed:
                write(f"{number}\t0\tfailed\t0\n")
            self._failed = ""
            seen.clear()


def _in_child(work: Callable[[Callable[[str], None]], None], timeout_s: float) -> str:
    """Run work in a fork and return what it writes; "it never ends" after a timeout."""
    reading, writing = os.pipe()
    if not (child := os.fork()):
        try:
            os.setpgid(0, 0)
            with os.fdopen(writing, "w") as out:
                work(lambda text: (out.write(text), None)[1])
        except BaseException as error:  # noqa: BLE001 - said by the parent
            os.write(writing, f"{type(error).__name__}: {error}".encode())
        finally:
            os._exit(0)
    os.close(writing)
    said, ends_s = b"", time.monotonic() + timeout_s
    while select.select([reading], [], [], max(0.0, ends_s - time.monotonic()))[0]:
        if not (data := os.read(reading, 1 << 16)):
            break
        said += data
    else:
        said = b"it never ends"
    os.close(reading)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return said.decode()


def main() -> None:
    """Delete, test, and print each deletion with what noticed it; exit with 1 if any survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="Folders or files below the checkout.")
    parser.add_argument("--tests", action="append", required=True, help="Tests' folder or file; repeatable.")
    parser.add_argument("--fine", action="store_true", help="Single statements and halves of conditions.")
    parser.add_argument("--count", type=int, help="Number of deletions, drawn at random; default: all.")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    os.chdir(ROOT)
    files = [file for of in asked.folders for file in ([of] if of.is_file() else sorted(of.rglob("*.py")))]
    deletions = [of for file in files for of in find_deletions(file, fine=asked.fine)]
    if asked.count is not None and asked.count < len(deletions):
        chosen = {*random.Random(asked.seed).sample(range(len(deletions)), asked.count)}
        deletions = [of for number, of in enumerate(deletions) if number in chosen]
    with os.fdopen(os.dup(1), "w") as talk, Path(os.devnull).open("w") as nowhere:
        hunt = Hunt(deletions, talk)
        os.dup2(nowhere.fileno(), 1)
        pytest.main(["-q", "-p", "no:cacheprovider", *asked.tests], plugins=[hunt])
        print(f"{len(deletions) - len(hunt.survived)} of {len(deletions)} noticed", file=talk)
        for of in hunt.survived:
            print(f"  {of}", file=talk)
    sys.exit(bool(hunt.survived))


if __name__ == "__main__":
    main()
