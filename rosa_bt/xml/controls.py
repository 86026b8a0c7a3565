"""Controls and decorators of BehaviorTree.CPP 4.10, and of Nav2 1.5.1, with their semantics.

Also where py_trees has nodes of the same name.
"""

from contextlib import suppress
from math import inf
from types import GenericAlias
from typing import ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_bt.behaviours import Ticking
from rosa_bt.requests import FAILURE, RUNNING, SUCCESS
from rosa_bt.xml.blackboard import NodeError, Ports, convert, truth
from rosa_bt.xml.nodes import DONE, ROUNDING_S, SKIPPED, Control, OneChild, Slot, port
from rosa_bt.xml.scripts import parse_script


class Sequence(Control):
    """Ticks one child after the other; `current_child` is the next one to tick, None the first.

    Attributes:
        goes_on: the outcome of a child after which the next child is ticked.
        is_async: be RUNNING for a tick after a child that ended in its first tick.
        keeps_place: keep `current_child` also when a child ends the node, and when the node is
            halted.
    """

    goes_on = SUCCESS
    is_async = False
    keeps_place = False
    FORGETS: ClassVar[tuple[str, ...]] = ("_skipped", "current_child")
    current_child: Behaviour | None = None
    _skipped = 0

    def decide(self) -> Ticking:
        return (yield from self.tick_in_order(self.slots))

    def tick_in_order(self, slots: list[Slot]) -> Ticking:
        start = 0
        if self.current_child in self.children:
            start = self.children.index(self.current_child)
        for place, slot in enumerate(slots[start:], start):
            self.current_child = slot.node
            was_idle = slot.status is SKIPPED
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            if verdict is SKIPPED:
                self._skipped += 1
            elif verdict is not self.goes_on:
                return self.end(verdict, *(slots[:place] if self.keeps_place else ()))
            elif self.is_async and was_idle and slot is not slots[-1]:
                self.current_child = slots[place + 1].node
                return RUNNING
        is_skipped = self._skipped == len(slots)
        self.current_child = None
        return self.end(SKIPPED if is_skipped else self.goes_on)


class AsyncSequence(Sequence):
    """Is RUNNING for a tick after each child."""

    is_async = True


class SequenceWithMemory(AsyncSequence):
    """Goes on where it was, also after a failure or a halt."""

    FORGETS = ("_skipped",)
    keeps_place = True


class Fallback(Sequence):
    """Goes on after a failure."""

    goes_on = FAILURE


class AsyncFallback(Fallback):
    """Is RUNNING for a tick after each child."""

    is_async = True


class ReactiveSequence(Control):
    """Ticks the children from the first in each tick.

    A running child resets and halts all others.
    """

    goes_on = SUCCESS
    is_reactive_sequence = True

    def decide(self) -> Ticking:
        skipped = 0
        for place, slot in enumerate(self.slots):
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                if self.waits_for(place):
                    return RUNNING
            elif verdict is SKIPPED:
                skipped += 1
                slot.reset()
            elif verdict is not self.goes_on:
                return self.end(verdict)
        return self.end(SKIPPED if skipped == len(self.children) else self.goes_on)

    def waits_for(self, place: int) -> bool:
        """Tell whether the tick ends at this child, which is RUNNING."""
        self.reset_children(self.slots[place])
        return True


class ReactiveFallback(ReactiveSequence):
    """Goes on after a failure."""

    goes_on = FAILURE
    is_reactive_sequence = False


class PipelineSequence(ReactiveSequence):
    """A sequence that ticks earlier children again, and goes on even if one is RUNNING then."""

    FORGETS = ("_furthest",)
    is_reactive_sequence = False
    _furthest = 0

    def waits_for(self, place: int) -> bool:
        is_late = place >= self._furthest
        self._furthest = max(place, self._furthest)
        return is_late


