"""The idioms of missions that adapt: two composites, and subtrees that are made in one call."""

from collections.abc import Iterator, Mapping, Sequence

from py_trees import composites
from py_trees.behaviour import Behaviour
from py_trees.decorators import Decorator

from kb import UnknownName
from rosa_bt.behaviours import (
    ActionBehaviour,
    IsActionFeasible,
    Requester,
    RosaAction,
    Ticking,
)
from rosa_bt.decorators import ForAction
from rosa_bt.exceptions import TreeChangeError, path_of
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS, is_parallel


def failed_as_unfeasible(task: Behaviour) -> bool:
    """Tell whether a task failed because an action in it is unfeasible.

    The child that failed last decides, e.g. the failed step of a sequence; of a parallel, all
    children that failed.
    """
    failed = [child for child in task.children if child.status is FAILURE]
    if isinstance(task, ActionBehaviour | ForAction):
        is_unfeasible = not task.kb.is_feasible(task.action)
        if is_unfeasible or not failed:
            return is_unfeasible
    deciding = failed if is_parallel(task) else failed[-1:]
    return bool(deciding) and all(map(failed_as_unfeasible, deciding))


class _RoleComposite(composites.Composite):
    """A composite whose children have different roles; base class."""

    def advance(self) -> Ticking:
        """Do the work of one tick: yield the nodes that are visited before, return the status."""
        raise NotImplementedError

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not RUNNING:
            for child in self.children:
                if child.status is not INVALID:
                    child.stop(INVALID)
            self.initialise()
        self.status = yield from self.advance()
        if self.status is not RUNNING:
            self.stop(self.status)
        yield self


