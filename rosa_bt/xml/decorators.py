"""The decorators, with the semantics of BehaviorTree.CPP 4.10 or Nav2, also where py_trees uses the same name."""

from contextlib import suppress
from typing import Any, ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.blackboard import PortError, converted, truth
from rosa_bt.xml.nodes import DONE, FAILURE, RUNNING, SKIPPED, SUCCESS, OneChild, Ticking
from rosa_bt.xml.scripts import parse_script


class _Translated(OneChild):
    """Returns another outcome for some outcomes of the child."""

    outcomes: ClassVar[dict[Status, Status]]

    def decide(self) -> Ticking:
        verdict = yield from self.child.tick()
        return self.outcomes.get(verdict, verdict)


class _Again(OneChild):
    """Ticks the child a number of times (-1: for ever): again in the same tick if it was RUNNING, else in the next."""

    once_more: ClassVar[Status]
    FORGETS = ("_count",)
    _count = 0

    def decide(self) -> Ticking:
        child, times = self.child, self.ports.get(*self.PORTS)
        while times == -1 or self._count < times:
            was_idle = child.status is SKIPPED
            verdict = yield from child.tick()
            if verdict is RUNNING:
                return RUNNING
            child.reset()
            if verdict is not self.once_more:
                self._count = self._count if verdict is SKIPPED else 0
                return verdict
            self._count += 1
            if was_idle and (times == -1 or self._count < times):
                return RUNNING
        self._count = 0
        return self.once_more


class RunOnce(OneChild):
    """Ticks the child to its end, once; after that it is skipped, or with then_skip="false" returns that outcome."""

    PORTS: ClassVar = {"then_skip": PortInformation(bool, default_value=True)}
    _outcome = SKIPPED

    @property
    def runs(self) -> bool:  # type: ignore[override]  # depends on the state here
        return self._outcome is SKIPPED

    def decide(self) -> Ticking:
        if self.runs:
            verdict = yield from self.child.tick()
            self._outcome = verdict if verdict in DONE else SKIPPED
            return verdict
        with suppress(PortError):  # anything but a bool counts as true
            return SKIPPED if self.ports.get("then_skip") else self._outcome
        return SKIPPED


class Timed(OneChild):
    """A decorator with a duration, its only port, which counts from the tick in which it starts."""

    FORGETS: ClassVar[tuple[str, ...]] = ("_since",)
    _since: float | None = None

    def prepare(self) -> None:
        (port,) = self.PORTS
        if port in self.ports.literals and self.ports.get(port) < 0:
            raise PortError(f"the port {port!r} takes no negative number such as {self.ports.get(port)}")

    def is_over(self) -> bool:
        """Start the time if it is not started, and tell whether it is over."""
        now = self.ports.clock()
        if self._since is None:
            self._since = now
        return bool(now - self._since >= self.ports.get(*self.PORTS) / 1000 - 1e-9)

    def tick_child(self) -> Ticking:
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.forget()
        return verdict


class Delay(Timed):
    """Is RUNNING for `delay_msec` [ms]; then ticks the child."""

    PORTS: ClassVar = {"delay_msec": PortInformation(int)}

    def decide(self) -> Ticking:
        return (yield from self.tick_child()) if self.is_over() else RUNNING


class Timeout(Timed):
    """Halts the child, and fails, if it is RUNNING after `msec` [ms]; 0 is no limit."""

    PORTS: ClassVar = {"msec": PortInformation(int)}
    FORGETS = ("_since", "_is_spent")
    _is_spent = False

    def decide(self) -> Ticking:
        is_late = self.is_over() and not self._is_spent and self.ports.get("msec") > 0
        self._is_spent |= is_late
        if is_late and self.child.status is RUNNING:
            return self.end(FAILURE)
        return (yield from self.tick_child())


class Precondition(OneChild):
    """Ticks the child if the script `if` is true; else returns `else`. Once the child runs, `if` is not asked."""

    PORTS: ClassVar = {"if": PortInformation(str), "else": PortInformation(Status, default_value=FAILURE)}
    runs = False
    _is_begun = False

    def prepare(self) -> None:
        self._condition = parse_script(self.ports.get("if"))

    def decide(self) -> Ticking:
        instead: Status = self.ports.get("else")  # a wrong outcome raises in the first tick
        self._is_begun = self._is_begun or truth(self._condition(self.ports.blackboard))
        if not self._is_begun:
            return instead
        verdict = yield from self.child.tick()
        self._is_begun = verdict not in DONE
        return verdict


class _Updated(OneChild):
    """Ticks the child to its end each time that an entry was written; otherwise SKIPPED or RUNNING."""

    PORTS: ClassVar = {"entry": PortInformation(object)}
    FORGETS = ("_goes_on",)
    runs = False
    instead: ClassVar[Status]
    _goes_on = False

    def decide(self) -> Ticking:
        if not (self._goes_on or self.ports.is_updated("entry")):
            return self.instead
        verdict = yield from self.child.tick()
        self._goes_on = verdict is RUNNING
        return verdict


