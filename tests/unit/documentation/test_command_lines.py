"""Every command line of the documentation is one that its command takes; test_running.py runs them."""

import re
import tomllib

import click
import pytest

from benchmarks.__main__ import BENCHES
from tests.command_lines import PROGRAMS, parse
from tests.project import ROOT
from tests.unit.documentation.pages import PAGES, blocks, inline_commands

MAKEFILE = (ROOT / "Makefile").read_text()
TARGETS = set(re.findall(r"^([\w-]+):", MAKEFILE, re.MULTILINE))
NAMED = {
    target: set(re.findall(rf"^{target.upper()}_([\w-]+) :=", MAKEFILE, re.MULTILINE))
    for target in ("test", "pictures")
} | {"bench": set(BENCHES)}
"""What KIND or NAME may say to `test`, `bench` and `pictures`."""
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
FOREIGN = {"caliscope", "pycolmap-cuda12"}
"""What `pip install` may name besides this project's own folder: packages that are what they are called."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_command_lines_are_right(page: object) -> None:
    lines = [line for block in blocks(page) for line in block.commands()]  # type: ignore[arg-type]
    wrong = [f"{line}: {error}" for line in lines if (error := problem(line))]
    named = [f"{line}: {error}" for line in inline_commands(page) if (error := problem(line, whole=False))]  # type: ignore[arg-type]
    assert wrong + named == []


def problem(line: str, *, whole: bool = True) -> str:
    """What is wrong with a command line; one that is only named need not have all its arguments."""
    line = re.sub(r"^(\w+=\S+ +)+", "", line).removeprefix(".venv/bin/")
    program, _, rest = line.partition(" ")
    if program == "make":
        targets = [word for word in rest.split() if "=" not in word]
        missing = [word for word in targets if word not in TARGETS]
        missing += [
            name for name in re.findall(r"(?:KIND|NAME)=(\S+)", rest) if name not in NAMED[targets[0]]
        ]
        return f"the Makefile has no {missing[0]}" if missing else ""
    if program == "pip":
        extras = set(",".join(re.findall(r"\[([\w,-]+)\]", rest)).split(",")) - {""}
        packages = set(re.findall(r"(?<= )[\w-]+(?= |$)", rest.replace("-c constraints.txt", "")))
        unknown = (extras - EXTRAS) | (set() if extras or packages & FOREIGN else packages - {"install"})
        return f"nobody vouches for {sorted(unknown)}" if unknown else ""
    # [ROOT] may be left out, SESSION... be several, list|show one of them.
    words = re.sub(r"\.\.\.|…|[][]", "", re.sub(r"\$\w+", "x", rest)).replace(":PORT", ":47010")
    words = re.sub(r"\b(NUMBER|N)\b", "1", words)
    if choice := re.search(r"\S+\|\S+", words):
        each = (words.replace(choice[0], one) for one in choice[0].split("|"))
        return next((found for one in each if (found := problem(f"{program} {one}", whole=False))), "")
    try:
        parse(f"{program} {words}")
    except click.exceptions.Exit:
        return ""
    except click.MissingParameter as error:
        return str(error.format_message()) if whole else ""
    except ValueError as error:
        return str(error)
    except click.UsageError as error:
        is_abridged = not whole and "requires an argument" in error.format_message()
        return "" if is_abridged else str(error.format_message())
    return ""


def test_the_check_sees_what_is_wrong() -> None:
    assert problem("capture-app burst --frames 3") == ""
    assert "No such option" in problem("capture-app burst --farmes 3")
    assert "not a valid integer" in problem(".venv/bin/capture-app burst --frames three")
    assert "Missing argument" in problem("reconstruct stereo --out x")
    assert problem("reconstruct stereo", whole=False) == ""
    assert "no command" in problem("capture-app sessions list|shwo")
    assert "no bench-nothing" in problem("make bench-nothing")
    assert "no nothing" in problem("make bench NAME=nothing")
    assert problem("make bench NAME=soak BENCH=--cameras") == ""
    assert "simulshot" in problem("pip install simulshot")
    assert problem("pip install -c constraints.txt -e '.[export]'") == ""
    assert set(PROGRAMS) == {"capture-app", "reconstruct"}
