"""Composites that py_trees has no namesake for: giving way to something else, and switching safely."""

from collections.abc import Generator, Iterator, Mapping, MutableMapping
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Parallel

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.decorators import ForAction


def gave_way(task: Behaviour) -> bool:
    """Tell whether a task that failed did so because an action in it is unfeasible, or no longer in the model.

    What decides is what failed last: the step of a sequence, the last resort of a choice, all that failed side by side.
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
    """A composite whose children have different parts to play."""

    def advance(self) -> Generator[Behaviour, None, Status]:
        """Do what is done in a tick; yield what is visited before this one, and return the outcome."""
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
    """Does a task; while that is unfeasible, does something else; then goes on with the task.

    The other begins in the tick in which the task fails because an action in it is unfeasible, and the task in that in
    which the other gives back: there is no tick in which nothing is required, so the robot is not taken apart and put
    together again. SUCCESS is the task's, and so is a FAILURE for any other reason; all else is RUNNING. What is done
    meanwhile begins anew if it ends before the task is feasible, or fails.

    Args:
        task: what to do: a behaviour, or a subtree, that fails when what it does becomes unfeasible.
        meanwhile: what to do while the task is unfeasible.
        memory: finish what is done meanwhile, also when the task is feasible before.
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
        """Tick the task and, if it gives way, the other; once more if that is finished in this tick."""
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
"""After which action the robot is left as it is, under some key; shared by those who switch between some."""


class SafeSwitch(_Parts):
    """Does an action; before that, what has to be done if another one was done last.

    The transition runs to its end before the action is requested. If it fails, so does this, and the action is not
    begun; if it is interrupted, it is begun again at the next start, unless the robot goes back to the other action.

    Args:
        task: the action.
        transitions: what to do first, by name of the action that was done last.
        posture: which action that was; shared with the behaviours of the other actions.
        action: name of the action, if the task does not say it itself.
        key: of the posture.
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