class Parallel(Control, success_count=port(int, -1), failure_count=port(int, 1)):
    """Ends as soon as enough children have succeeded or failed.

    The others are halted, or no longer ticked.
    """

    is_side_by_side = True

    def decide(self) -> Ticking:
        thresholds = [self._threshold(name) for name in self.PORTS]
        skipped = 0
        for slot in self.slots:
            if slot.status not in DONE:
                skipped += (yield from slot.tick()) is SKIPPED
            ended = [slot.status for slot in self.slots]
            counts = (skipped, ended.count(SUCCESS), ended.count(FAILURE))
            verdict = self.judge(*counts, *thresholds)
            if verdict is not None:
                return self.end(verdict)
        return SKIPPED if skipped == len(ended) else RUNNING

    def judge(
        self, skipped: int, succeeded: int, failed: int, successes: int, failures: int
    ) -> Status | None:
        """Return the outcome after a child was ticked, None if it is open."""
        counted = skipped if self.ports.get("success_count") < 0 else 0
        if succeeded + counted >= successes:
            return SUCCESS
        is_over = len(self.children) - failed < successes or failed == failures
        return FAILURE if is_over else None

    def _threshold(self, name: str) -> int:
        """Return the number of children in a port.

        A negative number counts from the end: -1 means all children.
        """
        count = len(self.children)
        number: int = self.ports.get(name)
        if number > count:
            raise NodeError(f"{self.name!r} has {count} children; {name} cannot be more")
        return number if number >= 0 else max(count + number + 1, 0)


class ParallelAll(Parallel, max_failures=port(int, 1)):
    """Ends when all children have finished: FAILURE if `max_failures` of them failed."""

    def judge(self, skipped: int, succeeded: int, failed: int, failures: int) -> Status | None:  # type: ignore[override]  # as many as PORTS
        ended = succeeded + failed
        if not ended or skipped + ended < len(self.children):
            return None
        return FAILURE if failed >= failures else SUCCESS


class IfThenElse(Control):
    """Ticks the first child as a condition.

    If it succeeds, the second child, and if it fails, the third.

    Once it has ended, only the chosen child is ticked; but with `asks_always`, it is ticked in each
    tick.
    """

    CHILDREN = (2, 3)
    FORGETS = ("_chosen",)
    asks_always = False
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
                    f"the condition of {self.name!r} was skipped: what is to be chosen?"
                )
            chosen = 1 if verdict is SUCCESS else 2
            if self.asks_always:
                self.reset_children(slots[0], *slots[chosen : chosen + 1])
            if chosen == len(
                slots
            ):  # IfThenElse leaves the condition finished: it is not started again
                return self.end(FAILURE) if self.asks_always else FAILURE
            self._chosen = chosen
        verdict = yield from slots[self._chosen].tick()
        return verdict if verdict is RUNNING else self.end(verdict)


class WhileDoElse(IfThenElse):
    """Ticks the condition in each tick."""

    asks_always = True


class Switch(Control, is_node=False):
    """Ticks the child whose case equals the variable, or else the last.

    There is a class for each number of cases.
    """

    runs = False
    FORGETS = ("_running",)
    _running: Slot | None = None

    def decide(self) -> Ticking:
        *cases, chosen = self.slots
        for number in range(len(cases), 0, -1):
            if self._matches(f"case_{number}"):
                chosen = cases[number - 1]
        if self._running is not None and self._running is not chosen:
            self._running.reset()
        verdict = yield from chosen.tick()
        self._running = chosen if verdict is RUNNING else None
        if verdict in DONE:
            self.reset_children()
        return verdict

    def _matches(self, case: str) -> bool:
        """Tell whether a case equals the variable, as a text or as the number it begins with."""
        ports = self.ports
        if not (ports.exists("variable") and ports.exists(case)):
            return False
        enums = ports.blackboard.root.enums
        left, right = (str(enums.get(text, text)) for text in map(ports.get, ("variable", case)))
        for kind in (str, int, float):
            with suppress(NodeError):
                if convert(left, kind) == convert(right, kind):
                    return True
        return False


