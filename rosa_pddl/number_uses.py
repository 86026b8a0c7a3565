"""What the numbers of a domain are for: costs and resources that steps add up, or what effects change."""

from collections.abc import Iterator
from typing import NamedTuple

from rosa_pddl.formulas import CHANGES, COMPARISONS, numbers_of
from rosa_pddl.syntax import BODY, Node, Source, section

_COST = "total-cost"


class _Change(NamedTuple):
    """An effect on a number, and whether it comes about in any case."""

    kind: str
    target: Node
    amount: Node
    is_certain: bool


class NumberUses:
    """Sorts the numbers of two files by what is done with them.

    Attributes:
        names: of all numbers but `total-cost`, in lower case, as in the following.
        changed: those that actions change.
        rising: those without arguments that actions only increase, in any case.
        resources: of these what rises by sums of what none changes, no condition or cost reads, and the goal only
            limits: what is used up is added up.
        computed: those that are part of a state, as the files spell them: what conditions read, and what is changed.
    """

    def __init__(self, domain: Source, problem: Source) -> None:
        signatures = {node.head: node for node in section(domain, ":functions") if node.is_list and node.head != _COST}
        self.names = frozenset(signatures)
        bodies = [node for node in domain.root.children[2:] if node.head in BODY]
        changes = [change for body in bodies for change in _changes(body, is_certain=True)]
        self.changed = frozenset(change.target.head for change in changes) & self.names
        goals = [goal for node in section(problem, ":goal") for goal in parts_of(node)]
        read = {name for body in bodies for name in self._read(body)}
        read |= {name for node in domain.root.children[2:] if node.head == ":derived" for name in self._read(node)}
        plain = frozenset(name for name in self.changed if len(signatures[name].children) == 1)
        self.rising = plain - {one.target.head for one in changes if not _is_rise(one)}
        read |= {name for one in changes for name in numbers_of(one.amount, self.changed) if one.target.head == _COST}
        read |= {one.target.head for one in changes if not self._is_fixed_sum(one.amount)} & self.names
        limits = [goal for goal in goals if self._is_limit(goal)]
        read |= {name for goal in goals if goal not in limits for name in self._read(goal)}
        self.resources = self.rising - read
        limits = [goal for goal in limits if sides_of(goal)[0].head in self.resources]
        read |= {name for goal in goals if goal not in limits for name in self._read(goal)}
        computed = read | (self.changed - self.resources)
        for change in changes:
            if change.target.head in computed:
                computed |= numbers_of(change.amount, self.names)
        self.computed = frozenset(str(signatures[name].children[0]) for name in computed)

    def _read(self, node: Node) -> set[str]:
        """Return the numbers that comparisons read, other than those of a duration."""
        if node.head in (*COMPARISONS, "=") and all(part.lower != "?duration" for part in node.children):
            return numbers_of(node, self.names)
        return {name for part in node.children for name in self._read(part)}

    def _is_limit(self, goal: Node) -> bool:
        if goal.head not in COMPARISONS or len(goal.children) != 3:
            return False
        left, right = sides_of(goal)
        return left.head in self.rising and self._is_fixed_sum(right)

    def _is_fixed_sum(self, amount: Node) -> bool:
        """Whether an amount is a sum of numbers that no action changes, with constants as factors."""
        head, parts = amount.head, amount.children[1:]
        if not amount.is_list or head in self.names:
            return head not in self.changed and not amount.lower.startswith("?")
        is_product = head == "*" and len([part for part in parts if part.is_list]) > 1
        return head in ("+", "-", "*") and len(parts) > 1 and not is_product and all(map(self._is_fixed_sum, parts))


def _changes(node: Node, *, is_certain: bool) -> Iterator[_Change]:
    if node.head in CHANGES and len(node.children) == 3:
        yield _Change(node.head, *node.children[1:], is_certain)
        return
    for part in node.children:
        yield from _changes(part, is_certain=is_certain and node.head not in ("when", "forall"))


def _is_rise(change: _Change) -> bool:
    return change.kind == "increase" and change.is_certain and not change.amount.lower.startswith("-")


def parts_of(node: Node) -> Iterator[Node]:
    """Yield the parts of a conjunction that are none."""
    if node.head == "and":
        for part in node.children[1:]:
            yield from parts_of(part)
    elif node.children or not node.is_list:
        yield node


def sides_of(goal: Node) -> tuple[Node, Node]:
    """Return the less and the greater side of a comparison."""
    one, other = goal.children[1:] if goal.head in ("<", "<=") else goal.children[:0:-1]
    return one, other
