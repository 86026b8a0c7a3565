"""The controls and decorators of Nav2, with the semantics of its release 1.5.1.

Another release may differ.
"""

from typing import ClassVar

from rosa_bt.xml.nodes import (
    DONE,
    FAILURE,
    ROUNDING_S,
    RUNNING,
    SKIPPED,
    SUCCESS,
    Control,
    NodeError,
    OneChild,
    Ticking,
    port,
)


class RecoveryNode(Control):
    """Ticks the first child; when it fails, the second, then the first again, `number_of_retries` times."""

    CHILDREN = (2, 2)
    PORTS: ClassVar = {"number_of_retries": port(int, 1)}
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
    """A sequence that ticks earlier children again, and goes on even if one of them is RUNNING then."""

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


class RoundRobin(Control):
    """Ticks the next child, until one succeeds or all failed.

    Without `wrap_around`, ends at the last.

    As in Nav2 1.5.1, the last child ends it as a failure without `wrap_around`, also by its
    success.
    """

    PORTS: ClassVar = {"wrap_around": port(bool, False)}
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


class PersistentSequence(Control):
    """A sequence that keeps its place on the blackboard, also when it is halted."""

    PORTS: ClassVar = {"current_child_idx": port(int)}

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


class PauseResumeController(Control):
    """Ticks the first child; while paused, the second.

    The third on a pause, the fourth on resuming.

    Nav2 pauses and resumes it by two services; here, `pause` and `resume` are called.
    """

    PORTS: ClassVar = {
        "pause_service_name": port(str, required=False),
        "resume_service_name": port(str, required=False),
    }
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
    """Ticks the child while it is RUNNING, and when it is due: at the start, or as a subclass says."""

    instead = RUNNING
    _is_due = True

    def initialise(self) -> None:
        self._is_due = True

    def decide(self) -> Ticking:
        if not self._is_due and self.child.status is not RUNNING:
            return self.instead
        self._is_due = False
        return (yield from self.child.tick())


class RateController(Anew):
    """Ticks the child at the start, while it is RUNNING, and 1 / `hz` [s] after it succeeded."""

    PORTS: ClassVar = {"hz": port(float, 10.0)}
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
