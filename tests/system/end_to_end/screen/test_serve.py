"""The screen in a browser: its page, its terminal over a web socket, and who is refused."""

import asyncio
import json
from pathlib import Path

import aiohttp
import pytest

from tests.system.end_to_end.conftest import TIMEOUT_S, Start


async def test_the_screen_opens_for_its_own_page_only(start: Start, tmp_path: Path) -> None:
    leader = await start(
        "leader", "--host", "127.0.0.1", "--port", "0", "--sessions", str(tmp_path), "--json"
    )
    at = (await leader.next_json())["leader"]
    serving = await start("serve", "--leader", at, "--port", "0", "--json")
    assert serving.process.stdout is not None
    async with asyncio.timeout(TIMEOUT_S):
        printed = await serving.process.stdout.readuntil(b"\n}\n")
    told = json.loads(printed)
    assert (told["leader"], told["sessions"]) == (at, str(tmp_path))
    assert "can control it" in await serving.says("the page shows")
    url = told["url"]
    page = url.removeprefix("http://")
    async with aiohttp.ClientSession() as browser:
        async with browser.get(url) as answer:
            assert answer.status == 200
            assert "simulshot" in await answer.text()
        # What another site's page asks for, and a name of the attacker's that leads to this machine.
        async with browser.get(url, headers={"Host": "rebound.example"}) as answer:
            assert answer.status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            await browser.ws_connect(f"{url}/ws", headers={"Origin": "http://evil.example"})
        async with (
            asyncio.timeout(TIMEOUT_S),
            browser.ws_connect(f"{url}/ws", headers={"Origin": f"http://{page}"}) as terminal,
        ):
            shown = ""
            while "Rig" not in shown:
                message = await terminal.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    shown += message.data.decode(errors="replace")
    assert await serving.stop() == 130
    open_to_all = await start(
        "serve", "--leader", at, "--host", "0.0.0.0", "--port", "0", "--allow-host", "stage.example", "--json"
    )
    assert open_to_all.process.stdout is not None
    async with asyncio.timeout(TIMEOUT_S):
        printed = await open_to_all.process.stdout.readuntil(b"\n}\n")
    url = f"http://127.0.0.1:{json.loads(printed)['url'].rpartition(':')[2]}"
    async with aiohttp.ClientSession() as browser:
        for name, code in (("stage.example", 200), ("rebound.example", 403)):
            headers = {"Host": name, "Origin": f"http://{name}"}
            async with browser.get(url, headers=headers) as answer:
                assert answer.status == code
    assert await open_to_all.stop() == 130
    status = await start("status", "--leader", at, "--json")
    assert json.loads(await status.finish())["leader"] == at, "the rig goes on"
