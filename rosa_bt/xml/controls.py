"""The control nodes, each with the semantics of BehaviorTree.CPP 4.10, not of py_trees' namesake."""

import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.nodes import DONE, FAILURE, MAX_NODES, RUNNING, SKIPPED, SUCCESS, Control, NodeError, Slot, Ticking


class _InOrder(Control):
    """One child after the other; `current_child` is where it has got to, None is the beginning."""

    goes_on: ClassVar[Status]
    is_async: ClassVar = False
    _skipped = 0

    def initialise(self) -> None:
        self._skipped = 0

    def forget(self) -> None:
        self.current_child = None

    def decide(self) -> Ticking:
        slots = self.slots
        index = self.children.index(self.current_child) if self.current_child in self.children else 0
        while index < len(slots):
            slot = slots[index]
            was_idle = slot.status is SKIPPED
            verdict = yield from slot.tick()
            self._skipped += verdict is SKIPPED
            if verdict is RUNNING:
                self.current_child = slot.node
                return RUNNING
            if verdict not in (self.goes_on, SKIPPED):
                self._give_up(index)
                return verdict
            index += 1
            if index < len(slots):
                self.current_child = slots[index].node
                if self.is_async and was_idle and verdict is not SKIPPED:
                    return RUNNING
        self.reset_children()
        self.current_child = None
        skipped, self._skipped = self._skipped, 0
        return SKIPPED if skipped == len(slots) else self.goes_on

    def _give_up(self, index: int) -> None:
        self.reset_children()
        self.current_child = None


class Sequence(_InOrder):
    """Until one fails; goes on where it was while a child is running."""

    goes_on = SUCCESS


class AsyncSequence(Sequence):
    """Like Sequence; RUNNING between two children of which the first succeeded in its first tick."""

    is_async = True


class SequenceWithMemory(AsyncSequence):
    """Like AsyncSequence; keeps its place when a child fails and when it is halted."""

    def forget(self) -> None:
        """Keep the place."""

    def _give_up(self, index: int) -> None:
        slots = self.slots
        self.current_child = slots[index].node
        for slot in slots[index:]:
            slot.reset()


class Fallback(_InOrder):
    """Until one succeeds; goes on where it was while a child is running."""

    goes_on = FAILURE


class AsyncFallback(Fallback):
    """Like Fallback; RUNNING between two children of which the first failed in its first tick."""

    is_async = True


class _Reactive(Control):
    """Every child from the first at each tick; one that is running halts and resets the others."""

    goes_on: ClassVar[Status]

    def decide(self) -> Ticking:
        all_skipped = True
        slots = self.slots
        for slot in slots:
            self.current_child = slot.node
            verdict = yield from slot.tick()
            all_skipped &= verdict is SKIPPED
            if verdict is RUNNING:
                for other in slots:
                    if other is not slot:
                        other.reset()
                return RUNNING
            if verdict is SKIPPED:
                slot.reset()
            elif verdict is not self.goes_on:
                self.reset_children()
                return verdict
        self.reset_children()
        return SKIPPED if all_skipped else self.goes_on


class ReactiveSequence(_Reactive):
    """Until one fails or is running."""

    goes_on = SUCCESS


class ReactiveFallback(_Reactive):
    """Until one succeeds or is running."""

    goes_on = FAILURE


class Together(Control):
    """All children at each tick, but those that have finished."""

    FORGETS = ("_ended",)
    _ended: Mapping[Slot, Status] = MappingProxyType({})

    def _number(self, port: str) -> int:
        """Return the number of children that a port says; a negative one counts from all of them: -1 is all."""
        said: int = self.ports.get(port)
        number = said if said >= 0 else max(len(self.children) + said + 1, 0)
        if number > len(self.children):
            raise NodeError(f"{self.name!r} has {len(self.children)} children; {port} cannot be more")
        return number

    def _go_on(self, slot: Slot) -> Ticking:
        if slot in self._ended:
            return self._ended[slot]
        verdict = yield from slot.tick()
        if verdict in DONE:
            self._ended = {**self._ended, slot: verdict}
        return verdict

    def _ended_with(self, verdict: Status) -> int:
        return sum(self._ended.get(slot) is verdict for slot in self.slots)


