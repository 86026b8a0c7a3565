"""What a page may do to a simulation, with leave: hold it, let it go on by ticks, set its pace, disturb it."""

import time
from collections.abc import Mapping, Sequence
from math import inf
from threading import Condition
from typing import Any, Final

from kb import UnknownName
from kb.diagnostics import MEASUREMENTS
from kb.elements import finite_number
from missions.engine.mission import Message, MissionError
from missions.engine.recording import failed, measured, recovered
from missions.engine.runner import Listener, MissionRun

FASTEST: Final = 1000.0


class Steering(Listener):
    """Holds a simulated run to the pace that is asked for, and has it hear what is put in place of what was measured.

    Args:
        speed: times real time; 0 for as fast as it can.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = _pace(speed)
        self._is_paused = False
        self._steps = 0
        self._held: dict[str, float] = {}
        self._said: list[tuple[str, str]] = []
        self._change = Condition()
        self._start: tuple[float, float] | None = None
        self._attributes: frozenset[str] = frozenset()
        self._components: frozenset[str] = frozenset()

    @property
    def state(self) -> dict[str, Any]:
        """Whether it is held, how fast it goes, and what is put in place of what is measured."""
        with self._change:
            return {"paused": self._is_paused, "speed": self._speed, "held": dict(self._held)}

    def begin(self, run: MissionRun) -> None:
        self._attributes, self._components = frozenset(run.model.attributes), frozenset(run.model.components)
        run.alter = self.alter

    def do(self, asked: Mapping[str, Any]) -> None:
        """Do what a page asks for; see `docs/see_it.md`.

        Raises:
            MissionError, kb.UnknownName: there is no such thing to be done, or not with that.
        """
        what = asked.get("do")
        with self._change:
            if what in ("pause", "resume"):
                self._is_paused, self._start, self._steps = what == "pause", None, 0
            elif what == "step":
                self._is_paused, self._steps = True, self._steps + 1
            elif what == "speed":
                self._speed, self._start = _pace(asked.get("value")), None
            elif what == "inject":
                self._inject(asked)
            else:
                raise MissionError(f"{what!r} cannot be done; there are pause, resume, step, speed and inject")
            self._change.notify_all()

    def _inject(self, asked: Mapping[str, Any]) -> None:
        measured = dict(asked.get("measure", {}))
        values = {_known("attribute", one, self._attributes): finite_number(value) for one, value in measured.items()}
        released = [_known("attribute", one, self._attributes) for one in asked.get("release", ())]
        told = [(one, _known("component", asked[one], self._components)) for one in ("fail", "recover") if one in asked]
        self._held = {name: value for name, value in {**self._held, **values}.items() if name not in released}
        self._said += [("measure", name) for name in values] + told

    def alter(self, messages: Sequence[Message], now: float) -> Sequence[Message]:
        """Return what the robot hears in place of what was published by now [s]."""
        with self._change:
            said, self._said, held = self._said, [], dict(self._held)
        if held:
            messages = [_with(message, held) for message in messages]
        for what, name in said:
            if what == "measure":
                messages = [*messages, measured(now, **{name: held[name]})] if name in held else messages
            else:
                messages = [*messages, failed(now, name) if what == "fail" else recovered(now, name)]
        return messages

    def tick(self, run: MissionRun) -> None:
        with self._change:
            while (left := self._left(run.world.now)) > 0:
                self._change.wait(None if left == inf else left)
            self._steps = max(0, self._steps - 1)

    def _left(self, simulated: float) -> float:
        """Return how long the run has to wait at a simulated time [s]; infinity while it is held."""
        if self._is_paused or not self._speed:
            return inf if self._is_paused and not self._steps else 0.0
        now = time.monotonic()
        self._start = self._start or (now, simulated)
        return self._start[0] + (simulated - self._start[1]) / self._speed - now


def _with(message: Message, held: Mapping[str, float]) -> Message:
    """Return a message with other values in place of those that are held."""
    statuses = [
        {**one, "values": {key: repr(held[key]) if key in held else value for key, value in one["values"].items()}}
        if str(one["message"]).strip().casefold() in MEASUREMENTS
        else one
        for one in message["status"]
    ]
    return {**message, "status": statuses}


def _known(kind: str, name: Any, names: frozenset[str]) -> str:  # noqa: ANN401  # whatever a page sends
    if name in names:
        return str(name)
    raise UnknownName(kind, name, sorted(names))


def _pace(value: Any) -> float:  # noqa: ANN401  # whatever a page sends
    speed = finite_number(value)
    if 0 <= speed <= FASTEST:
        return speed
    raise MissionError(f"a speed is a number from 0 (as fast as it can) to {FASTEST:g} times real time, not {value!r}")
