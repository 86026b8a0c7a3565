"""The leaves of a plan's tree that ask and change what is believed."""

from collections.abc import Callable

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl import Domain, State
from rosa_pddl.belief import Belief
from rosa_pddl.formulas import conditions
from rosa_pddl.reading.syntax import Node, parse
from rosa_pddl.validate import holds

__all__ = ["Assume", "Holds"]

Change = Callable[[State], tuple[set[str], set[str]]]
"""From a state to the atoms that become false, and those that become true."""


class Holds(Behaviour):
    """Condition: SUCCESS while a formula such as `(and (lit hall) (not (broken hall)))` holds; it is called by that.

    Raises:
        rosa_pddl.RosaPddlError: it is no formula about what the domain has.
    """

    def __init__(self, belief: Belief, condition: str) -> None:
        super().__init__(condition)
        self._belief = belief
        self._parts = conditions(belief.domain, condition)

    def update(self) -> Status:
        """Look at what is believed."""
        state = self._belief.observe()
        for part in self._parts:
            if not holds(self._belief.domain, part.expression, {}, state):
                self.feedback_message = f"{part} does not hold"
                return Status.FAILURE
        self.feedback_message = ""
        return Status.SUCCESS


class Assume(Behaviour):
    """Action: believes effects such as `(and (scanned hall) (when (lit hall) (not (lit hall))))`.

    Raises:
        rosa_pddl.RosaPddlError: these are no effects on what the domain has.
    """

    def __init__(self, belief: Belief, effects: str) -> None:
        super().__init__(f"assume {effects}")
        self._belief = belief
        self._changes = [_change(belief.domain, node) for node in _parts(parse(effects, f"effects {effects!r}").root)]

    def update(self) -> Status:
        """Change what is believed."""
        state = self._belief.observe()
        told = [change(state) for change in self._changes]
        self._belief.assume({atom for gone, _ in told for atom in gone}, {atom for _, come in told for atom in come})
        return Status.SUCCESS


def _parts(node: Node) -> list[Node]:
    if node.head != "and":
        return [node]
    return [part for child in node.children[1:] for part in _parts(child)]


def _change(domain: Domain, node: Node) -> Change:
    if node.head == "when" and len(node.children) == 3:
        needed = conditions(domain, str(node.children[1]))
        then = [_change(domain, part) for part in _parts(node.children[2])]

        def change(state: State) -> tuple[set[str], set[str]]:
            if not all(holds(domain, part.expression, {}, state) for part in needed):
                return set(), set()
            told = [inner(state) for inner in then]
            return set().union(*(gone for gone, _ in told)), set().union(*(come for _, come in told))

        return change
    is_deleted = node.head == "not" and len(node.children) == 2
    atom = domain.atom(str(node.children[1] if is_deleted else node))
    return lambda state: ({atom}, set()) if is_deleted else (set(), {atom})
