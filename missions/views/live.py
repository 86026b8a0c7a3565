"""The live page: a small server in a thread of its own, which does not slow the robot's ticks.

For each page the server only keeps the number of the next row to send, so no queue can grow. A page
that is too slow gets the present state instead of the rows that it has missed, and is told how many
those were.
"""

import asyncio
import hmac
import json
import logging
import os
import socket
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from math import inf
from secrets import token_urlsafe
from threading import Condition, Thread
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import parse_qs, quote, urlsplit

from kb import KnowledgeBase, KnowledgeBaseError
from kb.elements import finite_number
from missions.engine.faults import read_fault
from missions.engine.mission import MissionError, needs
from missions.engine.runner import Listener, MissionRun
from missions.views.breakpoints import Breakpoint, Breakpoints
from missions.views.facts import supposed
from missions.views.recorder import Recorder
from missions.views.report import Row, encoded, page_of

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

PORT: Final = 8420
FASTEST: Final = 1000.0
"""The highest speed [times real time]."""
_LOOPBACK: Final = ("127.0.0.1", "localhost")
KEEP: Final = 100_000
"""How many rows a live page can look back at."""
BEAT_S: Final = 0.1
"""The period of sending new rows [s], wall clock."""
_SILENCE: Final = 10
"""After how many beats without new rows the pages are sent the time."""
_BEHIND: Final = 5_000
"""How many rows a page may be behind before it gets the present state instead."""
_PAST: Final = 20_000
"""The largest number of past rows in one answer."""
_LONGEST: Final = 65_536
"""The longest message that a page may send [bytes]."""
_MOST_PAGES: Final = 200
_PATIENCE_S: Final = 2.0
"""How long pages may take for the last rows when the view is closed [s], wall clock."""
_HEADERS: Final = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_SERVER: Final[dict[str, Any]] = {
    "compression": None,
    "max_size": _LONGEST,
    "server_header": None,
    "close_timeout": 1,
    "logger": logging.Logger("live page", logging.CRITICAL),  # a page is told its errors
}


class Steering(Listener):
    """Paces and pauses a simulated run, stops it at breakpoints, and injects faults.

    Args:
        run: which has not begun yet.
        speed: times real time; 0 for as fast as possible.
    """

    def __init__(self, run: MissionRun, speed: float = 1.0) -> None:
        self.breakpoints = Breakpoints(run, self._stop_at)
        self._run = run
        self._speed = _pace(speed)
        self._is_paused = False
        self._steps = 0
        self._stopped_at = ""
        self._change = Condition()
        self._start: tuple[float, float] | None = None

    @property
    def state(self) -> dict[str, Any]:
        """The pause, the place of the stop, the speed, the breakpoints and the injected values."""
        with self._change:
            return {
                "paused": self._is_paused,
                "stopped": self._stopped_at,
                "speed": self._speed,
                "held": dict(self._run.faults.values),
                "breaks": self.breakpoints.texts,
            }

    def do(self, request: Mapping[str, Any]) -> None:
        """Do what a page requests: `request["do"]` is pause, resume, step, speed, break or inject.

        Raises:
            MissionError, kb.UnknownName: there is no such command or element, or its value is not
                allowed.
        """
        what = request.get("do")
        with self._change:
            if what in ("pause", "resume"):
                self._is_paused = what == "pause"
                self._start = None
                self._steps = 0
                self._stopped_at = ""
            elif what == "step":
                self._is_paused = True
                self._steps += 1
            elif what == "speed":
                self._speed = _pace(request.get("value"))
                self._start = None
            elif what == "break":
                self.breakpoints.set(map(str, request["at"]))
            elif what == "inject":
                self._run.faults.add(read_fault(f"{request['fault']}@0"))
            else:
                known = "pause, resume, step, speed, break and inject"
                raise MissionError(f"{what!r} is unknown; known are {known}")
            self._change.notify_all()

    def _stop_at(self, breakpoint: Breakpoint, time_s: float) -> None:
        with self._change:
            self._is_paused = True
            self._start = None
            self._stopped_at = f"{breakpoint.text} at {time_s:.1f} s"

    def tick(self, run: MissionRun) -> None:
        with self._change:
            while (left := self._left(run.world.now)) > 0:
                self._change.wait(None if left == inf else left)
            self._steps = max(0, self._steps - 1)

    def _left(self, simulated: float) -> float:
        """Return how long the run must wait at a simulated time [s].

        Infinity while it is paused.
        """
        if self._is_paused:
            return 0.0 if self._steps else inf
        if not self._speed:
            return 0.0
        now = time.monotonic()
        self._start = self._start or (now, simulated)
        return self._start[0] + (simulated - self._start[1]) / self._speed - now


