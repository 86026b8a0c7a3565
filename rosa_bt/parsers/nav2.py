"""The control nodes that Nav2 adds, each with Nav2's semantics."""

from typing import ClassVar, Final

from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.parsers.nodes import Control, Ticking

__all__ = ["NAV2"]

SUCCESS: Final = Status.SUCCESS
FAILURE: Final = Status.FAILURE
RUNNING: Final = Status.RUNNING
SKIPPED: Final = Status.INVALID


class RecoveryNode(Control):
    """The first child; each time it fails the second, and the first again, as often as it may be retried."""

    CHILDREN = (2, 2)
    PORTS: ClassVar = {"number_of_retries": PortInformation(int, default_value=1)}
    has_fixed_children = True
    _retries = 0
    _is_recovering = False

    def forget(self) -> None:
        self._retries, self._is_recovering = 0, False

    def decide(self) -> Ticking:
        task, recovery = self.slots
        allowed = self.ports.get("number_of_retries")
        while self._retries <= allowed:
            slot = recovery if self._is_recovering else task
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                return RUNNING
            if slot is task and verdict is FAILURE and self._retries < allowed:
                task.reset()
                self._is_recovering = True
            elif slot is recovery and verdict is SUCCESS:
                recovery.reset()
                self._is_recovering = False
                self._retries += 1
            elif slot is recovery and verdict is SKIPPED:
                recovery.reset()
                self._is_recovering = False
                return FAILURE
            else:
                self.forget()
                self.reset_children()
                return verdict
        self.forget()
        self.reset_children()
        return FAILURE


class PipelineSequence(Control):
    """A sequence that ticks what it has passed again, and is not held up by what is running there."""

    _furthest: int = 0

    def forget(self) -> None:
        self._furthest = 0

    def decide(self) -> Ticking:
        skipped = 0
        for index, slot in enumerate(self.slots):
            verdict = yield from slot.tick()
            skipped += verdict is SKIPPED
            if verdict is RUNNING and index >= self._furthest:
                self._furthest = index
                return RUNNING
            if verdict is FAILURE:
                return self._end(FAILURE)
        return self._end(SKIPPED if skipped == len(self.children) else SUCCESS)

    def _end(self, verdict: Status) -> Status:
        self.forget()
        self.reset_children()
        return verdict


class RoundRobin(Control):
    """The next child at each turn, until one succeeds or all have failed."""

    _next: int = 0
    _failed: int = 0

    def forget(self) -> None:
        self._next = self._failed = 0

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
        self.forget()
        self.reset_children()
        return SKIPPED if skipped == len(slots) else FAILURE


NAV2: Final[dict[str, type[Control]]] = {kind.__name__: kind for kind in (RecoveryNode, PipelineSequence, RoundRobin)}
"""By tag."""