for _count in range(3, 8):
    _names = ["variable", *(f"case_{number}" for number in range(1, _count))]
    _ports = {name: port(str, required=False) for name in _names}
    type(f"Switch{_count - 1}", (Switch,), {"CHILDREN": (_count, _count)}, **_ports)


class TryCatch(Sequence, catch_on_halt=port(bool, False)):
    """A sequence of all but the last child.

    If one fails, the last child is ticked to its end: then FAILURE.

    With `catch_on_halt`, the last child is also ticked once when the node is halted before a child
    has failed.
    """

    CHILDREN = (2, inf)
    FORGETS = (*Sequence.FORGETS, "_has_failed")
    _has_failed = False

    def decide(self) -> Ticking:
        *tried, last = self.slots
        if not self._has_failed:
            verdict = yield from self.tick_in_order(tried)
            if verdict is not FAILURE:
                return verdict
            self._has_failed = True
        verdict = yield from last.tick()
        return RUNNING if verdict is RUNNING else self.end(FAILURE)

    def stop(self, new_status: Status = SKIPPED) -> None:
        last = self.slots[-1]
        if self.ports.get("catch_on_halt") and not self._has_failed:
            self.reset_children(last)
            for _ in last.tick():
                pass
        super().stop(new_status)


class Translator(OneChild, is_node=False):
    """Returns another outcome for some outcomes of the child."""

    success = SUCCESS
    failure = FAILURE
    skipped = SKIPPED

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        outcomes = {SUCCESS: self.success, FAILURE: self.failure, SKIPPED: self.skipped}
        return outcomes.get(verdict, verdict)


class Inverter(Translator):
    """Returns SUCCESS for FAILURE, and FAILURE for SUCCESS."""

    success = FAILURE
    failure = SUCCESS


class ForceSuccess(Translator):
    """Returns SUCCESS for FAILURE."""

    failure = SUCCESS


class ForceFailure(Translator):
    """Returns FAILURE for SUCCESS."""

    success = FAILURE


class KeepRunningUntilFailure(Translator):
    """Returns RUNNING for all but FAILURE."""

    success = RUNNING
    skipped = RUNNING


class Repeat(OneChild, num_cycles=port(int)):
    """Ticks the child a number of times (-1: for ever), in the same tick if it was RUNNING."""

    FORGETS = ("_count",)
    once_more = SUCCESS
    _count = 0

    def decide(self) -> Ticking:
        child = self.child
        times = self.ports.get(*self.PORTS)
        while times == -1 or self._count < times:
            was_idle = child.status is SKIPPED
            verdict = yield from child.tick()
            if verdict is RUNNING:
                return RUNNING
            child.reset()
            if verdict is SKIPPED:
                return SKIPPED
            if verdict is not self.once_more:
                return self.end(verdict)
            self._count += 1
            if was_idle and self._count != times:
                return RUNNING
        return self.end(self.once_more)


class RetryUntilSuccessful(Repeat, num_attempts=port(int)):
    """Ticks the child again after a failure."""

    once_more = FAILURE


class Gate(OneChild, is_node=False):
    """Starts the child when the gate is open, and ticks it while it is RUNNING."""

    FORGETS: ClassVar[tuple[str, ...]] = ("_last",)
    runs = False
    closed = SKIPPED
    _last: Status | None = None
    """The outcome of the child when it was ticked last."""

    def instead(self) -> Status | None:
        """Return the outcome if the child does not start now, None if it does: the first time."""
        return None if self._last is None else self.closed

    def decide(self) -> Ticking:
        verdict = None if self._last is RUNNING else self.instead()
        if verdict is None:
            verdict = self._last = yield from super().decide()
        return verdict


class RunOnce(Gate, then_skip=port(bool, True)):
    """Ticks the child to its end, once.

    After that it is skipped, or with then_skip="false" returns that outcome.
    """

    FORGETS = ()

    @property
    def runs(self) -> bool:  # type: ignore[override]  # depends on the state here
        return self._last not in DONE

    def instead(self) -> Status | None:
        if self.runs:
            return None
        return SKIPPED if self.ports.get("then_skip") else self._last


