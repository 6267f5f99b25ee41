"""The pages of the documentation and the command lines in them.

A block of commands is what people copy, so it is a shell script: what is no command stands behind a `#`.
A comment before it says why it is not run here: `<!-- not run: REASON -->`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.project import ROOT, SAMPLES

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    SAMPLES / "README.md",
]
_PROGRAM = r"(?:\.venv/bin/)?(?:capture-app|reconstruct|make|pip)"
_COMMAND = re.compile(rf"(?:\w+=\S+ +)*{_PROGRAM}(?=$|[ \\])")
_INLINE = re.compile(rf"`((?:\w+=\S+ )*{_PROGRAM} [^`]+)`")
_NOT_RUN = re.compile(r"<!-- not run: (.+?) -->")


@dataclass(frozen=True)
class Block:
    """Lines that are shown as code, of which one at least is a command of ours."""

    page: Path
    line: int
    script: str
    not_run: str = ""

    def commands(self) -> list[str]:
        """Its command lines: one each, without what comes after `#`, `&` or `|`."""
        joined = self.script.replace("\\\n", " ")
        lines = [re.split(r"\s#|\s&|\|", line.strip())[0].strip() for line in joined.splitlines()]
        return [line for line in lines if _COMMAND.match(line)]


def blocks(page: Path) -> Iterator[Block]:
    """Find the blocks of commands of a page, fenced ones and indented ones."""
    not_run, begun, found, fenced = "", 0, list[str](), False
    for number, line in enumerate((*page.read_text().splitlines(), "end"), 1):
        if line.startswith("```"):
            fenced = not fenced
        is_code = fenced or line.startswith("    ")
        if is_code and not line.startswith("```"):
            begun = begun or number
            found.append(line if fenced else line[4:])
            continue
        if found and (line or fenced):
            script = _without_answers(found)
            block = Block(page, begun, script, not_run)
            if block.commands():
                yield block
            begun, found, not_run = 0, [], ""
        if reason := _NOT_RUN.search(line):
            not_run = reason[1]


def _without_answers(lines: list[str]) -> str:
    """Of a dialogue, what is typed."""
    if lines[0].startswith("$ "):
        lines = [line[2:] for line in lines if line.startswith("$ ")]
    return "\n".join(lines)


def inline_commands(page: Path) -> Iterator[str]:
    """Find the commands that a page names within its text."""
    text = re.sub(r"^(```.*?^```|    .*?$)", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for found in _INLINE.finditer(" ".join(text.split())):
        yield found[1]


def plugin_module(section: str) -> str:
    """Return the code of the module that a section of docs/plugins.md links to."""
    name, *_ = re.findall(r"\]\((examples/plugins/\w+\.py)\)", section)
    return (ROOT / "docs" / name).read_text()
