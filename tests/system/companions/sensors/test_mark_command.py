"""`capture-app mark`: it marks from another process, and says where."""

import asyncio
import json
import sys
from pathlib import Path

from capture_app.session.format.marks import RIG_MARKS
from tests.cheap_rig import rig_of


async def test_the_command_marks_and_says_where(tmp_path: Path) -> None:
    async with rig_of(0, tmp_path) as leader:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "capture_app.cli", "mark", "door opens", "--json",
            "--leader", str(leader.own_address),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        data, said = await process.communicate()
    assert process.returncode == 0, said
    assert json.loads(data)["mark"]["text"] == "door opens"
    assert json.loads(data)["file"] == str(tmp_path / RIG_MARKS)
    assert b"door opens" in (tmp_path / RIG_MARKS).read_bytes()
