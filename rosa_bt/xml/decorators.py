"""The decorators, each with the semantics of BehaviorTree.CPP 4.10, not of py_trees' namesake."""

from collections.abc import Sequence
from typing import Any, ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.blackboard import Outcome, PortError, converted, truth
from rosa_bt.xml.nodes import DONE, FAILURE, RUNNING, SKIPPED, SUCCESS, OneChild, Slot, Ticking
from rosa_bt.xml.ports import Ports
from rosa_bt.xml.scripts import parse_script


class _Translated(OneChild):
    """The outcome of the child, called something else."""

    outcomes: ClassVar[dict[Status, Status]]

    def decide(self) -> Ticking:
        verdict = yield from self.child.tick()
        return self.outcomes.get(verdict, verdict)


_TRANSLATED: Final[dict[str, dict[Status, Status]]] = {
    "Inverter": {SUCCESS: FAILURE, FAILURE: SUCCESS},
    "ForceSuccess": {FAILURE: SUCCESS},
    "ForceFailure": {SUCCESS: FAILURE},
    "KeepRunningUntilFailure": {SUCCESS: RUNNING, SKIPPED: RUNNING},
}


class _Again(OneChild):
    """The child again and again: in the same tick if it has been RUNNING, at the next tick if it ended in its first."""

    once_more: ClassVar[Status]
    port: ClassVar[str]
    FORGETS = ("_count",)
    _count = 0

    def decide(self) -> Ticking:
        child = self.child
        while self._is_left():
            was_idle = child.status is SKIPPED
            verdict = yield from child.tick()
            if verdict is RUNNING:
                return RUNNING
            child.reset()
            if verdict is not self.once_more:
                self._count = self._count if verdict is SKIPPED else 0
                return verdict
            self._count += 1
            if was_idle and self._is_left():
                return RUNNING
        self._count = 0
        return self.once_more

    def _is_left(self) -> bool:
        times: int = self.ports.get(self.port)
        return times == -1 or self._count < times


class Repeat(_Again):
    """Until the child fails, or has succeeded so many times; -1 is for ever."""

    once_more, port = SUCCESS, "num_cycles"
    PORTS: ClassVar = {"num_cycles": PortInformation(int)}


class RetryUntilSuccessful(_Again):
    """Until the child succeeds, or has failed so many times; -1 is for ever."""

    once_more, port = FAILURE, "num_attempts"
    PORTS: ClassVar = {"num_attempts": PortInformation(int)}


class RunOnce(OneChild):
    """The child to its end, once; after that skipped, or with then_skip="false" the same outcome again."""

    PORTS: ClassVar = {"then_skip": PortInformation(bool, default_value=True)}
    _outcome = SKIPPED

    @property
    def runs(self) -> bool:  # type: ignore[override]  # here it depends on what was done
        return self._outcome is SKIPPED

    def decide(self) -> Ticking:
        if not self.runs:
            return SKIPPED if self.ports.get("then_skip") else self._outcome
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self._outcome = verdict
        return verdict


class Timed(OneChild):
    """A decorator that looks at the clock; the time counts from the tick in which it begins."""

    port: ClassVar[str]
    FORGETS: ClassVar[tuple[str, ...]] = ("_since",)
    _since: float | None = None

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name, slots, ports)
        if ports.is_literal(self.port) and ports.get(self.port) < 0:
            raise PortError(f"the port {self.port!r} takes no negative number, as {ports.get(self.port)} is")

    def is_over(self) -> bool:
        """Begin if need be, and tell whether the time is over."""
        now = self.ports.clock()
        if self._since is None:
            self._since = now
        return bool(now - self._since >= self.ports.get(self.port) / 1000 - 1e-9)


class Delay(Timed):
    """Waits first; then ticks the child."""

    port = "delay_msec"
    PORTS: ClassVar = {"delay_msec": PortInformation(int)}

    def decide(self) -> Ticking:
        if not self.is_over():
            return RUNNING
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.forget()
        return verdict