class DoUntilUnfeasible(_RoleComposite):
    """Does a task; while the task is unfeasible, does something else; then goes on with the task.

    The switch, in both directions, takes place within one tick. So an action is required after
    every tick, and the robot is not deconfigured and configured again in between. This succeeds
    when the task does, and fails when the task fails for a reason other than an unfeasible action;
    otherwise it is RUNNING. `meanwhile` starts again if it fails, or succeeds, before the task is
    feasible.

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

    def advance(self) -> Ticking:
        task, meanwhile = self.children
        if self.memory and meanwhile.status is RUNNING:
            yield from meanwhile.tick()
        if not (self.memory and meanwhile.status is RUNNING):
            yield from self._do(task, meanwhile)
        is_instead = self.current_child is not task
        self.feedback_message = f"instead of {task.name}" if is_instead else ""
        return RUNNING if is_instead else task.status

    def _do(self, task: Behaviour, meanwhile: Behaviour) -> Iterator[Behaviour]:
        """Tick the task or `meanwhile`; if `meanwhile` succeeds at once, tick both once more."""
        for _ in range(2):
            yield from task.tick()
            if task.status is not FAILURE or not failed_as_unfeasible(task):
                self.current_child = task
                if meanwhile.status is not INVALID:
                    meanwhile.stop(INVALID)
                return
            self.current_child = meanwhile
            yield from meanwhile.tick()
            if meanwhile.status is not SUCCESS:
                return


class SafeSwitch(_RoleComposite):
    """Does an action, and before it the transition from the action that was done last, if any.

    The transition finishes before the action is requested. If it fails, this fails, and the action
    does not start. If it is interrupted, it starts again at the next start, unless the robot has
    gone back to the other action.

    Args:
        task: the behaviour that does the action.
        transitions: what to do first, by name of the action that was done last.
        last_action: the action that was done last, one for all switches of a tree.
    """

    def __init__(
        self,
        task: RosaAction | ForAction,
        transitions: Mapping[str, Behaviour],
        last_action: list[str],
    ) -> None:
        verb = "switch to" if transitions else "note"
        super().__init__(f"{verb} {task.action}", [*transitions.values(), task])
        self.action = task.action
        self.last_action = last_action
        self.after = tuple(transitions)

    def advance(self) -> Ticking:
        (before,) = self.last_action
        task = self.children[-1]
        if before in self.after:
            transition = self.current_child = self.children[self.after.index(before)]
            yield from transition.tick()
            if transition.status is not SUCCESS:
                return transition.status
            self.last_action[0] = self.action
        self.current_child = task
        yield from task.tick()
        if task.status is not FAILURE:
            self.last_action[0] = self.action
        return task.status


def feasible_then_act(task: Behaviour) -> Behaviour:
    """Return a subtree that does an action only while it is feasible, which each tick asks.

    Args:
        task: the action. Any other behaviour is returned as it is: a `ForAction` asks by itself,
            and in a subtree its leaves do.
    """
    if not isinstance(task, RosaAction):
        return task
    condition = IsActionFeasible(f"{task.name} feasible?", task.kb, task.action)
    return composites.Sequence(f"{task.name} if feasible", memory=False, children=[condition, task])


def first_feasible(name: str, tasks: Sequence[Behaviour], *, memory: bool = False) -> Behaviour:
    """Return a selector that does the first of several actions that is feasible and does not fail.

    Args:
        name: of the selector.
        tasks: the actions, the most preferred first.
        memory: go on with the action that has started as long as it is feasible; otherwise a more
            preferred action takes over in the tick in which it becomes feasible.
    """
    children = [feasible_then_act(task) for task in tasks]
    return composites.Selector(name, memory=memory, children=children)


def do_until_unfeasible(
    task: Behaviour, meanwhile: Behaviour, *, memory: bool = False, name: str | None = None
) -> DoUntilUnfeasible:
    """Return a composite that does a task, and something else while the task is unfeasible.

    Args:
        task: an action, or a subtree that fails when its action becomes unfeasible.
        meanwhile: an action or a subtree to do while the task is unfeasible.
        memory: finish `meanwhile` first, even if the task becomes feasible earlier.
        name: of the composite.
    """
    parts = feasible_then_act(task), feasible_then_act(meanwhile)
    root = DoUntilUnfeasible("", *parts, memory=memory)
    root.name = name or f"{task.name}, or else {meanwhile.name}"
    return root


def switch_safely(root: Behaviour, transitions: Mapping[tuple[str, str], Behaviour]) -> Behaviour:
    """Add behaviours to a tree that run between two actions, however the tree gets there.

    Args:
        root: of a tree that is not running; its actions (`RosaAction`, `ForAction`) are wrapped.
        transitions: the behaviours, by a pair of names: the action that was done last, and the
            action to start.

    Returns:
        The root of the changed tree.

    Raises:
        kb.UnknownName: the tree has no action with this name.
        TreeChangeError: one of these actions is inside another one or below a parallel, where no
            action is the last one, or a parent is of an unknown kind. The tree is not changed then.
        RuntimeError: two behaviours do the action of one transition, which has one place.
    """
    tasks = [node for node in root.iterate() if isinstance(node, RosaAction | ForAction)]
    names = sorted({task.action for task in tasks})
    steps_by_action: dict[str, dict[str, Behaviour]] = {}
    for (before, after), step in transitions.items():
        steps_by_action.setdefault(before, {})
        steps_by_action.setdefault(after, {})[before] = step
    for action in steps_by_action:
        if action not in names:
            raise UnknownName("action of the tree", action, names)
    tasks = [task for task in tasks if task.action in steps_by_action]
    for task in tasks:
        for node in path_of(task)[1:]:
            if is_parallel(node) or isinstance(node, Requester):
                problem = "its actions run at the same time, so none of them is done last"
            elif not isinstance(node, composites.Composite | Decorator):
                problem = "it is neither a composite nor a decorator of py_trees"
            else:
                continue
            place = f"{task.name!r} is below {node.name!r}"
            raise TreeChangeError(f"{place}: {problem}; put the transition into the tree")
    last_action = [""]
    for task in tasks:
        parent = task.parent
        task.parent = None
        switch = SafeSwitch(task, steps_by_action[task.action], last_action)
        if parent is None:
            return switch
        parent.children[parent.children.index(task)] = switch
        switch.parent = parent
        if isinstance(parent, Decorator):
            parent.decorated = switch
    return root
