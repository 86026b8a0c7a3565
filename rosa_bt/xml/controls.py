"""Controls and decorators of BehaviorTree.CPP 4.10, and of Nav2 1.5.1, with their semantics.

Also where py_trees has nodes of the same name.
"""

from contextlib import suppress
from types import GenericAlias
from typing import Any, ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_bt.behaviours import Ticking
from rosa_bt.requests import FAILURE, RUNNING, SUCCESS
from rosa_bt.xml.blackboard import PortError, Ports
from rosa_bt.xml.nodes import (
    DONE,
    MAX_NODES,
    ROUNDING_S,
    SKIPPED,
    Control,
    NodeError,
    OneChild,
    Slot,
    port,
)
from rosa_bt.xml.scripts import parse_script
from rosa_bt.xml.values import converted, truth


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
        slots = self.slots
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
        for slot in self.slots:
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                self.reset_children(slot)
                return RUNNING
            if verdict is SKIPPED:
                skipped += 1
                slot.reset()
            elif verdict is not self.goes_on:
                return self.end(verdict)
        return self.end(SKIPPED if skipped == len(self.children) else self.goes_on)


class ReactiveFallback(ReactiveSequence):
    """Goes on after a failure."""

    goes_on = FAILURE
    is_reactive_sequence = False


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
            verdict = self.judge(skipped, *thresholds)
            if verdict is not None:
                return self.end(verdict)
        return SKIPPED if skipped == len(self.children) else RUNNING

    def judge(self, skipped: int, successes: int, failures: int) -> Status | None:
        """Return the outcome after a child was ticked, None if it is open."""
        failed = self.count_ended(FAILURE)
        counted = skipped if self.ports.get("success_count") < 0 else 0
        if self.count_ended(SUCCESS) + counted >= successes:
            return SUCCESS
        is_over = len(self.children) - failed < successes or failed == failures
        return FAILURE if is_over else None

    def count_ended(self, verdict: Status) -> int:
        return sum(slot.status is verdict for slot in self.slots)

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

    def judge(self, skipped: int, failures: int) -> Status | None:  # type: ignore[override]  # as many as PORTS
        failed = self.count_ended(FAILURE)
        ended = failed + self.count_ended(SUCCESS)
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
            with suppress(ValueError):
                if converted(left, kind) == converted(right, kind):
                    return True
        return False


for _cases in range(2, 7):
    _names = ["variable", *(f"case_{number + 1}" for number in range(_cases))]
    _children = {"CHILDREN": (_cases + 1, _cases + 1)}
    _ports = {name: port(str, required=False) for name in _names}
    type(f"Switch{_cases}", (Switch,), _children, **_ports)


class TryCatch(Control, catch_on_halt=port(bool, False)):
    """A sequence of all but the last child.

    If one fails, the last child is ticked to its end: then FAILURE.

    With `catch_on_halt`, the last child is also ticked once when the node is halted before a child
    has failed.
    """

    CHILDREN = (2, MAX_NODES)
    FORGETS = ("_place", "_skipped")
    _place = 0
    _skipped = 0

    def decide(self) -> Ticking:
        *tried, last = self.slots
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
        verdict = yield from last.tick()
        return RUNNING if verdict is RUNNING else self.end(FAILURE)

    def stop(self, new_status: Status = SKIPPED) -> None:
        last = self.slots[-1]
        if self.ports.get("catch_on_halt") and self._place < len(self.slots) - 1:
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
        verdict = yield from self.child.tick()
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


class RunOnce(OneChild, then_skip=port(bool, True)):
    """Ticks the child to its end, once.

    After that it is skipped, or with then_skip="false" returns that outcome.
    """

    _outcome = SKIPPED

    @property
    def runs(self) -> bool:  # type: ignore[override]  # depends on the state here
        return self._outcome is SKIPPED

    def decide(self) -> Ticking:
        if self.runs:
            verdict = yield from self.child.tick()
            self._outcome = verdict if verdict in DONE else SKIPPED
            return verdict
        return SKIPPED if self.ports.get("then_skip") else self._outcome


class Timed(OneChild, is_node=False):
    """A decorator with a duration, its only port, which counts from the tick in which it starts."""

    FORGETS: ClassVar[tuple[str, ...]] = ("_since",)
    _since: float | None = None

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        for name in ports.literals:
            if ports.get(name) < 0:
                raise PortError(f"the port {name!r} takes no negative number")

    def is_over(self) -> bool:
        """Start the time if it is not started, and tell whether it is over."""
        now = self.ports.blackboard.clock()
        if self._since is None:
            self._since = now
        return bool(now - self._since >= self.ports.get(*self.PORTS) / 1000 - ROUNDING_S)

    def tick_child(self) -> Ticking:
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.forget()
        return verdict


class Delay(Timed, delay_msec=port(int)):
    """Is RUNNING for `delay_msec` [ms]; then ticks the child."""

    def decide(self) -> Ticking:
        return (yield from self.tick_child()) if self.is_over() else RUNNING


class Timeout(Timed, msec=port(int)):
    """Halts the child, and fails, if it is RUNNING after `msec` [ms]; 0 is no limit."""

    FORGETS = ("_since", "_is_spent")
    _is_spent = False

    def decide(self) -> Ticking:
        is_late = self.is_over() and not self._is_spent and self.ports.get("msec") > 0
        self._is_spent |= is_late
        if is_late and self.child.status is RUNNING:
            return self.end(FAILURE)
        return (yield from self.tick_child())


