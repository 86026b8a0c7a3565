"""What missions that adapt need beside py_trees: two decorators, two composites, and subtrees made in one call."""

import math
from collections.abc import Generator, Iterator, Mapping, MutableMapping, Sequence
from typing import Any

from py_trees import composites
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

from kb import KnowledgeBase, UnknownName
from rosa_bt.behaviours import (
    ActionBehaviour,
    ActionRequest,
    Careful,
    IsActionFeasible,
    RosaAction,
    halt,
)
from rosa_bt.exceptions import TreeChangeError, in_words


class ForAction(Careful, Decorator):
    """Ticks any behaviour only while a ROSA action is feasible, and requests the action while the behaviour runs.

    Each tick asks whether the action is feasible. If it is not, the child is stopped, and this fails with the reason.
    Otherwise the action is requested when the child starts, and released once, however the child ends: the result is
    "completed" after SUCCESS, "failed" after FAILURE or an exception (its text is the feedback), else "abandoned".

    Args:
        action: name of the ROSA action.
        child: a leaf or a whole subtree.
        preference: name of the attribute to favour when a configuration is chosen, or None.
        wait: tick the child only when the robot is configured for the action; RUNNING until then.
        timeout: how long to wait [s], by the clock of the knowledge base; then FAILURE, with what is missing.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str,
        child: Behaviour,
        *,
        preference: str | None = None,
        wait: bool = False,
        timeout: float = math.inf,
    ) -> None:
        super().__init__(name, child)
        kb.is_feasible(action)  # an unknown action is found here, not in the middle of a mission
        self.kb = kb
        self.action = action
        self.preference = preference
        self.wait, self.timeout = wait, timeout
        self._request = ActionRequest(kb, timeout if wait else None)

    def advance(self) -> Generator[Behaviour, None, Status]:
        new_status = self._request.admit(self)
        if new_status is Status.SUCCESS:
            yield from self.decorated.tick()
            new_status = self.update()
        return new_status

    def update(self) -> Status:
        self.feedback_message = self.decorated.feedback_message
        return self.decorated.status

    def stop(self, new_status: Status) -> None:
        """Stop the child if it is running, and release the request, also if the child raises.

        The status changes last: after an interrupt in here, a second call does the rest.
        """
        try:
            self.terminate(new_status)
            if new_status is Status.INVALID or self.decorated.status is Status.RUNNING:
                self.decorated.stop(Status.INVALID)
        except Exception as error:
            self.feedback_message = f"{in_words(error)} (at the end)"
        finally:
            halt(self.decorated)
            self._request.close(new_status, self.feedback_message)
        self.status = new_status


class UntilSuccess(Decorator):
    """RUNNING until the child succeeds; a child that fails is ticked once more in the same tick.

    Without this second attempt there would be a tick after which no action is required: the robot would be
    deconfigured between two actions, and configured again a moment later.
    """

    def tick(self) -> Iterator[Behaviour]:
        yield from self.decorated.tick()
        if self.decorated.status is Status.FAILURE:
            yield from self.decorated.tick()
        new_status = self.update()
        if new_status is not Status.RUNNING:
            self.stop(new_status)
        self.status = new_status
        yield self

    def update(self) -> Status:
        return Status.RUNNING if self.decorated.status is Status.FAILURE else self.decorated.status


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
    is_side_by_side = getattr(task, "is_side_by_side", isinstance(task, composites.Parallel))
    deciding = failed if is_side_by_side else failed[-1:]
    return bool(deciding) and all(map(gave_way, deciding))


class _Parts(composites.Composite):
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

    def __init__(
        self, name: str, task: Behaviour, meanwhile: Behaviour, *, memory: bool = False
    ) -> None:
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


def feasible_then_act(task: Behaviour, during: float = 0.0) -> Behaviour:
    """Return a subtree that does an action only while it is feasible, which each tick asks.

    Args:
        task: the action. Any other behaviour is returned as it is: a `ForAction` asks by itself, and in a subtree its
            leaves do.
        during: how long the action takes [s]; see `IsActionFeasible`.
    """
    if not isinstance(task, RosaAction):
        if not during:
            return task
        raise TreeChangeError(
            f"{task.name!r} is not a RosaAction; give `during` to the actions in it instead"
        )
    condition = IsActionFeasible(f"{task.name} feasible?", task.kb, task.action, during=during)
    return composites.Sequence(f"{task.name} if feasible", memory=False, children=[condition, task])


def unguarded(root: Behaviour) -> list[RosaAction]:
    """Return the actions of a tree that go on when they become unfeasible, and that no node above them stops then.

    A node stops its action if it is a `ForAction`, or a sequence without memory with an `IsActionFeasible` before it.
    """
    actions = [
        one for one in root.iterate() if isinstance(one, RosaAction) and one.even_if_unfeasible
    ]
    return [one for one in actions if not _is_guarded(one)]


def _is_guarded(action: RosaAction) -> bool:
    node: Behaviour = action
    while (parent := node.parent) is not None:
        before: Sequence[Behaviour] = ()
        is_sequence = isinstance(parent, composites.Sequence) and not parent.memory
        if is_sequence or getattr(parent, "is_reactive_sequence", False):
            before = parent.children[: parent.children.index(node)]
        asked = [
            one.action
            for child in before
            for one in child.iterate()
            if isinstance(one, IsActionFeasible)
        ]
        if action.action in asked or (
            isinstance(parent, ForAction) and parent.action == action.action
        ):
            return True
        node = parent
    return False


def first_feasible(
    name: str, tasks: Sequence[Behaviour], *, memory: bool = False, during: float = 0.0
) -> Behaviour:
    """Return a selector that does the first of several actions that is feasible and does not fail.

    Args:
        name: of the selector.
        tasks: the actions, the most preferred first.
        memory: go on with the action that has started as long as it is feasible; otherwise a more preferred action
            takes over in the tick in which it becomes feasible.
        during: how long each action takes [s]; for an action of another duration, pass `feasible_then_act(...)`.
    """
    return composites.Selector(
        name, memory=memory, children=[feasible_then_act(task, during) for task in tasks]
    )


def do_until_unfeasible(
    task: Behaviour,
    meanwhile: Behaviour,
    *,
    memory: bool = False,
    name: str | None = None,
    during: float = 0.0,
) -> DoUntilUnfeasible:
    """Return a composite that does a task, and something else while the task is unfeasible; then the task goes on.

    Args:
        task: an action, or a subtree that fails when its action becomes unfeasible.
        meanwhile: an action or a subtree to do while the task is unfeasible.
        memory: finish `meanwhile` first, even if the task becomes feasible earlier.
        name: of the composite.
        during: how long the task takes [s], if it is an action; it starts only if it will stay feasible for that long.
    """
    name = name or f"{task.name}, or else {meanwhile.name}"
    return DoUntilUnfeasible(
        name, feasible_then_act(task, during), feasible_then_act(meanwhile), memory=memory
    )


def switch_safely(root: Behaviour, transitions: Mapping[tuple[str, str], Behaviour]) -> Behaviour:
    """Add transitions to a tree: behaviours that run between two actions, on whatever way the tree gets there.

    Args:
        root: of a tree that is not running; its actions (`RosaAction`, `ForAction`) are wrapped in place.
        transitions: the behaviours, by a pair of names: the action that was done last, and the action to start.

    Returns:
        The root of the changed tree.

    Raises:
        kb.UnknownName: the tree has no action with this name.
        TreeChangeError: several behaviours do an action that needs a transition, or a parent is of an unknown kind.
    """
    tasks = [one for one in root.iterate() if isinstance(one, RosaAction | ForAction)]
    posture: Posture = {}
    for action in dict.fromkeys(action for pair in transitions for action in pair):
        doing = [task for task in tasks if task.action == action]
        if not doing:
            raise UnknownName("action of the tree", action, sorted({task.action for task in tasks}))
        needed = {before: step for (before, after), step in transitions.items() if after == action}
        if needed and len(doing) > 1:
            raise TreeChangeError(
                f"{len(doing)} behaviours do {action!r}, and a transition has one place; make one subtree of them"
            )
        for task in doing:
            root = _switched(root, task, needed, posture)
    return root


def _switched(
    root: Behaviour, task: RosaAction | ForAction, needed: Mapping[str, Behaviour], posture: Posture
) -> Behaviour:
    parent = task.parent
    if parent is not None and not isinstance(parent, composites.Composite | Decorator):
        raise TreeChangeError(
            f"{parent.name!r} is neither a composite nor a decorator; it cannot hold a transition"
        )
    task.parent = None
    switch = SafeSwitch(
        f"switch to {task.action}" if needed else f"note {task.action}", task, needed, posture
    )
    if parent is None:
        return switch
    parent.children[parent.children.index(task)] = switch
    switch.parent = parent
    if isinstance(parent, Decorator):
        parent.decorated = switch
    return root
