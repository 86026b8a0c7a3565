"""The page while it runs: a small server in a thread of its own, which no page can hold up, and which holds up no tick.

What a page has got is a number: the row that it gets next. There is no queue to fill: one that is too slow is given the
present instead of all that it has missed, and is told how much that was.
"""

import asyncio
import hmac
import json
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractContextManager, asynccontextmanager, suppress
from ipaddress import ip_address
from secrets import token_urlsafe
from threading import Thread
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote, urlsplit

from kb import KnowledgeBase, KnowledgeBaseError
from missions.engine.mission import MissionError
from missions.extras import needs
from missions.views.facts import supposed
from missions.views.recorder import Recorder
from missions.views.report import page_of
from missions.views.rows import VERSION, Row, encoded
from missions.views.steering import Steering

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

PORT: Final = 8420
KEEP: Final = 100_000
"""How many rows a live page can look back."""
BEAT_S: Final = 0.1
"""From one frame to the next [s], of this machine's time."""
_SILENCE: Final = 10
"""After how many beats without news a page hears of the time."""
_BEHIND: Final = 5_000
"""So many rows a page may be behind before it is given the present instead."""
_PAST: Final = 20_000
"""How many rows of the past are given in one answer."""
_LONGEST: Final = 65_536
"""The longest message that a page may send [bytes]."""
_MOST_PAGES: Final = 200
_MISTAKES: Final = 20
"""After so many messages that mean nothing a page is shown out."""
_PATIENCE_S: Final = 2.0
"""How long pages get for the last rows when the view is closed [s], of this machine's time."""
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_SERVER: Final[dict[str, Any]] = {
    **{"ws": "websockets-sansio", "ws_max_size": _LONGEST, "ws_per_message_deflate": False, "lifespan": "on"},
    **{"limit_concurrency": _MOST_PAGES, "timeout_graceful_shutdown": 1, "log_level": "critical"},
    "server_header": False,
}


