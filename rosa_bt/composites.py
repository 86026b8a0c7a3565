"""Composites that py_trees does not have: one gives way to another task, one switches safely between actions."""

from collections.abc import Generator, Iterator, Mapping, MutableMapping
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Parallel

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.decorators import ForAction


def gave_way(task: Behaviour) -> bool:
    """Tell whether a failed task failed because an action in it is unfeasible, or no longer in the model.

    The child that failed last decides, e.g. the failed step of a sequence; of a parallel, all children that failed.
    """
    failed = [child for child in task.children if child.status is Status.FAILURE]
    if isinstance(task, ActionBehaviour | ForAction):
        is_unfeasible = task.action not in task.kb.actions or not task.kb.is_feasible(task.action)
        is_unfeasible |= getattr(task, "ends_too_soon", False)
        if is_unfeasible or not failed:
            return is_unfeasible
    is_side_by_side = getattr(task, "is_side_by_side", isinstance(task, Parallel))
    deciding = failed if is_side_by_side else failed[-1:]
    return bool(deciding) and all(map(gave_way, deciding))


class _Parts(Composite):
    """A composite whose children have different roles; base class."""

    def advance(self) -> Generator[Behaviour, None, Status]:
        """Do the work of one tick: yield the nodes that are visited before this one, and return the status."""
        raise NotImplementedError

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING:
            for child in self.children:
                if child.status is not Status.INVALID:
                    child.stop(Status.INVALID)
            self.initialise()
        self.status = yield from self.advance()
        if self.status is not Status.RUNNING:
            self.stop(self.status)
        yield self


class DoUntilUnfeasible(_Parts):
    """Does a task; while the task is unfeasible, does something else; then goes on with the task.

    The switch, in both directions, takes place within one tick. So an action is required after every tick, and the
    robot is not deconfigured and configured again in between. This succeeds when the task does, and fails when the task
    fails for a reason other than an unfeasible action; otherwise it is RUNNING. `meanwhile` starts again if it fails,
    or succeeds, before the task is feasible.

    Args:
        task: a behaviour or subtree that fails when its action becomes unfeasible.
        meanwhile: what to do while the task is unfeasible.
        memory: finish `meanwhile` first, even if the task becomes feasible earlier.
    """

    def __init__(self, name: str, task: Behaviour, meanwhile: Behaviour, *, memory: bool = False) -> None:
        super().__init__(name, [task, meanwhile])
        self.memory = memory

    def advance(self) -> Generator[Behaviour, None, Status]:
        task, meanwhile = self.children
        if self.memory and meanwhile.status is Status.RUNNING:
            yield from meanwhile.tick()
        if not (self.memory and meanwhile.status is Status.RUNNING):
            yield from self._do(task, meanwhile)
        is_instead = self.current_child is not task
        self.feedback_message = f"instead of {task.name}" if is_instead else ""
        return Status.RUNNING if is_instead else task.status

    def _do(self, task: Behaviour, meanwhile: Behaviour) -> Iterator[Behaviour]:
        """Tick the task and, if it gives way, `meanwhile`; if that succeeds at once, tick both once more."""
        for _ in range(2):
            yield from task.tick()
            if task.status is not Status.FAILURE or not gave_way(task):
                self.current_child = task
                if meanwhile.status is not Status.INVALID:
                    meanwhile.stop(Status.INVALID)
                return
            self.current_child = meanwhile
            yield from meanwhile.tick()
            if meanwhile.status is not Status.SUCCESS:
                return


Posture = MutableMapping[str, Any]
"""Holds, under a key, the action that was done last; shared by the behaviours that switch between actions."""


class SafeSwitch(_Parts):
    """Does an action, and before it the transition from the action that was done last, if there is one.

    The transition finishes before the action is requested. If it fails, this fails, and the action does not start. If
    it is interrupted, it starts again at the next start, unless the robot has gone back to the other action.

    Args:
        task: the behaviour that does the action.
        transitions: what to do first, by name of the action that was done last.
        posture: holds the action that was done last; shared with the behaviours of the other actions.
        action: name of the action, if the task is neither a leaf with an action nor a `ForAction`.
        key: the key in `posture`.
    """

    def __init__(
        self,
        name: str,
        task: Behaviour,
        transitions: Mapping[str, Behaviour],
        posture: Posture,
        action: str | None = None,
        key: str = "posture",
    ) -> None:
        super().__init__(name, [*transitions.values(), task])
        self.action = task.action if isinstance(task, ActionBehaviour | ForAction) else str(action)
        self.posture, self.key = posture, key
        self.after = tuple(transitions)

    def advance(self) -> Generator[Behaviour, None, Status]:
        before, child = self.posture.get(self.key), self.children[-1]
        if before in self.after:
            child = self.current_child = self.children[self.after.index(before)]
            yield from child.tick()
            said = child.feedback_message
            self.feedback_message = f"switching from {before}{f': {said}' if said else ''}"
            if child.status is Status.SUCCESS:
                self.posture[self.key], child = self.action, self.children[-1]
        if child is self.children[-1]:
            self.current_child = child
            yield from child.tick()
            self.feedback_message = child.feedback_message
            if child.status is not Status.FAILURE:
                self.posture[self.key] = self.action
        return child.status