class Precondition(Gate, **{"if": port(str), "else": port(Status, FAILURE)}):
    """Ticks the child if the script `if` is true; else returns `else`.

    Once the child runs, `if` is not asked.
    """

    FORGETS = ()

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        self._condition = parse_script(ports.get("if"), ports.blackboard)

    def instead(self) -> Status | None:
        verdict: Status = self.ports.get("else")  # a wrong outcome raises in the first tick
        return None if self._last is SKIPPED or truth(self._condition()) else verdict


class SkipUnlessUpdated(Gate, entry=port(None)):
    """Ticks the child to its end each time that an entry was written; otherwise it is skipped."""

    def instead(self) -> Status | None:
        return None if self.ports.is_updated("entry") else self.closed


class WaitValueUpdate(SkipUnlessUpdated):
    """Is RUNNING until the entry was written."""

    closed = RUNNING


class Loop(Gate, is_node=False):
    """Runs the child once for each element of a queue, one per tick.

    Returns `if_empty` in the tick after the last.
    """

    def initialise(self) -> None:
        queue = self.ports.get("queue")
        if isinstance(queue, str):
            queue = convert(queue, GenericAlias(list, self.PORTS["value"].data_type))
        self._left = list(queue)

    def instead(self) -> Status | None:
        if self._left:
            self.ports.set("value", self._left.pop(0))
            return None
        outcome: Status = self.ports.get("if_empty")
        return outcome

    def decide(self) -> Ticking:
        is_over = not self._left and self._last is not RUNNING
        verdict = yield from super().decide()
        return verdict if is_over or verdict is FAILURE else RUNNING


for _name, _kind in {"Int": int, "Double": float, "Bool": bool, "String": str}.items():
    _ports = {
        "queue": port(None),
        "value": port(_kind, required=False),
        "if_empty": port(Status, SUCCESS),
    }
    type(f"Loop{_name}", (Loop,), {}, **_ports)


class Timed(OneChild, is_node=False):
    """A decorator with a duration, its only port, which counts from the tick in which it starts."""

    FORGETS: ClassVar[tuple[str, ...]] = ("_since",)
    _since: float | None = None

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        if any(ports.get(name) < 0 for name in ports.literals):
            raise NodeError("it takes no negative number")

    def is_over(self) -> bool:
        """Start the time if it is not started, and tell whether it is over."""
        now = self.ports.blackboard.root.clock()
        if self._since is None:
            self._since = now
        return bool(now - self._since >= self.ports.get(*self.PORTS) / 1000 - ROUNDING_S)

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        if verdict in DONE:
            self.forget()
        return verdict


class Delay(Timed, delay_msec=port(int)):
    """Is RUNNING for `delay_msec` [ms]; then ticks the child."""

    def decide(self) -> Ticking:
        return (yield from super().decide()) if self.is_over() else RUNNING


class Timeout(Timed, msec=port(int)):
    """Halts the child, and fails, if it is RUNNING after `msec` [ms]; 0 is no limit."""

    FORGETS = ("_since", "_is_spent")
    _is_spent = False

    def decide(self) -> Ticking:
        is_late = self.is_over() and not self._is_spent and self.ports.get("msec") > 0
        self._is_spent |= is_late
        if is_late and self.child.status is RUNNING:
            return self.end(FAILURE)
        return (yield from super().decide())


class RateController(Gate, hz=port(float, 10.0)):
    """Ticks the child at the start, while it is RUNNING, and 1 / `hz` [s] after it succeeded."""

    runs = True
    closed = RUNNING
    _since = 0.0

    def initialise(self) -> None:
        self.forget()

    def instead(self) -> Status | None:
        elapsed = self.ports.blackboard.root.clock() - self._since
        return None if elapsed * self.ports.get("hz") >= 1 - ROUNDING_S else super().instead()

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        if verdict is SUCCESS:
            self._since = self.ports.blackboard.root.clock()
        return verdict