class Parallel(Together):
    """SUCCESS or FAILURE as soon as enough children have succeeded or failed; the rest are halted, or not ticked."""

    PORTS: ClassVar = {
        "success_count": PortInformation(int, default_value=-1),
        "failure_count": PortInformation(int, default_value=1),
    }

    def decide(self) -> Ticking:
        successes, failures = self._number("success_count"), self._number("failure_count")
        counts_skipped = self.ports.get("success_count") < 0
        skipped = 0
        for slot in self.slots:
            skipped += (yield from self._go_on(slot)) is SKIPPED
            succeeded, failed = self._ended_with(SUCCESS), self._ended_with(FAILURE)
            if succeeded + skipped * counts_skipped >= successes:
                return self.end(SUCCESS)
            if len(self.children) - failed < successes or failed == failures:
                return self.end(FAILURE)
        return SKIPPED if skipped == len(self.children) else RUNNING


class ParallelAll(Together):
    """Until all children have finished; FAILURE if too many failed."""

    PORTS: ClassVar = {"max_failures": PortInformation(int, default_value=1)}

    def decide(self) -> Ticking:
        failures = self._number("max_failures")
        skipped = 0
        for slot in self.slots:
            skipped += (yield from self._go_on(slot)) is SKIPPED
        if skipped == len(self.children):
            return SKIPPED
        if skipped + self._ended_with(SUCCESS) + self._ended_with(FAILURE) < len(self.children):
            return RUNNING
        return self.end(FAILURE if self._ended_with(FAILURE) >= failures else SUCCESS)


class _Conditional(Control):
    """The first child is a condition for the others."""

    CHILDREN = 2, 3

    def _ask(self) -> Ticking:
        verdict = yield from self.slots[0].tick()
        if verdict is SKIPPED:
            raise NodeError(f"the condition of {self.name!r} was skipped, so there is nothing to choose by")
        return verdict


class IfThenElse(_Conditional):
    """The condition once, then the second child or the third to its end."""

    FORGETS = ("_chosen",)
    _chosen = 0

    def decide(self) -> Ticking:
        slots = self.slots
        if self._chosen == 0:
            verdict = yield from self._ask()
            if verdict is RUNNING:
                return RUNNING
            if verdict is FAILURE and len(slots) == 2:
                return FAILURE  # the condition stays finished: an action is not started again
            self._chosen = 1 if verdict is SUCCESS else 2
        verdict = yield from slots[self._chosen].tick()
        return verdict if verdict is RUNNING else self.end(verdict)


class WhileDoElse(_Conditional):
    """The condition at each tick; the second child while it succeeds, the third while it fails."""

    def decide(self) -> Ticking:
        verdict = yield from self._ask()
        if verdict is RUNNING:
            return RUNNING
        chosen = 1 if verdict is SUCCESS else 2
        for index, other in enumerate(self.slots):
            if index not in (0, chosen):
                other.reset()
        if chosen < len(self.slots):
            verdict = yield from self.slots[chosen].tick()
        return verdict if verdict is RUNNING else self.end(verdict)


class Switch(Control):
    """The child whose case equals the variable, or else the last; a subclass says how many cases there are."""

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
        if not (self.ports.exists("variable") and self.ports.exists(case)):
            return False
        one, other = self.ports.get("variable"), self.ports.get(case)
        if one == other:
            return True
        enums = self.ports.blackboard.enums
        try:
            return abs(float(enums.get(one, one)) - float(enums.get(other, other))) <= sys.float_info.epsilon
        except ValueError:
            return False


def _switch(cases: int) -> type[Switch]:
    names = ["variable", *(f"case_{number}" for number in range(1, cases + 1))]
    ports = {name: PortInformation(str, required=False) for name in names}
    return type(f"Switch{cases}", (Switch,), {"PORTS": ports, "CHILDREN": (cases + 1, cases + 1)})


class TryCatch(Control):
    """A sequence; if one of it fails, the last child is ticked in that tick, to its end, and the outcome is FAILURE.

    With `catch_on_halt` the last child is ticked once when this is halted before anything has failed.
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


_KINDS: Final[list[type[Control]]] = [
    *(Sequence, AsyncSequence, SequenceWithMemory, ReactiveSequence, Fallback, AsyncFallback, ReactiveFallback),
    *(Parallel, ParallelAll, IfThenElse, WhileDoElse, TryCatch),
    *map(_switch, range(2, 7)),
]
CONTROLS: Final = {kind.__name__: kind for kind in _KINDS}
"""By tag."""