class LiveView(AbstractContextManager["LiveView"]):
    """Shows a robot in browsers while it works, in three lines of its own program.

        view = LiveView(kb, tree)
        print(view.url)
        ...                                  # the robot does its work
        view.close()

    It listens on this machine only. Elsewhere (`host`) whoever looks needs the token that is part of `url`.

    Args:
        tree: what decides; see `Recorder`, whose other arguments can be given too.
        port: where to listen; 0 for any that is free.
        token: what pages have to know; None for one that is made up, and for none on this machine.
        recorder: what writes down what there is to see, if there is one already.
        steering: what a page may do to a simulation; None for nothing.

    Raises:
        MissionError: the extra `live` is not installed, or it cannot listen there.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        tree: Any = None,  # noqa: ANN401  # as of Recorder
        *,
        port: int = PORT,
        host: str = "127.0.0.1",
        token: str | None = None,
        recorder: Recorder | None = None,
        steering: Steering | None = None,
        **shown: Any,  # noqa: ANN401  # as of Recorder
    ) -> None:
        with needs("live", "the live page"):
            import starlette  # noqa: F401  # used later, in the server's thread
            import uvicorn
            import websockets  # noqa: F401  # used by uvicorn
        self._kb, self._steering = kb, steering
        self._token = token if token is not None or _is_this_machine(host) else token_urlsafe(16)
        self._socket = _listening(host, port)
        port = self._socket.getsockname()[1]
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]", host)}
        shown_host = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
        query = f"?token={quote(self._token)}" if self._token else ""
        self.url = f"http://{shown_host}:{port}/{query}"
        self.recorder = recorder or Recorder(kb, tree, **{"keep": KEEP, "what_if": False, **shown})
        self.recorder.header["live"] = True
        live = {"socket": f"/ws{query}"}
        document = {"version": VERSION, "runs": [], "differences": [], "live": live, "note": ""}
        self._page = page_of(document, str(self.recorder.header["title"]))
        self._rows = self.recorder.rows
        self._pages: dict[_Page, None] = {}
        self._frame: tuple[int, int, str] = (0, 0, "")
        self._is_closing = False
        self._beat = asyncio.Event()
        self._server = uvicorn.Server(uvicorn.Config(self._application(), **_SERVER))
        self._thread = Thread(target=self._server.run, args=([self._socket],), name="live page", daemon=True)
        self._thread.start()

    @property
    def pages(self) -> int:
        return len(self._pages)

    @property
    def dropped(self) -> int:
        """How many rows pages that look now were too slow for."""
        return sum(page.dropped for page in tuple(self._pages))

    def close(self) -> None:
        """Give the pages the last rows, as far as they take them in time, and listen no more."""
        if not self._is_closing:
            self.recorder.close()
            self._is_closing = True
            self._thread.join(_PATIENCE_S + 3.0)
            self._socket.close()

    def __exit__(self, *reason: object) -> None:
        self.close()

    # ---------------------------------------------------------------- the server's own thread

    def _application(self) -> "Starlette":
        from starlette.applications import Starlette
        from starlette.routing import Route, WebSocketRoute

        @asynccontextmanager
        async def beating(_: object) -> AsyncIterator[None]:
            task = asyncio.create_task(self._beat_on())
            yield
            task.cancel()

        routes = [Route("/", self._answer_page), WebSocketRoute("/ws", self._answer_socket)]
        return Starlette(routes=routes, lifespan=beating)

    async def _beat_on(self) -> None:
        """Put what is new into one frame for all pages, again and again."""
        silent, closing_s = 0, 0.0
        sent = self._rows.next
        while True:
            start, rows = self._rows.since(sent)
            silent += 1
            if rows or silent >= _SILENCE:
                silent, sent = 0, start + len(rows)
                self._frame = start, sent, self._framed(start, rows)
                waiting, self._beat = self._beat, asyncio.Event()
                waiting.set()
            if self._is_closing:
                closing_s += BEAT_S
                if not self._pages or closing_s > _PATIENCE_S:
                    self._server.should_exit = True
            await asyncio.sleep(BEAT_S)

    def _framed(self, start: int, rows: list[Row]) -> str:
        return encoded({"rows": rows, "from": start, "now": self._now, "state": self._state})

    @property
    def _state(self) -> dict[str, Any]:
        steered = {"paused": False, "speed": 1.0} if self._steering is None else self._steering.state
        return {"over": self._is_closing, "pages": len(self._pages), **steered}

    @property
    def _now(self) -> float:
        return round(max(self._rows.now, self._kb.now), 3)

    def _refusal(self, headers: Mapping[str, str], token: str) -> str:
        """Return why somebody may not look; empty if nothing is in the way."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"a page from {origin} may not look at this robot; open {self.url.partition('?')[0]} itself"
        if self._token is None:
            return "" if host in self._hosts else f"this is not {host}; open {self.url}"
        if hmac.compare_digest(token.encode(), self._token.encode()):
            return ""
        return f"the token is {'wrong' if token else 'missing'}; open the address that was printed when the view began"

    async def _answer_page(self, request: "Request") -> "Response":
        from starlette.responses import HTMLResponse, PlainTextResponse

        refusal = self._refusal(request.headers, request.query_params.get("token", ""))
        if refusal:
            return PlainTextResponse(refusal + "\n", status_code=403, headers=_HEADERS)
        return HTMLResponse(self._page, headers=_HEADERS)

    async def _answer_socket(self, websocket: "WebSocket") -> None:
        from starlette.responses import PlainTextResponse
        from starlette.websockets import WebSocketDisconnect

        refusal = self._refusal(websocket.headers, websocket.query_params.get("token", ""))
        if refusal:
            await websocket.send_denial_response(PlainTextResponse(refusal + "\n", status_code=403))
            return
        await websocket.accept()
        page = _Page(websocket)
        self._pages[page] = None
        tasks = [asyncio.create_task(one(page)) for one in (self._listen, self._show)]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                with suppress(WebSocketDisconnect, RuntimeError, OSError):
                    task.result()
        finally:
            for task in tasks:
                task.cancel()
            del self._pages[page]

    async def _show(self, page: "_Page") -> None:
        """Send what is new as it comes, as fast as this page takes it."""
        await self._greet(page)
        while True:
            start, end, text = self._frame
            if page.next == start < end:
                await page.send(text)
                page.next = end
            elif self._rows.next - page.next > _BEHIND:
                page.dropped += self._rows.next - page.next
                await self._greet(page)
            elif page.next < end:
                first, rows = self._rows.since(page.next, end - page.next)
                page.dropped += first - page.next
                await page.send(self._framed(first, rows))
                page.next = first + len(rows)
            elif self._is_closing:
                await page.websocket.close(1000, "the view is closed")
                return
            else:
                await self._beat.wait()
                if self._frame[0] == self._frame[1]:
                    await page.send(self._frame[2])

    async def _greet(self, page: "_Page") -> None:
        rows, following = self._rows.snapshot()
        greeting = {"hello": self.recorder.header, "rows": rows, "first": self._rows.first, "next": following}
        greeting |= {"now": self._now, "dropped": page.dropped, "state": self._state}
        greeting["may"] = [] if self._steering is None else ["pause", "speed", "inject"]
        await page.send(encoded(greeting))
        page.next = following

    async def _listen(self, page: "_Page") -> None:
        """Answer what a page asks, until it goes or says nothing that means anything."""
        mistakes = 0
        async for text in page.websocket.iter_text():
            asked: Any = None
            try:
                asked = json.loads(text)
                answer = self._answer(asked)
            except (KnowledgeBaseError, MissionError) as error:
                answer = {"error": str(error)}
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
                mistakes += 1
                answer = {"error": f"that is nothing a page says: {type(error).__name__}"}
            if answer is not None:
                number = asked.get("id") if isinstance(asked, dict) else None
                await page.send(encoded(answer if number is None else {"id": number, **answer}))
            if mistakes >= _MISTAKES:
                await page.websocket.close(1008, f"{mistakes} messages that mean nothing; goodbye")
                return

    def _answer(self, asked: Mapping[str, Any]) -> dict[str, Any] | None:
        if "past" in asked:
            start, end = map(int, asked["past"])
            start, rows = self._rows.since(start, max(0, min(end - start, _PAST)))
            return {"past": rows, "from": start}
        if asked.get("ask") == "whatif":
            situation = self._kb.situation(dict(asked.get("measured", {})), failed=list(asked.get("failed", ())))
            return {"whatif": {"t": self._now, **supposed(situation)}}
        if self._steering is None:
            raise MissionError("this page may look, and do nothing; in a simulation, --allow-control lets it")
        self._steering.do(asked)
        return None


class _Page:
    """A page that looks: the number of the row that it gets next, and how many it was too slow for."""

    def __init__(self, websocket: "WebSocket") -> None:
        self.websocket = websocket
        self.next = self.dropped = 0
        self._turn = asyncio.Lock()

    async def send(self, text: str) -> None:
        async with self._turn:
            await self.websocket.send_text(text)


def _is_this_machine(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _listening(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise MissionError(f"a port is a number from 0 (any that is free) to 65535, not {port}")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except OSError as error:
        said = os.strerror(error.errno) if error.errno else error
        raise MissionError(f"the live page cannot listen on {host}:{port}: {said}; give another port, or 0") from None