class Timeout(Timed):
    """FAILURE if the child is still running when the time is over: it is halted then. 0 is no limit."""

    port = "msec"
    PORTS: ClassVar = {"msec": PortInformation(int)}
    FORGETS = ("_since", "_is_spent")
    _is_spent = False

    def decide(self) -> Ticking:
        if self.is_over() and not self._is_spent and self.ports.get("msec") > 0:
            self._is_spent = True
            if self.child.status is RUNNING:
                self.child.reset()
                self.forget()
                return FAILURE
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.forget()
        return verdict


class Precondition(OneChild):
    """The child if a script says so, which is asked until it has begun; otherwise what `else` says."""

    PORTS: ClassVar = {"if": PortInformation(str), "else": PortInformation(Outcome, default_value=Outcome.FAILURE)}
    runs = False
    _is_begun = False

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name, slots, ports)
        self._condition = parse_script(ports.get("if"))

    def decide(self) -> Ticking:
        otherwise: Status = self.ports.get("else").value
        self._is_begun = self._is_begun or truth(self._condition(self.ports.blackboard))
        if not self._is_begun:
            return otherwise
        verdict = yield from self.child.tick()
        self._is_begun = verdict not in DONE
        return verdict


class _Updated(OneChild):
    """The child, to its end, each time that an entry was written since this asked last; else SKIPPED, or RUNNING."""

    PORTS: ClassVar = {"entry": PortInformation(object)}
    FORGETS = ("_goes_on",)
    runs = False
    instead: ClassVar[Status]
    _goes_on = False
    _version = 0

    def decide(self) -> Ticking:
        if not self._goes_on:
            before, self._version = self._version, self.ports.version("entry", self._version)
            if self._version == before:
                return self.instead
        verdict = yield from self.child.tick()
        self._goes_on = verdict is RUNNING
        return verdict


class _Loop(OneChild):
    """The child once for each element of a queue, one in a tick, and `if_empty` in the tick after the last."""

    of: ClassVar[type]
    FORGETS = ("_goes_on",)
    runs = False
    _goes_on = False
    _left: tuple[Any, ...] = ()

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name, slots, ports)
        if ports.is_literal("queue"):
            self._queue()

    def _queue(self) -> tuple[Any, ...]:
        found = self.ports.get("queue")
        return tuple(converted(found, list[self.of]) if isinstance(found, str) else found)  # type: ignore[name-defined]  # a class attribute as an argument of list

    def initialise(self) -> None:
        self._goes_on, self._left = False, self._queue()

    def decide(self) -> Ticking:
        if not self._goes_on:
            if not self._left:
                return Status(self.ports.get("if_empty").value)
            self.ports.set("value", self._left[0])
            self._left = self._left[1:]
        verdict = yield from self.child.tick()
        self._goes_on = verdict is RUNNING
        return FAILURE if verdict is FAILURE else RUNNING


def _loop(name: str, of: type) -> type[_Loop]:
    ports = {"queue": PortInformation(object), "value": PortInformation(of, required=False)}
    ports["if_empty"] = PortInformation(Outcome, default_value=Outcome.SUCCESS)
    return type(name, (_Loop,), {"PORTS": ports, "of": of})


_LOOPS: Final = {"LoopInt": int, "LoopDouble": float, "LoopBool": bool, "LoopString": str}
DECORATORS: Final[dict[str, type[OneChild]]] = {
    **{tag: type(tag, (_Translated,), {"outcomes": outcomes}) for tag, outcomes in _TRANSLATED.items()},
    **{kind.__name__: kind for kind in (Repeat, RetryUntilSuccessful, RunOnce, Delay, Timeout, Precondition)},
    "SkipUnlessUpdated": type("SkipUnlessUpdated", (_Updated,), {"instead": SKIPPED}),
    "WaitValueUpdate": type("WaitValueUpdate", (_Updated,), {"instead": RUNNING}),
    **{name: _loop(name, of) for name, of in _LOOPS.items()},
}
"""By tag."""
