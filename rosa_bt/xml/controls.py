"""Controls and decorators, with the semantics of BehaviorTree.CPP 4.10 or Nav2, also where py_trees has their names."""

import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.blackboard import PortError, converted, truth
from rosa_bt.xml.nodes import (
    DONE,
    FAILURE,
    LEAVES,
    MAX_NODES,
    RUNNING,
    SKIPPED,
    SUCCESS,
    Control,
    NodeError,
    OneChild,
    Slot,
    Ticking,
    XmlLeaf,
)
from rosa_bt.xml.scripts import parse_script


class _InOrder(Control):
    """Ticks one child after the other; `current_child` is the next one to tick, None the first.

    Attributes:
        goes_on: the outcome of a child after which the next child is ticked.
        is_async: be RUNNING for a tick after a child that ended in its first tick.
        keeps_place: keep `current_child` also when a child ends the node, and when the node is halted.
    """

    goes_on: ClassVar[Status]
    is_async: ClassVar = False
    keeps_place: ClassVar = False
    _skipped = 0

    def initialise(self) -> None:
        self._skipped = 0

    def forget(self) -> None:
        if not self.keeps_place:
            self.current_child = None

    def decide(self) -> Ticking:
        slots = self.slots
        start = (
            self.children.index(self.current_child) if self.current_child in self.children else 0
        )
        for index in range(start, len(slots)):
            slot = slots[index]
            self.current_child = slot.node
            was_idle = slot.status is SKIPPED
            verdict = yield from slot.tick()
            self._skipped += verdict is SKIPPED
            if verdict is RUNNING:
                return RUNNING
            if verdict not in (self.goes_on, SKIPPED):
                self.forget()
                for one in slots[index if self.keeps_place else 0 :]:
                    one.reset()
                return verdict
            if self.is_async and was_idle and verdict is not SKIPPED and index + 1 < len(slots):
                self.current_child = slots[index + 1].node
                return RUNNING
        self.reset_children()
        self.current_child = None
        skipped, self._skipped = self._skipped, 0
        return SKIPPED if skipped == len(slots) else self.goes_on


class Reactive(Control):
    """Ticks the children from the first in each tick; a running child resets and halts all others."""

    goes_on: ClassVar[Status]

    def decide(self) -> Ticking:
        skipped, slots = 0, self.slots
        for slot in slots:
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                self.reset_children(but=slot)
                return RUNNING
            if verdict is SKIPPED:
                skipped += 1
                slot.reset()
            elif verdict is not self.goes_on:
                return self.end(verdict)
        return self.end(SKIPPED if skipped == len(slots) else self.goes_on)


class Together(Control):
    """Ticks in each tick all children that have not finished."""

    is_side_by_side: ClassVar = True

    def _number(self, port: str) -> int:
        """Return the number of children in a port; a negative number counts from the end: -1 means all children."""
        said: int = self.ports.get(port)
        number = said if said >= 0 else max(len(self.children) + said + 1, 0)
        if number > len(self.children):
            raise NodeError(
                f"{self.name!r} has {len(self.children)} children; {port} cannot be more"
            )
        return number

    def _ended_with(self, verdict: Status) -> int:
        return sum(slot.status is verdict for slot in self.slots)


class Parallel(Together):
    """Ends as soon as enough children have succeeded or failed; the others are halted, or no longer ticked."""

    PORTS: ClassVar = {
        "success_count": PortInformation(int, default_value=-1),
        "failure_count": PortInformation(int, default_value=1),
    }

    def decide(self) -> Ticking:
        successes, failures = self._number("success_count"), self._number("failure_count")
        counts_skipped = self.ports.get("success_count") < 0
        skipped = 0
        for slot in self.slots:
            skipped += slot.status not in DONE and (yield from slot.tick()) is SKIPPED
            succeeded, failed = self._ended_with(SUCCESS), self._ended_with(FAILURE)
            if succeeded + skipped * counts_skipped >= successes:
                return self.end(SUCCESS)
            if len(self.children) - failed < successes or failed == failures:
                return self.end(FAILURE)
        return SKIPPED if skipped == len(self.children) else RUNNING


class ParallelAll(Together):
    """Ends when all children have finished: FAILURE if `max_failures` or more of them failed, else SUCCESS."""

    PORTS: ClassVar = {"max_failures": PortInformation(int, default_value=1)}

    def decide(self) -> Ticking:
        failures = self._number("max_failures")
        skipped = 0
        for slot in self.slots:
            skipped += slot.status not in DONE and (yield from slot.tick()) is SKIPPED
        failed = self._ended_with(FAILURE)
        if skipped == len(self.children):
            return SKIPPED
        if skipped + failed + self._ended_with(SUCCESS) < len(self.children):
            return RUNNING
        return self.end(FAILURE if failed >= failures else SUCCESS)


