"""A program that searches for leaders, says what is in the way, and ends with those that answer."""

import asyncio
import sys
from pathlib import Path

from capture_app.net.discovery import search_leaders
from capture_app.trust.trust import Trust

if __name__ == "__main__":
    trust = Trust(Path(sys.argv[1])) if len(sys.argv) > 1 else Trust.open()
    search = search_leaders(lambda: (), lambda line: print("said", line, flush=True), trust=trust)
    found = asyncio.run(search)
    for leader in found:
        among = ["+".join(address.host for address in leader.among)] if leader.among else []
        print("found", leader.addresses[0], leader.name, ascii(leader.version), *among, flush=True)
    sys.exit(0)
