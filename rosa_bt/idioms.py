"""Creators of common subtrees: what a mission needs to adapt, in one call."""

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
    """Return an action that is done only while it is feasible, asked at each tick.

    Args:
        task: the action. Any other behaviour asks for itself (`ForAction`) or inside itself (a subtree) and is
            returned as it is.
        during: how long it takes [s]; see `IsActionFeasible`.
    """
    if not isinstance(task, RosaAction):
        if not during:
            return task
        raise TreeChangeError(f"{task.name!r} is no RosaAction; say within it how long its actions take")
    condition = IsActionFeasible(f"{task.name} feasible?", task.kb, task.action, during=during)
    return composites.Sequence(f"{task.name} if feasible", memory=False, children=[condition, task])


def unguarded(root: Behaviour) -> list[RosaAction]:
    """Return the actions of a tree that go on when they become unfeasible, and that nothing above them stops then.

    Guards are a `ForAction` around it, and an `IsActionFeasible` before it in a sequence without memory.
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
    """Return a choice: the first of several actions that is feasible, and does not fail, is done.

    Args:
        name: of the choice.
        tasks: the actions, the most preferred first.
        memory: stay with what was begun as long as it is feasible; otherwise a preferred one takes over in the tick in
            which it becomes feasible.
        during: how long each of them takes [s]; one that is to be asked otherwise is given as `feasible_then_act`.
    """
    return composites.Selector(name, memory=memory, children=[feasible_then_act(task, during) for task in tasks])


def do_until_unfeasible(
    task: Behaviour, meanwhile: Behaviour, *, memory: bool = False, name: str | None = None, during: float = 0.0
) -> DoUntilUnfeasible:
    """Return a task that is done; while it is unfeasible, something else is; then the task goes on.

    Args:
        task: an action, or a subtree that fails when what it does becomes unfeasible.
        meanwhile: an action, or a subtree, to do in the meantime.
        memory: finish what is done meanwhile, also when the task is feasible before.
        name: of the whole.
        during: how long the task takes [s], if it is an action; it is not begun if it would not stay feasible as long.
    """
    name = name or f"{task.name}, or else {meanwhile.name}"
    return DoUntilUnfeasible(name, feasible_then_act(task, during), feasible_then_act(meanwhile), memory=memory)


def switch_safely(root: Behaviour, transitions: Mapping[tuple[str, str], Behaviour]) -> Behaviour:
    """Have something done between two actions of a tree, whichever way the tree gets from one to the other.

    Args:
        root: of a tree that is not running; its actions (`RosaAction`, `ForAction`) are changed in place.
        transitions: what has to be done, by the names of the action done last and of the action to begin.

    Returns:
        The root of the changed tree.

    Raises:
        kb.UnknownName: no action of that name is done in the tree.
        TreeChangeError: there has to be one transition, but several behaviours that do the action.
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
        raise TreeChangeError(f"{parent.name!r} is neither a composite nor a decorator; its children are its own")
    task.parent = None
    switch = SafeSwitch(f"switch to {task.action}" if needed else f"note {task.action}", task, needed, posture)
    if parent is None:
        return switch
    parent.children[parent.children.index(task)] = switch
    switch.parent = parent
    if isinstance(parent, Decorator):
        parent.decorated = switch
    return root