class _Loop(OneChild):
    """Runs the child once for each element of a queue, one per tick; returns `if_empty` in the tick after the last."""

    of: ClassVar[type]
    FORGETS = ("_goes_on",)
    runs = False
    _goes_on = False
    _left: tuple[Any, ...] = ()

    def prepare(self) -> None:
        if "queue" in self.ports.literals:
            self._queue()

    def _queue(self) -> tuple[Any, ...]:
        found = self.ports.get("queue")
        return tuple(converted(found, list[self.of]) if isinstance(found, str) else found)  # type: ignore[name-defined]  # a class attribute as an argument of list

    def initialise(self) -> None:
        self._goes_on, self._left = False, self._queue()

    def decide(self) -> Ticking:
        if not self._goes_on:
            if not self._left:
                outcome: Status = self.ports.get("if_empty")
                return outcome
            self.ports.set("value", self._left[0])
            self._left = self._left[1:]
        verdict = yield from self.child.tick()
        self._goes_on = verdict is RUNNING
        return FAILURE if verdict is FAILURE else RUNNING


class _Anew(OneChild):
    """(Nav2) Ticks the child while it is RUNNING, and when it is due: at the start, or as a subclass says."""

    instead: ClassVar = RUNNING
    _is_due = True

    def initialise(self) -> None:
        self._is_due = True

    def decide(self) -> Ticking:
        if not self._is_due and self.child.status is not RUNNING:
            return self.instead
        self._is_due = False
        return (yield from self.child.tick())


class RateController(_Anew, Timed):
    """Ticks the child at the start, while it is RUNNING, and 1 / `hz` [s] after it succeeded."""

    PORTS: ClassVar = {"hz": PortInformation(float, default_value=10.0)}

    def initialise(self) -> None:
        super().initialise()
        self._since = self.ports.clock()

    def decide(self) -> Ticking:
        if self._since is not None and not self._is_due and self.child.status is not RUNNING:
            self._is_due = (self.ports.clock() - self._since) * self.ports.get("hz") >= 1 - 1e-9
        verdict = yield from super().decide()
        if verdict is SUCCESS:
            self._since = self.ports.clock()
        return verdict


class SingleTrigger(_Anew):
    """Ticks the child to its end, once until this node is reset; FAILURE after that."""

    instead = FAILURE

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        self._is_due = verdict not in DONE
        return verdict


class GoalUpdatedController(_Anew):
    """Ticks the child at the start, while it is RUNNING, and when `goal` or `goals` has changed."""

    PORTS: ClassVar = {name: PortInformation(object, required=False) for name in ("goal", "goals")}
    _known: object = None

    def initialise(self) -> None:
        super().initialise()
        self._known = self._goals()

    def decide(self) -> Ticking:
        known, self._known = self._known, self._goals()
        self._is_due |= known != self._known
        return (yield from super().decide())

    def _goals(self) -> list[object]:
        return [self.ports.get(name) if self.ports.exists(name) else None for name in self.PORTS]


_LOOPS: Final = {"Int": int, "Double": float, "Bool": bool, "String": str}


def _loop(of: type) -> dict[str, Any]:
    ports = {"queue": PortInformation(object), "value": PortInformation(of, required=False)}
    return {"of": of, "PORTS": {**ports, "if_empty": PortInformation(Status, default_value=SUCCESS)}}


_KINDS: Final[dict[str, tuple[type[OneChild], dict[str, Any]]]] = {
    "Inverter": (_Translated, {"outcomes": {SUCCESS: FAILURE, FAILURE: SUCCESS}}),
    "ForceSuccess": (_Translated, {"outcomes": {FAILURE: SUCCESS}}),
    "ForceFailure": (_Translated, {"outcomes": {SUCCESS: FAILURE}}),
    "KeepRunningUntilFailure": (_Translated, {"outcomes": {SUCCESS: RUNNING, SKIPPED: RUNNING}}),
    "Repeat": (_Again, {"once_more": SUCCESS, "PORTS": {"num_cycles": PortInformation(int)}}),
    "RetryUntilSuccessful": (_Again, {"once_more": FAILURE, "PORTS": {"num_attempts": PortInformation(int)}}),
    **{kind.__name__: (kind, {}) for kind in (RunOnce, Delay, Timeout, Precondition)},
    **{kind.__name__: (kind, {}) for kind in (RateController, SingleTrigger, GoalUpdatedController)},
    "SkipUnlessUpdated": (_Updated, {"instead": SKIPPED}),
    "WaitValueUpdate": (_Updated, {"instead": RUNNING}),
    **{f"Loop{name}": (_Loop, _loop(of)) for name, of in _LOOPS.items()},
}
DECORATORS: Final[dict[str, type[OneChild]]] = {tag: type(tag, (base,), how) for tag, (base, how) in _KINDS.items()}