class SingleTrigger(Gate):
    """Ticks the child to its end, once until this node is reset; FAILURE after that."""

    runs = True

    def initialise(self) -> None:
        self.forget()

    def instead(self) -> Status | None:
        return FAILURE if self._last in DONE else None


class GoalUpdatedController(Gate):
    """Ticks the child at the start, while it is RUNNING, and when `goal` or `goals` has changed."""

    PORTS: ClassVar = {name: port(None, required=False) for name in ("goal", "goals")}
    runs = True
    closed = RUNNING
    _before: object = None

    def initialise(self) -> None:
        self.forget()

    def decide(self) -> Ticking:
        board = self.ports.blackboard
        goals = [board.get(self.ports.keys.get(name, name)) for name in self.PORTS]
        if goals != self._before and self._last is not RUNNING:
            self.forget()
        self._before = goals
        return (yield from super().decide())


class RecoveryNode(Control, number_of_retries=port(int, 1)):
    """Ticks the first child; when it fails, the second, then the first again, some times."""

    CHILDREN = (2, 2)
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
            if slot is task and (verdict is not FAILURE or self._retries == allowed):
                return self.end(verdict)
            if slot is recovery and verdict is FAILURE:
                return self.end(FAILURE)
            self._is_recovering = slot is task
            slot.reset()
            if verdict is SKIPPED:
                return FAILURE
            self._retries += slot is recovery
        return self.end(FAILURE)


class RoundRobin(Control, wrap_around=port(bool, False)):
    """Ticks the next child, until one succeeds or all failed.

    Without `wrap_around`, ends at the last.

    As in Nav2 1.5.1, the last child ends it as a failure without `wrap_around`, also by its
    success.
    """

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
    """Ticks all children in each tick, until one fails or all have succeeded."""

    runs = False

    def decide(self) -> Ticking:
        is_open = False
        for slot in self.slots:
            verdict = yield from slot.tick()
            if verdict is FAILURE:
                return self.end(FAILURE)
            if verdict is SKIPPED:
                raise NodeError(
                    f"{slot.node.name!r} was skipped; {self.name!r} cannot skip a child"
                )
            is_open |= verdict is RUNNING
        return RUNNING if is_open else self.end(SUCCESS)


class PersistentSequence(Control, current_child_idx=port(int)):
    """A sequence that keeps its place on the blackboard, also when it is halted."""

    def decide(self) -> Ticking:
        start = self.ports.get(*self.PORTS)
        verdict = SUCCESS
        for place, slot in enumerate(self.slots[start:], start):
            self.ports.set("current_child_idx", place)
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            if verdict is FAILURE:
                break
        self.ports.set("current_child_idx", 0)
        return self.end(FAILURE if verdict is FAILURE else SUCCESS)


class PauseResumeController(
    Control,
    pause_service_name=port(str, required=False),
    resume_service_name=port(str, required=False),
):
    """Ticks the first child; while paused, the second.

    The third on a pause, the fourth on resuming.

    Nav2 pauses and resumes it by two services; here, `pause` and `resume` are called.
    """

    CHILDREN = (1, 4)
    FORGETS = ("_state", "_next")
    _state = 0  # place of the child that is ticked: 0 resumed, 1 paused, 2 on pause, 3 on resume
    _next: int | None = None

    def pause(self) -> None:
        """Pause from the next tick on, unless it is paused."""
        self._next = None if self._state == 1 else 2

    def resume(self) -> None:
        """Go on from the next tick on, if it is paused."""
        self._next = 3 if self._state == 1 else None

    def initialise(self) -> None:
        self.forget()

    def decide(self) -> Ticking:
        if self._next is not None:
            self._state = self._next
            self._next = None
            self.reset_children()
        state = self._state
        verdict = RUNNING if state == 1 else SKIPPED
        if state < len(self.slots):
            verdict = yield from self.slots[state].tick()
        if verdict in (RUNNING, FAILURE):
            return verdict
        if state == 0:
            return SUCCESS  # as in Nav2, a finished child is not begun again by the next start
        self._state = 0 if state == 3 else 1
        return RUNNING
