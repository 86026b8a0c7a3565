"""The numbers that PDDL files may compute with: costs, and resources, which actions use up and the goal limits."""

from collections.abc import Collection, Iterable, Iterator, Mapping

from rosa_pddl.domain import Limit, Resource, UpThing
from rosa_pddl.reading.sections import BODY, start_of
from rosa_pddl.reading.syntax import Node, Source

__all__ = ["POSSIBLE", "check_condition", "check_effect", "check_goal", "resources_of", "used_up", "without_limits"]

_COST = "total-cost"
_COMPARISONS = ("<", ">", "<=", ">=")
_NUMERIC = (*_COMPARISONS, "assign", "increase", "decrease", "scale-up", "scale-down")
POSSIBLE = (
    "numbers may be costs only, or resources: effects use them up by (increase (NAME) AMOUNT), the goal limits them "
    "by (<= (NAME) LIMIT), and no action changes what AMOUNT and LIMIT are made of. For more than that, a numeric "
    "engine such as ENHSP (up-enhsp) would do"
)
"""What messages say may be done with numbers."""


# ---------------------------------------------------------------- in the files


def used_up(domain: Source) -> frozenset[str]:
    """Return the resources of a domain file, in lower case: numbers without arguments that some action increases."""
    schemas = [node for node in domain.root.children[2:] if node.head in BODY]
    targets = [node.children[1] for schema in schemas for node in _increases(schema) if len(node.children) == 3]
    return frozenset(target.head for target in targets if len(target.children) == 1 and target.head != _COST)


def check_condition(source: Source, node: Node, place: str) -> None:
    """Assure that a condition does not compute with numbers.

    Args:
        source: the file.
        node: the condition.
        place: what it belongs to, for the message.

    Raises:
        UnsupportedPddlError: it does.
    """
    if node.head in _NUMERIC or (node.head == "=" and any(child.is_list for child in node.children)):
        raise _unsupported(source, node, place, "computes with numbers")
    for child in node.children:
        check_condition(source, child, place)


def check_effect(source: Source, node: Node, place: str, resources: Collection[str]) -> None:
    """Assure that the effects of an action only add to the cost and to resources, once each, what is fixed before.

    Args:
        source: the file.
        node: the effects.
        place: the name of the action, for messages.
        resources: names, in lower case.

    Raises:
        PddlError: there are two additions to the same number.
        UnsupportedPddlError: they do something else with numbers.
    """
    _check_additions(source, node, place, resources)
    seen: set[str] = set()
    for one in _increases(node):
        target = one.children[1]
        if target.head in seen:
            what = "cost" if target.head == _COST else "use"
            raise source.error(one, f"found a second {what} {start_of(one)!r}, expected one; add them up")
        seen.add(target.head)


def check_goal(source: Source, node: Node, resources: Collection[str]) -> None:
    """Assure that a goal computes with numbers only to limit resources, whatever else it says.

    Args:
        source: the file.
        node: the goal.
        resources: names, in lower case.

    Raises:
        UnsupportedPddlError: it does otherwise.
    """
    if node.head == "and":
        for child in node.children[1:]:
            check_goal(source, child, resources)
    elif node.head in _COMPARISONS and len(node.children) == 3:
        _check_limit(source, node, resources)
    else:
        check_condition(source, node, "the goal")


def without_limits(goal: Node) -> Iterator[Node]:
    """Yield what a goal asks for beside limits: itself if there are none, else its other parts."""
    parts = list(_conjuncts(goal))
    others = [part for part in parts if part.head not in _COMPARISONS]
    yield from [goal] if len(others) == len(parts) else others


def _conjuncts(node: Node) -> Iterator[Node]:
    if node.head != "and":
        yield node
        return
    for child in node.children[1:]:
        yield from _conjuncts(child)


def _increases(node: Node) -> Iterator[Node]:
    if node.head == "increase":
        yield node
    for child in node.children:
        yield from _increases(child)


def _check_additions(
    source: Source, node: Node, place: str, resources: Collection[str], *, is_certain: bool = True
) -> None:
    if node.head == "increase" and len(node.children) == 3:
        if not is_certain:
            raise _unsupported(source, node, place, "is no number which no condition changes")
        _check_addition(source, node, place, resources)
    elif node.head in ("when", "forall"):
        for child in node.children[1:]:
            _check_additions(source, child, place, resources, is_certain=False)
    elif node.head in ("and", "at"):
        for child in node.children[1:]:
            _check_additions(source, child, place, resources, is_certain=is_certain)
    else:
        check_condition(source, node, place)