class _Conditional(Control):
    """Ticks the first child as a condition; if it succeeds, the second child, and if it fails, the third.

    Once it has ended, only the chosen child is ticked; but with `asks_always`, it is ticked in each tick.
    """

    CHILDREN = 2, 3
    FORGETS = ("_chosen",)
    asks_always: ClassVar = False
    _chosen = 0

    def decide(self) -> Ticking:
        slots = self.slots
        if self.asks_always or not self._chosen:
            verdict = yield from slots[0].tick()
            if verdict is RUNNING:
                return RUNNING
            if verdict is SKIPPED:
                if self.asks_always:
                    self.reset_children()
                raise NodeError(
                    f"the condition of {self.name!r} was skipped, so there is nothing to choose by"
                )
            chosen = 1 if verdict is SUCCESS else 2
            for other in slots[3 - chosen : 4 - chosen] if self.asks_always else ():
                other.reset()
            if chosen == len(
                slots
            ):  # IfThenElse leaves the condition finished: an action is not started again
                return self.end(FAILURE) if self.asks_always else FAILURE
            self._chosen = chosen
        verdict = yield from slots[self._chosen].tick()
        return verdict if verdict is RUNNING else self.end(verdict)


class Switch(Control):
    """Ticks the child whose case equals the variable, or else the last; there is a class for each number of cases."""

    runs = False
    FORGETS = ("_running",)
    _running: Slot | None = None

    def decide(self) -> Ticking:
        *cases, default = self.slots
        matching = (
            slot for number, slot in enumerate(cases, start=1) if self._is(f"case_{number}")
        )
        chosen = next(matching, default)
        if self._running is not None and self._running is not chosen:
            self._running.reset()
        verdict = yield from chosen.tick()
        self._running = chosen if verdict is RUNNING else None
        if verdict in (SUCCESS, FAILURE):
            self.reset_children()
        return verdict

    def _is(self, case: str) -> bool:
        """Tell whether a case equals the variable, as a text, or as the numbers at the beginning of both."""
        if not (self.ports.exists("variable") and self.ports.exists(case)):
            return False
        enums = self.ports.blackboard.enums
        one, other = (
            str(enums.get(text, text))
            for text in (self.ports.get("variable"), self.ports.get(case))
        )
        if one == other:
            return True
        for kind in (int, float):
            with suppress(ValueError):
                if abs(converted(one, kind) - converted(other, kind)) <= sys.float_info.epsilon:
                    return True
        return False


class TryCatch(Control):
    """A sequence of all but the last child; if one fails, the last child is ticked to its end: then FAILURE.

    With `catch_on_halt`, the last child is also ticked once when the node is halted before a child has failed.
    """

    CHILDREN = (2, MAX_NODES)
    PORTS: ClassVar = {"catch_on_halt": PortInformation(bool, default_value=False)}
    FORGETS = ("_place", "_skipped")
    _place = 0
    _skipped = 0

    def decide(self) -> Ticking:
        *tried, caught = self.slots
        while self._place < len(tried):
            verdict = yield from tried[self._place].tick()
            if verdict is RUNNING:
                return RUNNING
            self._skipped += verdict is SKIPPED
            self._place += 1
            if verdict is FAILURE:
                self.reset_children()
                self._place = len(self.slots)
            elif self._place == len(tried):
                return self.end(SKIPPED if self._skipped == len(tried) else SUCCESS)
        verdict = yield from caught.tick()
        return RUNNING if verdict is RUNNING else self.end(FAILURE)

    def stop(self, new_status: Status = Status.INVALID) -> None:
        *tried, caught = self.slots
        if self.ports.get("catch_on_halt") and self._place < len(tried):
            for slot in tried:
                slot.reset()
            for _ in caught.tick():
                pass
        super().stop(new_status)


class RecoveryNode(Control):
    """(Nav2) Ticks the first child; when it fails, the second, then the first again, `number_of_retries` times."""

    CHILDREN = (2, 2)
    PORTS: ClassVar = {"number_of_retries": PortInformation(int, default_value=1)}
    FORGETS = ("_retries", "_is_recovering")
    _retries = 0
    _is_recovering = False

    def decide(self) -> Ticking:
        task, recovery = self.slots
        allowed = self.ports.get("number_of_retries")
        while self._retries <= allowed:
            slot = recovery if self._is_recovering else task
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            if slot is task and verdict is FAILURE and self._retries < allowed:
                self._is_recovering = True
            elif slot is recovery and verdict in (SUCCESS, SKIPPED):
                self._is_recovering = False
            else:
                return self.end(verdict)
            slot.reset()
            if verdict is SKIPPED:
                return FAILURE
            self._retries += verdict is SUCCESS
        return self.end(FAILURE)


