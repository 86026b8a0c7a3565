"""Twenty pages that look at a robot, from a process of their own: python pages.py URL.

The last one never reads.

Each of the others prints how many rows it got and whether any was missing between them.
"""

import asyncio
import json
import socket
import sys

import websockets

PAGES = 20


async def look(url):
    """Follow until the view is closed.

    Returns how many rows came after the present, and how many were not given.
    """
    async with websockets.connect(url, max_size=None, compression=None) as page:
        await page.recv()
        count = missed = 0
        print("looking", flush=True)
        async for text in page:
            said = json.loads(text)
            count += len(said.get("rows", ()))
            missed = said.get("dropped", missed)
    return count, missed


async def freeze(url):
    """Open a page and read nothing more from it."""
    host, port = url.removeprefix("ws://").partition("/")[0].split(":")
    raw = socket.create_connection((host, int(port)))
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.sendall(
        f"GET /ws HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    print("looking", flush=True)
    return raw


async def main(url):
    frozen = await freeze(url)
    found = await asyncio.gather(*(look(url) for _ in range(PAGES - 1)))
    frozen.close()
    print(json.dumps(found))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