def _check_addition(source: Source, node: Node, place: str, resources: Collection[str]) -> None:
    _, target, amount = node.children
    if target.head != _COST and len(target.children) != 1:
        raise _unsupported(source, node, place, "adds to a number with arguments")
    if _is_below_nothing(amount):
        what = "costs are" if target.head == _COST else "uses are"
        raise source.unsupported(node, f"{start_of(node)!r} in {place} is less than nothing; {what} 0 or more")
    _check_fixed(source, amount, node, place, resources)
    if target.head != _COST:
        _check_sum(source, amount, node, place)


def _check_limit(source: Source, node: Node, resources: Collection[str]) -> None:
    head, left, right = node.head, *node.children[1:]
    if head in (">", ">="):
        left, right = right, left
    if left.head not in resources or len(left.children) != 1:
        told = f"; what actions use up is {', '.join(sorted(resources))}" if resources else ""
        raise _unsupported(source, node, "the goal", f"computes with numbers{told}")
    _check_fixed(source, right, node, "the goal", resources)
    _check_sum(source, right, node, "the goal")


def _check_fixed(source: Source, amount: Node, within: Node, place: str, resources: Collection[str]) -> None:
    """Assure that no action changes what an amount is made of."""
    if amount.head == _COST or amount.head in resources:
        raise _unsupported(source, within, place, f"has an amount that depends on {amount}, which actions change")
    for part in amount.children[1:]:
        _check_fixed(source, part, within, place, resources)


def _check_sum(source: Source, amount: Node, within: Node, place: str) -> None:
    """Assure that an amount is a sum of numbers and numeric facts, with numbers as factors."""
    parts = amount.children[1:]
    if amount.lower.startswith("?"):
        raise _unsupported(source, within, place, f"has the amount {amount.word}, which is no number")
    if amount.head in ("+", "-", "*"):
        facts = [part for part in parts if part.is_list]
        if len(parts) < 2 or (amount.head == "*" and len(facts) > 1):
            raise _unsupported(source, within, place, f"has the amount {start_of(amount)}, which is no sum")
        for part in parts:
            _check_sum(source, part, within, place)
    elif amount.is_list and not amount.head[:1].isalpha():
        raise _unsupported(source, within, place, f"has the amount {start_of(amount)}, which is no sum")


def _is_below_nothing(amount: Node) -> bool:
    try:
        return float(amount.lower) < 0.0
    except ValueError:
        return False


def _unsupported(source: Source, node: Node, place: str, why: str) -> Exception:
    return source.unsupported(node, f"{start_of(node)!r} in {place} {why}; {POSSIBLE}")


# ---------------------------------------------------------------- in what was read


def resources_of(up_problem: UpThing, outside: Mapping[str, str]) -> tuple[Resource, ...]:
    """Take the limits out of a problem's goals, and return what is limited or used up.

    Args:
        up_problem: what unified-planning read; its goals are left without limits.
        outside: the files' spelling by unified-planning's names.
    """
    uses: dict[UpThing, dict[str, UpThing]] = {}
    for action in up_problem.actions:
        for effect in _effects(action):
            if effect.is_increase() and outside[effect.fluent.fluent().name].lower() != _COST:
                used, name = uses.setdefault(effect.fluent, {}), outside[action.name]
                used[name] = used[name] + effect.value if name in used else effect.value
    limits: dict[UpThing, list[Limit]] = {}
    kept = []
    for goal in _parts(up_problem.goals):
        if (goal.is_le() or goal.is_lt()) and goal.arg(0) in uses:
            limits.setdefault(goal.arg(0), []).append(Limit(goal.arg(1), goal.is_lt()))
        else:
            kept.append(goal)
    if limits:
        up_problem.clear_goals()
        for goal in kept:
            up_problem.add_goal(goal)
    return tuple(
        Resource(outside[fluent.fluent().name], fluent, used, tuple(limits.get(fluent, ())))
        for fluent, used in uses.items()
    )


def _effects(action: UpThing) -> Iterator[UpThing]:
    if hasattr(action, "conditions"):
        for effects in action.effects.values():
            yield from effects
    else:
        yield from action.effects


def _parts(goals: Iterable[UpThing]) -> Iterator[UpThing]:
    for goal in goals:
        if goal.is_and():
            yield from _parts(goal.args)
        else:
            yield goal