class PipelineSequence(Control):
    """(Nav2) A sequence that ticks earlier children again, and goes on even if one of them is RUNNING then."""

    FORGETS = ("_furthest",)
    _furthest = 0

    def decide(self) -> Ticking:
        skipped = 0
        for index, slot in enumerate(self.slots):
            verdict = yield from slot.tick()
            skipped += verdict is SKIPPED
            if verdict is RUNNING and index >= self._furthest:
                self._furthest = index
                return RUNNING
            if verdict is FAILURE:
                return self.end(FAILURE)
        return self.end(SKIPPED if skipped == len(self.children) else SUCCESS)


class RoundRobin(Control):
    """(Nav2) Ticks the next child, until one succeeds or all failed; without `wrap_around`, ends at the last.

    As in Nav2 1.5.1, the last child ends it as a failure without `wrap_around`, also by its success.
    """

    PORTS: ClassVar = {"wrap_around": PortInformation(bool, default_value=False)}
    FORGETS = ("_next", "_failed")
    _next = 0
    _failed = 0

    def decide(self) -> Ticking:
        slots = self.slots
        skipped = 0
        while self._failed + skipped < len(slots):
            verdict = yield from slots[self._next % len(slots)].tick()
            if verdict is RUNNING:
                return RUNNING
            self._next = (self._next + 1) % len(slots)
            skipped += verdict is SKIPPED
            self._failed += verdict is FAILURE
            if self._next == 0 and not self.ports.get("wrap_around"):
                break
            if verdict is SUCCESS:
                self._failed = 0
                self.reset_children()
                return SUCCESS
        return self.end(SKIPPED if skipped == len(slots) else FAILURE)


class NonblockingSequence(Control):
    """(Nav2) Ticks all children in each tick, until one fails or all have succeeded."""

    runs = False

    def decide(self) -> Ticking:
        succeeded = 0
        for slot in self.slots:
            verdict = yield from slot.tick()
            if verdict is FAILURE:
                return self.end(FAILURE)
            if verdict is SKIPPED:
                raise NodeError(
                    f"{slot.node.name!r} was skipped; {self.name!r} cannot skip a child"
                )
            succeeded += verdict is SUCCESS
        return self.end(SUCCESS) if succeeded == len(self.slots) else RUNNING


class PersistentSequence(Control):
    """(Nav2) A sequence that keeps its place on the blackboard, also when it is halted."""

    PORTS: ClassVar = {"current_child_idx": PortInformation(int)}

    def decide(self) -> Ticking:
        index = self.ports.get("current_child_idx")
        for slot in self.slots[index:]:
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            index = 0 if verdict is FAILURE else index + 1
            self.ports.set("current_child_idx", index)
            if verdict is FAILURE:
                return self.end(FAILURE)
        self.ports.set("current_child_idx", 0)
        return self.end(SUCCESS)


class PauseResumeController(Control):
    """(Nav2) Ticks the first child; while paused, the second; the third on a pause, the fourth on resuming.

    Nav2 pauses and resumes it by two services; here, `pause` and `resume` are called.
    """

    PORTS: ClassVar = {
        "pause_service_name": PortInformation(str, required=False),
        "resume_service_name": PortInformation(str, required=False),
    }
    CHILDREN = (1, 4)
    FORGETS = ("_state", "_has_request")
    _state = 0  # place of the child that is ticked: 0 resumed, 1 paused, 2 on pause, 3 on resume
    _has_request = False

    def pause(self) -> bool:
        """Pause from the next tick on; return False if it is paused already."""
        if self._state == 1:
            return False
        self._state = 2
        self._has_request = True
        return True

    def resume(self) -> bool:
        """Go on from the next tick on; return False if it is not paused."""
        if self._state != 1:
            return False
        self._state = 3
        self._has_request = True
        return True

    def initialise(self) -> None:
        self.forget()

    def decide(self) -> Ticking:
        if self._has_request:
            self._has_request = False
            self.reset_children()
        state = self._state
        verdict = RUNNING if state == 1 else SKIPPED
        if state < len(self.slots):
            verdict = yield from self.slots[state].tick()
        if verdict is RUNNING or verdict is FAILURE:
            return verdict
        if state == 0:
            return SUCCESS  # as in Nav2, a finished child is not begun again by the next start
        self._state = 0 if state == 3 else 1
        return RUNNING


