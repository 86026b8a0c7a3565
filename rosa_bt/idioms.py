"""Functions that make common subtrees for missions that adapt, in one call."""

from collections.abc import Mapping, Sequence

from py_trees import composites
from py_trees.behaviour import Behaviour
from py_trees.decorators import Decorator

from kb import UnknownName
from rosa_bt.behaviours import IsActionFeasible, RosaAction
from rosa_bt.composites import DoUntilUnfeasible, Posture, SafeSwitch
from rosa_bt.decorators import ForAction
from rosa_bt.exceptions import TreeChangeError
from rosa_bt.xml.controls import CONTROLS


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
        raise TreeChangeError(f"{task.name!r} is not a RosaAction; give `during` to the actions in it instead")
    condition = IsActionFeasible(f"{task.name} feasible?", task.kb, task.action, during=during)
    return composites.Sequence(f"{task.name} if feasible", memory=False, children=[condition, task])


def unguarded(root: Behaviour) -> list[RosaAction]:
    """Return the actions of a tree that go on when they become unfeasible, and that no node above them stops then.

    A node stops its action if it is a `ForAction`, or a sequence without memory with an `IsActionFeasible` before it.
    """
    actions = [one for one in root.iterate() if isinstance(one, RosaAction) and one.even_if_unfeasible]
    return [one for one in actions if not _is_guarded(one)]


def _is_guarded(action: RosaAction) -> bool:
    node: Behaviour = action
    while (parent := node.parent) is not None:
        before: Sequence[Behaviour] = ()
        if isinstance(parent, CONTROLS["ReactiveSequence"]) or (
            isinstance(parent, composites.Sequence) and not parent.memory
        ):
            before = parent.children[: parent.children.index(node)]
        asked = [one.action for child in before for one in child.iterate() if isinstance(one, IsActionFeasible)]
        if action.action in asked or (isinstance(parent, ForAction) and parent.action == action.action):
            return True
        node = parent
    return False


def first_feasible(name: str, tasks: Sequence[Behaviour], *, memory: bool = False, during: float = 0.0) -> Behaviour:
    """Return a selector that does the first of several actions that is feasible and does not fail.

    Args:
        name: of the selector.
        tasks: the actions, the most preferred first.
        memory: go on with the action that has started as long as it is feasible; otherwise a more preferred action
            takes over in the tick in which it becomes feasible.
        during: how long each action takes [s]; for an action of another duration, pass `feasible_then_act(...)`.
    """
    return composites.Selector(name, memory=memory, children=[feasible_then_act(task, during) for task in tasks])


def do_until_unfeasible(
    task: Behaviour, meanwhile: Behaviour, *, memory: bool = False, name: str | None = None, during: float = 0.0
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
    return DoUntilUnfeasible(name, feasible_then_act(task, during), feasible_then_act(meanwhile), memory=memory)


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
        raise TreeChangeError(f"{parent.name!r} is neither a composite nor a decorator; it cannot hold a transition")
    task.parent = None
    switch = SafeSwitch(f"switch to {task.action}" if needed else f"note {task.action}", task, needed, posture)
    if parent is None:
        return switch
    parent.children[parent.children.index(task)] = switch
    switch.parent = parent
    if isinstance(parent, Decorator):
        parent.decorated = switch
    return root
