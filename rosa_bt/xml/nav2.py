"""Nodes that Nav2 adds, each with Nav2's semantics; those that ask the robot or a map are the user's to register."""

from typing import ClassVar, Final

from py_trees.ports import PortInformation

from rosa_bt.xml.decorators import Timed
from rosa_bt.xml.nodes import DONE, FAILURE, RUNNING, SKIPPED, SUCCESS, Control, OneChild, Ticking


class RecoveryNode(Control):
    """The first child; each time it fails the second, and the first again, as often as it may be retried."""

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
    """A sequence that ticks what it has passed again, and is not held up by what is running there."""

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
    """The next child at each turn, until one succeeds or all have failed; if told so, not beyond the last child."""

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


class _Anew(OneChild):
    """The child when it is due: at the start of this node, and while it is running."""

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
    """The child at its start, while it is running, and when a period has passed since it last succeeded."""

    port = "hz"
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
    """The child to its end, once until this node is reset; FAILURE after that."""

    instead = FAILURE

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        self._is_due = verdict not in DONE
        return verdict


class GoalUpdatedController(_Anew):
    """The child at its start, while it is running, and when `goal` or `goals` has changed."""

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


_KINDS: Final = (RecoveryNode, PipelineSequence, RoundRobin, RateController, SingleTrigger, GoalUpdatedController)
NAV2: Final[dict[str, type[Control] | type[OneChild]]] = {kind.__name__: kind for kind in _KINDS}
