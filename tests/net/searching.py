"""A program that searches for leaders, says what is in the way, and ends with those that answer."""

import asyncio
import sys

from capture_app.net.discovery.search import search_leaders

if __name__ == "__main__":
    found = asyncio.run(search_leaders(lambda: (), lambda line: print("said", line, flush=True)))
    for leader in found:
        print("found", leader.address, leader.name, ascii(leader.version), flush=True)
    sys.exit(0)