class LiveView(AbstractContextManager["LiveView"]):
    """Shows a robot in browsers while it works, in three lines of its own program.

        view = LiveView(kb, tree)
        print(view.url)
        ...                                  # the robot does its work
        view.close()

    It listens on this machine only; with another `host`, a page needs the token, which is part of
    `url`.

    Args:
        tree: the tree that decides; see `Recorder`, whose other arguments can be given too.
        port: TCP port; 0 for any that is free.
        token: the token that pages need; None for none on this machine, and a random one elsewhere.
        recorder: the recorder to show; None to make one.
        steering: lets pages control a simulated run; None if they may only look.

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
            import websockets  # noqa: F401  # used later, in the server's thread
        self._kb = kb
        self._steering = steering
        self._token = token if token is not None or host in _LOOPBACK else token_urlsafe(16)
        self._socket = _listening(host, port)
        port = self._socket.getsockname()[1]
        self._hosts = {f"{name}:{port}" for name in (*_LOOPBACK, host)}
        shown_host = socket.gethostname() if host == "0.0.0.0" else host
        query = f"?token={quote(self._token)}" if self._token else ""
        self._place = f"http://{shown_host}:{port}/"
        self.url = f"{self._place}{query}"
        self.recorder = recorder or Recorder(kb, tree, **{"keep": KEEP, "what_if": False, **shown})
        document = {"run": None, "live": {"socket": f"/ws{query}"}, "note": ""}
        self._page = page_of(document, str(self.recorder.header["title"]))
        self._rows = self.recorder.rows
        self._pages: set[ServerConnection] = set()
        self._end = self._rows.next
        self._frames: dict[int, str] = {}
        self._is_closing = False
        self._beat = asyncio.Event()
        self._thread = Thread(
            target=lambda: asyncio.run(self._serve()), name="live page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Send the pages the last rows, for 2 s at most, and stop listening."""
        if not self._is_closing:
            self.recorder.close()
            self._is_closing = True
            self._thread.join(_PATIENCE_S + 3.0)
            self._socket.close()

    def __exit__(self, *reason: object) -> None:
        self.close()

    # ---------------------------------------------------------------- the server's own thread

    async def _serve(self) -> None:
        """Wake the pages at each beat with new rows, until they have the last rows."""
        from websockets.asyncio.server import serve

        silent = 0
        closing_s = 0.0
        async with serve(self._attend, sock=self._socket, process_request=self._admit, **_SERVER):
            while not self._is_closing or (self._pages and closing_s <= _PATIENCE_S):
                silent += 1
                if self._rows.next > self._end or silent >= _SILENCE or self._is_closing:
                    silent = 0
                    self._end = self._rows.next
                    self._frames.clear()
                    waiting = self._beat
                    self._beat = asyncio.Event()
                    waiting.set()
                closing_s += BEAT_S * self._is_closing
                await asyncio.sleep(BEAT_S)

    def _framed(self, start: int) -> str:
        """Return the message with the rows up to the last beat, made once for all pages."""
        if start not in self._frames:
            self._frames[start] = self._message(self._rows.since(start, self._end - start)[1])
        return self._frames[start]

    def _message(self, rows: list[Row], **more: object) -> str:
        return encoded({"rows": rows, "now": self._now, "state": self._state, **more})

    @property
    def _state(self) -> dict[str, Any]:
        state = {"over": self._is_closing, "pages": len(self._pages)}
        return state if self._steering is None else state | self._steering.state

    @property
    def _now(self) -> float:
        return round(max(self._rows.now, self._kb.now), 3)

    def _refusal(self, headers: Mapping[str, str], token: str) -> str:
        """Return why a request is refused; empty if it is not."""
        host = headers.get("host", "")
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"a page from {origin} may not look at this robot; open {self._place} itself"
        if self._token is None:
            return "" if host in self._hosts else f"this is not {host}; open {self.url}"
        if hmac.compare_digest(token.encode(), self._token.encode()):
            return ""
        fault = "wrong" if token else "missing"
        return f"the token is {fault}; open the address that was printed when the view began"

    def _admit(self, connection: "ServerConnection", request: "Request") -> "Response | None":
        """Answer a request for the page, or refuse it; return None to open the WebSocket."""
        method = getattr(request, "method", "GET")  # before version 17 there is no other
        if method not in ("GET", "HEAD"):
            return connection.respond(405, "the page is only read: GET or HEAD\n")
        try:
            path = urlsplit(request.path)
            refusal = self._refusal(request.headers, parse_qs(path.query).get("token", [""])[0])
        except (LookupError, ValueError):  # a header twice, a malformed address or text
            words = f"the address, host or origin is malformed; open {self._place}\n"
            return connection.respond(400, words)
        if refusal:
            return connection.respond(403, refusal + "\n")
        if path.path == "/ws":
            if len(self._pages) < _MOST_PAGES:  # each takes a file descriptor of the robot
                return None
            return connection.respond(503, f"{_MOST_PAGES} pages are open already\n")
        if path.path != "/":
            return connection.respond(404, "\n")
        response = connection.respond(200, self._page)
        del response.headers["Content-Type"]
        response.headers.update(_HEADERS)
        if method == "HEAD":
            response.body = b""
        return response

    async def _attend(self, websocket: "ServerConnection") -> None:
        self._pages.add(websocket)
        showing = asyncio.create_task(self._show(websocket))
        try:
            await self._listen(websocket)
        finally:
            showing.cancel()
            self._pages.remove(websocket)

    async def _show(self, page: "ServerConnection") -> None:
        """Send the present, the past and then new rows as they come, as fast as a page takes them.

        A page that is too slow gets the present again instead of the rows that it has missed.
        """
        from websockets.exceptions import ConnectionClosed

        rows = self._rows
        dropped = 0
        with suppress(ConnectionClosed):
            latest, following = rows.snapshot()
            may = [] if self._steering is None else ["pause", "speed", "break", "inject"]
            await page.send(self._message(latest, hello=self.recorder.header, may=may))
            for start in range(rows.first, following, _PAST):
                past = rows.since(start, min(_PAST, following - start))[1]
                await page.send(self._message(past))
            while not (self._is_closing and following == rows.next):
                beat = self._beat
                if rows.next - following > _BEHIND:
                    dropped += rows.next - following
                    latest, following = rows.snapshot()
                    await page.send(self._message(latest, dropped=dropped))
                elif following < self._end or await beat.wait():
                    text = self._framed(following)
                    following = self._end
                    await page.send(text)
            await page.close(1000, "the view is closed")

    async def _listen(self, page: "ServerConnection") -> None:
        """Answer what a page asks, until it disconnects."""
        async for text in page:
            asked: Any = None
            try:
                asked = json.loads(text)
                answer = self._answer(asked)
            except (KnowledgeBaseError, MissionError) as error:
                answer = {"error": str(error)}
            except Exception as error:  # whatever a message that is no page's makes of it
                answer = {"error": f"that is not a message of a page: {type(error).__name__}"}
            if answer is not None:
                number = asked.get("id") if isinstance(asked, dict) else None
                await page.send(encoded({"id": number, **answer}))

    def _answer(self, asked: Mapping[str, Any]) -> dict[str, Any] | None:
        if asked.get("ask") == "whatif":
            situation = self._kb.situation(
                dict(asked.get("measured", {})),
                failed=list(asked.get("failed", ())),
                recovered=list(asked.get("recovered", ())),
            )
            return {"whatif": supposed(self._kb, situation)}
        if self._steering is None:
            raise MissionError(
                "this page may only watch; with --allow-control, pages may control a simulation"
            )
        self._steering.do(asked)
        return None


def _listening(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise MissionError(
            f"a port must be a number from 0 (any that is free) to 65535, not {port}"
        )
    try:
        return socket.create_server((host, port))
    except OSError as error:
        said = os.strerror(error.errno) if error.errno else error
        raise MissionError(
            f"the live page cannot listen on {host}:{port}: {said}; give another port, or 0"
        ) from None


def _pace(value: Any) -> float:  # noqa: ANN401  # whatever a page sends
    speed = finite_number(value)
    if 0 <= speed <= FASTEST:
        return speed
    raise MissionError(
        f"a speed must be from 0 (as fast as possible) to {FASTEST:g} times real time, "
        f"not {value!r}"
    )