def _switch(cases: int) -> dict[str, Any]:
    names = ["variable", *(f"case_{number}" for number in range(1, cases + 1))]
    return {
        "PORTS": {name: PortInformation(str, required=False) for name in names},
        "CHILDREN": (cases + 1, cases + 1),
    }


# ---------------------------------------------------------------- decorators


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
            raise PortError(
                f"the port {port!r} takes no negative number such as {self.ports.get(port)}"
            )

    def is_over(self) -> bool:
        """Start the time if it is not started, and tell whether it is over."""
        now = self.ports.blackboard.clock()
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

    PORTS: ClassVar = {
        "if": PortInformation(str),
        "else": PortInformation(Status, default_value=FAILURE),
    }
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
        self._since = self.ports.blackboard.clock()

    def decide(self) -> Ticking:
        if self._since is not None and not self._is_due and self.child.status is not RUNNING:
            self._is_due = (self.ports.blackboard.clock() - self._since) * self.ports.get(
                "hz"
            ) >= 1 - 1e-9
        verdict = yield from super().decide()
        if verdict is SUCCESS:
            self._since = self.ports.blackboard.clock()
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
        """Return the values of the ports; of one that is not written, the key of its name."""
        board = self.ports.blackboard
        return [board.get(self.ports.keys.get(name, name)) for name in self.PORTS]


_LOOPS: Final = {"Int": int, "Double": float, "Bool": bool, "String": str}


def _loop(of: type) -> dict[str, Any]:
    ports = {"queue": PortInformation(object), "value": PortInformation(of, required=False)}
    return {
        "of": of,
        "PORTS": {**ports, "if_empty": PortInformation(Status, default_value=SUCCESS)},
    }


_KINDS: Final[dict[str, tuple[type[Control | OneChild], dict[str, Any]]]] = {
    "Sequence": (_InOrder, {"goes_on": SUCCESS}),
    "AsyncSequence": (_InOrder, {"goes_on": SUCCESS, "is_async": True}),
    "SequenceWithMemory": (_InOrder, {"goes_on": SUCCESS, "is_async": True, "keeps_place": True}),
    "ReactiveSequence": (Reactive, {"goes_on": SUCCESS, "is_reactive_sequence": True}),
    "Fallback": (_InOrder, {"goes_on": FAILURE}),
    "AsyncFallback": (_InOrder, {"goes_on": FAILURE, "is_async": True}),
    "ReactiveFallback": (Reactive, {"goes_on": FAILURE}),
    **{kind.__name__: (kind, {}) for kind in (Parallel, ParallelAll, TryCatch)},
    **{kind.__name__: (kind, {}) for kind in (RecoveryNode, PipelineSequence, RoundRobin)},
    **{kind.__name__: (kind, {}) for kind in (NonblockingSequence, PersistentSequence)},
    "PauseResumeController": (PauseResumeController, {}),
    "IfThenElse": (_Conditional, {}),
    "WhileDoElse": (_Conditional, {"asks_always": True}),
    **{f"Switch{cases}": (Switch, _switch(cases)) for cases in range(2, 7)},
    "Inverter": (_Translated, {"outcomes": {SUCCESS: FAILURE, FAILURE: SUCCESS}}),
    "ForceSuccess": (_Translated, {"outcomes": {FAILURE: SUCCESS}}),
    "ForceFailure": (_Translated, {"outcomes": {SUCCESS: FAILURE}}),
    "KeepRunningUntilFailure": (_Translated, {"outcomes": {SUCCESS: RUNNING, SKIPPED: RUNNING}}),
    "Repeat": (_Again, {"once_more": SUCCESS, "PORTS": {"num_cycles": PortInformation(int)}}),
    "RetryUntilSuccessful": (
        _Again,
        {"once_more": FAILURE, "PORTS": {"num_attempts": PortInformation(int)}},
    ),
    **{kind.__name__: (kind, {}) for kind in (RunOnce, Delay, Timeout, Precondition)},
    **{
        kind.__name__: (kind, {}) for kind in (RateController, SingleTrigger, GoalUpdatedController)
    },
    "SkipUnlessUpdated": (_Updated, {"instead": SKIPPED}),
    "WaitValueUpdate": (_Updated, {"instead": RUNNING}),
    **{f"Loop{name}": (_Loop, _loop(of)) for name, of in _LOOPS.items()},
}
NODES: Final[Mapping[str, type[Control | OneChild | XmlLeaf]]] = {
    **{tag: type(tag, (base,), how) for tag, (base, how) in _KINDS.items()},
    **LEAVES,
}
"""The nodes of BehaviorTree.CPP and Nav2 by their tags, but for SubTree."""
