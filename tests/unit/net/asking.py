"""A program that prints what is in the way to each of the leaders it is given."""

import asyncio
import sys

from capture_app.common.address import parse_address
from capture_app.net.reachability import find_obstacle


async def ask_all(leaders: list[str]) -> None:
    for found in await asyncio.gather(*(find_obstacle(parse_address(leader)) for leader in leaders)):
        print(found)


if __name__ == "__main__":
    asyncio.run(ask_all(sys.argv[1:]))
