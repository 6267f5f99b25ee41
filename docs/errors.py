"""Print all errors that both packages raise as a table: text, hint, and place in the code.

    python docs/errors.py [--without-hint] [PATH...]

Reads the syntax tree only: parts of a text that are known only at run time are shown as …, and a text that
is a variable by its name. Python's own exceptions are left out.
"""

import ast
import builtins
import sys
from collections.abc import Iterator
from pathlib import Path

CONTINUED = ("UsageError", "BadParameter")
"""Errors of the command line: click adds `see COMMAND --help` to them."""


def errors_of(path: Path) -> Iterator[tuple[str, str, str]]:
    """Yield the text, the hint and the place of each error that a file makes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not node.args:
            continue
        name = ast.unparse(node.func).rpartition(".")[2]
        if name != "BadParameter" and (not name.endswith("Error") or hasattr(builtins, name)):
            continue
        hints = [text_of(word.value) for word in node.keywords if word.arg == "hint"]
        hint = hints[0] if hints else "(see --help)" if name in CONTINUED else ""
        yield f"{name}: {text_of(node.args[0])}", hint, f"{path}:{node.lineno}"


def text_of(node: ast.expr) -> str:
    """Return a text with … for each of its values; the code of any other expression."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return f"‹{ast.unparse(node)}›"


def main() -> None:
    """Print the table, one error a line."""
    arguments = sys.argv[1:]
    only_without = "--without-hint" in arguments
    roots = [Path(one) for one in arguments if not one.startswith("--")] or [
        Path("capture_app"),
        Path("reconstruction"),
    ]
    files = [file for root in roots for file in ([root] if root.is_file() else sorted(root.rglob("*.py")))]
    found = [error for file in files for error in errors_of(file)]
    for text, hint, place in found:
        if not (only_without and hint):
            sys.stdout.write(f"{text}\n    → {hint or '—'}    {place}\n")
    without = sum(not hint for _, hint, _ in found)
    sys.stdout.write(f"{len(found)} errors, {without} without a hint\n")


if __name__ == "__main__":
    main()
