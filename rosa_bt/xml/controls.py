"""The control nodes, with the semantics of BehaviorTree.CPP 4.10 or Nav2, also where py_trees uses the same name."""

import sys
from contextlib import suppress
from typing import Any, ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.blackboard import converted
from rosa_bt.xml.nodes import DONE, FAILURE, MAX_NODES, RUNNING, SKIPPED, SUCCESS, Control, NodeError, Slot, Ticking


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
        start = self.children.index(self.current_child) if self.current_child in self.children else 0
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
            raise NodeError(f"{self.name!r} has {len(self.children)} children; {port} cannot be more")
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
                raise NodeError(f"the condition of {self.name!r} was skipped, so there is nothing to choose by")
            chosen = 1 if verdict is SUCCESS else 2
            for other in slots[3 - chosen : 4 - chosen] if self.asks_always else ():
                other.reset()
            if chosen == len(slots):  # IfThenElse leaves the condition finished: an action is not started again
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
        matching = (slot for number, slot in enumerate(cases, start=1) if self._is(f"case_{number}"))
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
        one, other = (str(enums.get(text, text)) for text in (self.ports.get("variable"), self.ports.get(case)))
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
    """(Nav2) Ticks the next child, until one succeeds or all failed; without `wrap_around`, ends at the last."""

    PORTS: ClassVar = {"wrap_around": PortInformation(bool, default_value=True)}
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
            if verdict is SUCCESS:
                self._failed = 0
                self.reset_children()
                return SUCCESS
            skipped += verdict is SKIPPED
            self._failed += verdict is FAILURE
            if self._next == 0 and not self.ports.get("wrap_around"):
                break
        return self.end(SKIPPED if skipped == len(slots) else FAILURE)


def _switch(cases: int) -> dict[str, Any]:
    names = ["variable", *(f"case_{number}" for number in range(1, cases + 1))]
    return {"PORTS": {name: PortInformation(str, required=False) for name in names}, "CHILDREN": (cases + 1, cases + 1)}


_KINDS: Final[dict[str, tuple[type[Control], dict[str, Any]]]] = {
    "Sequence": (_InOrder, {"goes_on": SUCCESS}),
    "AsyncSequence": (_InOrder, {"goes_on": SUCCESS, "is_async": True}),
    "SequenceWithMemory": (_InOrder, {"goes_on": SUCCESS, "is_async": True, "keeps_place": True}),
    "ReactiveSequence": (Reactive, {"goes_on": SUCCESS}),
    "Fallback": (_InOrder, {"goes_on": FAILURE}),
    "AsyncFallback": (_InOrder, {"goes_on": FAILURE, "is_async": True}),
    "ReactiveFallback": (Reactive, {"goes_on": FAILURE}),
    **{kind.__name__: (kind, {}) for kind in (Parallel, ParallelAll, TryCatch)},
    **{kind.__name__: (kind, {}) for kind in (RecoveryNode, PipelineSequence, RoundRobin)},
    "IfThenElse": (_Conditional, {}),
    "WhileDoElse": (_Conditional, {"asks_always": True}),
    **{f"Switch{cases}": (Switch, _switch(cases)) for cases in range(2, 7)},
}
CONTROLS: Final[dict[str, type[Control]]] = {tag: type(tag, (base,), how) for tag, (base, how) in _KINDS.items()}