class Precondition(OneChild, **{"if": port(str), "else": port(Status, FAILURE)}):
    """Ticks the child if the script `if` is true; else returns `else`.

    Once the child runs, `if` is not asked.
    """

    runs = False
    _is_begun = False

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        self._condition = parse_script(ports.get("if"))

    def decide(self) -> Ticking:
        instead: Status = self.ports.get("else")  # a wrong outcome raises in the first tick
        if not (self._is_begun or truth(self._condition(self.ports.blackboard))):
            return instead
        verdict = yield from self.child.tick()
        self._is_begun = verdict not in DONE
        return verdict


class SkipUnlessUpdated(OneChild, entry=port(object)):
    """Ticks the child to its end each time that an entry was written.

    Otherwise returns `instead`.
    """

    FORGETS = ("_goes_on",)
    runs = False
    instead = SKIPPED
    _goes_on = False

    def decide(self) -> Ticking:
        if not (self._goes_on or self.ports.is_updated("entry")):
            return self.instead
        verdict = yield from self.child.tick()
        self._goes_on = verdict is RUNNING
        return verdict


class WaitValueUpdate(SkipUnlessUpdated):
    """Is RUNNING until the entry was written."""

    instead = RUNNING


class Loop(OneChild, is_node=False):
    """Runs the child once for each element of a queue, one per tick.

    Returns `if_empty` in the tick after the last.
    """

    FORGETS = ("_goes_on",)
    runs = False
    _goes_on = False
    _left: tuple[Any, ...] = ()

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        if "queue" in ports.literals:
            self.initialise()  # raises if an element is wrong

    def initialise(self) -> None:
        self._goes_on = False
        queue = self.ports.get("queue")
        if isinstance(queue, str):
            queue = converted(queue, GenericAlias(list, self.PORTS["value"].data_type))
        self._left = tuple(queue)

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


_LOOPS = {"Int": int, "Double": float, "Bool": bool, "String": str}
for _name, _kind in _LOOPS.items():
    _value = port(_kind, required=False)
    type(
        f"Loop{_name}",
        (Loop,),
        {},
        queue=port(object),
        value=_value,
        if_empty=port(Status, SUCCESS),
    )


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


class PipelineSequence(Control):
    """A sequence that ticks earlier children again, and goes on even if one is RUNNING then."""

    FORGETS = ("_furthest",)
    _furthest = 0

    def decide(self) -> Ticking:
        skipped = 0
        for place, slot in enumerate(self.slots):
            verdict = yield from slot.tick()
            skipped += verdict is SKIPPED
            if verdict is RUNNING and place >= self._furthest:
                self._furthest = place
                return RUNNING
            if verdict is FAILURE:
                return self.end(FAILURE)
        return self.end(SKIPPED if skipped == len(self.children) else SUCCESS)


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
        start = self.ports.get("current_child_idx")
        for place, slot in enumerate(self.slots[start:], start + 1):
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            self.ports.set("current_child_idx", 0 if verdict is FAILURE else place)
            if verdict is FAILURE:
                return self.end(FAILURE)
        self.ports.set("current_child_idx", 0)
        return self.end(SUCCESS)


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
    FORGETS = ("_state", "_has_request")
    _state = 0  # place of the child that is ticked: 0 resumed, 1 paused, 2 on pause, 3 on resume
    _has_request = False

    def pause(self) -> bool:
        """Pause from the next tick on; return False if it is paused already."""
        return self._state != 1 and self._go(2)

    def resume(self) -> bool:
        """Go on from the next tick on; return False if it is not paused."""
        return self._state == 1 and self._go(3)

    def _go(self, state: int) -> bool:
        self._state = state
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
        if verdict in (RUNNING, FAILURE):
            return verdict
        if state == 0:
            return SUCCESS  # as in Nav2, a finished child is not begun again by the next start
        self._state = 0 if state == 3 else 1
        return RUNNING


class Anew(OneChild, is_node=False):
    """Ticks the child while it is RUNNING, at the start, and when a subclass says."""

    instead = RUNNING
    _is_due = True

    def initialise(self) -> None:
        self._is_due = True

    def decide(self) -> Ticking:
        if not self._is_due and self.child.status is not RUNNING:
            return self.instead
        self._is_due = False
        return (yield from self.child.tick())


class RateController(Anew, hz=port(float, 10.0)):
    """Ticks the child at the start, while it is RUNNING, and 1 / `hz` [s] after it succeeded."""

    _since = 0.0

    def decide(self) -> Ticking:
        clock = self.ports.blackboard.clock
        if not self._is_due and self.child.status is not RUNNING:
            self._is_due = (clock() - self._since) * self.ports.get("hz") >= 1 - ROUNDING_S
        verdict = yield from super().decide()
        if verdict is SUCCESS:
            self._since = clock()
        return verdict


class SingleTrigger(Anew):
    """Ticks the child to its end, once until this node is reset; FAILURE after that."""

    instead = FAILURE

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        self._is_due = verdict not in DONE
        return verdict


class GoalUpdatedController(Anew):
    """Ticks the child at the start, while it is RUNNING, and when `goal` or `goals` has changed."""

    PORTS: ClassVar = {name: port(object, required=False) for name in ("goal", "goals")}
    _before: object = None

    def decide(self) -> Ticking:
        board = self.ports.blackboard
        goals = [board.get(self.ports.keys.get(name, name)) for name in self.PORTS]
        self._is_due |= goals != self._before
        self._before = goals
        return (yield from super().decide())
