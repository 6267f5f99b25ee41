"""`capture-app panel show`: a page served to whoever asks, or written to a file."""

import asyncio
import http.client
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from capture_app import cli
from capture_app.common.address import listen_tcp
from capture_app.companions.panel.screen import page_html
from capture_app.web.own_page import served_page


@pytest.fixture
async def served() -> AsyncIterator[int]:
    """The port of a page that is served."""
    with listen_tcp("127.0.0.1", 0) as listening:
        async with served_page(listening, page_html()):
            yield listening.getsockname()[1]


def ask(port: int, method: str, path: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.request(method, path)
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    finally:
        connection.close()


async def test_the_page_is_served_and_nothing_else(served: int) -> None:
    status, headers, body = await asyncio.to_thread(ask, served, "GET", "/")
    assert status == 200
    assert body == page_html()
    assert headers["content-type"] == "text/html; charset=utf-8"
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert (await asyncio.to_thread(ask, served, "HEAD", "/?x"))[2] == b""
    for path in ("/page.js", "/../pyproject.toml", "/%00<script>"):
        status, headers, body = await asyncio.to_thread(ask, served, "GET", path)
        assert status == 404
        assert b"<script>" not in body
    assert (await asyncio.to_thread(ask, served, "POST", "/"))[0] == 405


async def test_a_client_that_says_nothing_keeps_nobody_waiting(served: int) -> None:
    with socket.create_connection(("127.0.0.1", served)) as idle:
        idle.send(b"GET / HT")
        assert (await asyncio.to_thread(ask, served, "GET", "/"))[0] == 200


def test_a_port_in_use_is_a_clear_error(capsys: pytest.CaptureFixture[str]) -> None:
    with listen_tcp("127.0.0.1", 0) as taken:
        served = taken.getsockname()[1]
        assert cli.run(["panel", "show", "--port", str(served)]) == 5
    (line,) = capsys.readouterr().err.splitlines()
    assert f"cannot listen on 127.0.0.1:{served}: Address already in use" in line
    assert "--port 0 takes a free one" in line


def test_the_page_is_saved_for_a_screen_without_a_network(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "panel.html"
    assert cli.run(["panel", "show", "--save", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(file)}
    assert file.read_bytes() == page_html()
    assert cli.run(["panel", "show", "--save", str(tmp_path / "panel.png")]) == 2
    assert cli.run(["panel", "show", "--save", str(tmp_path / "nowhere" / "panel.html")]) == 1
    assert "cannot write" in capsys.readouterr().err


def test_the_command_serves_until_it_is_stopped() -> None:
    command = [sys.executable, "-m", "capture_app.cli", "panel", "show", "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            text = b""
            while b"}" not in text:
                assert select.select([process.stdout], [], [], 120)[0]
                text += os.read(process.stdout.fileno(), 4096)
            url = json.loads(text)["url"]
            assert url.startswith("http://127.0.0.1:")
            assert ask(int(url.rstrip("/").rpartition(":")[2]), "GET", "/")[0] == 200
            process.send_signal(signal.SIGINT)
            assert process.wait(120) == 130
        finally:
            # Else the end of the block would wait for it without an end.
            process.kill()
