"""What a plan executor is to reach; may change while it runs."""

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.exceptions import GoalError, nearest
from rosa_pddl.formulas import Condition, conditions
from rosa_pddl.planning.grounding import lock_of

__all__ = ["Goal", "Goals"]


@dataclass(frozen=True)
class Goal:
    """One thing that shall hold in the end.

    Args:
        text: the condition as PDDL.
        expression: the same as unified-planning's expression.
        worth: how much a plan may cost more for it; None if it must be reached.
    """

    text: str
    expression: UpThing
    worth: float | None = None

    @property
    def is_soft(self) -> bool:
        """Whether it may be given up when it costs more than it is worth."""
        return self.worth is not None

    def __str__(self) -> str:
        return self.text if self.worth is None else f"{self.text} worth {self.worth:g}"


class Goals:
    """The goals, in the order in which they were added; at first those of the problem file.

    A condition that is a conjunction is several goals. Change them between ticks, in the thread that ticks.

    Args:
        domain: what `load_domain` returned.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._goals: dict[str, Goal] = {}
        self._version = 0
        for text in domain.goals:
            self._put(text, None)

    @property
    def version(self) -> int:
        """Counts the changes."""
        return self._version

    @property
    def hard(self) -> tuple[Goal, ...]:
        """Those that must be reached."""
        return tuple(goal for goal in self if not goal.is_soft)

    @property
    def soft(self) -> tuple[Goal, ...]:
        """Those that may be given up."""
        return tuple(goal for goal in self if goal.is_soft)

    def add(self, text: str, worth: float | None = None) -> None:
        """Add a goal; one that is there already gets the new worth.

        Args:
            text: a condition such as `(inspected north)`.
            worth: how much a plan may cost more for it, in the unit of the plan's cost (steps, if the problem has no
                metric); None if it must be reached. Of a conjunction, each part is worth it.

        Raises:
            GoalError: it is no text, or the worth is not positive.
            PddlError: the text is no PDDL.
            UnknownNameError: it mentions what the domain does not have.
        """
        if worth is not None and not (isinstance(worth, Real) and 0.0 < worth < float("inf")):
            raise GoalError(f"{text} is worth {worth}, expected more than 0; leave it out if it must be reached")
        before = dict(self._goals)
        self._put(text, worth)
        self._version += before != self._goals

    def drop(self, text: str) -> None:
        """Give up a goal.

        Raises:
            GoalError: it is no text, or there is no such goal.
            PddlError: the text is no PDDL.
            UnknownNameError: it mentions what the domain does not have.
        """
        read = [part.text for part in self._read(text)]
        for one in read:
            if one not in self._goals:
                raise GoalError(f"{one} is not among the goals; {nearest(one, self._goals)}")
        for one in read:
            self._goals.pop(one, None)
        self._version += 1

    def replace(self, *texts: str) -> None:
        """Put other goals, which must be reached, in place of all there are; none at all leaves nothing to do.

        Raises:
            GoalError: one is no text.
            PddlError: a text is no PDDL.
            UnknownNameError: one mentions what the domain does not have.
        """
        read = [part for text in texts for part in self._read(text)]
        before, self._goals = self._goals, {part.text: Goal(part.text, part.expression) for part in read}
        self._version += before != self._goals

    def __contains__(self, text: object) -> bool:
        return text in self._goals

    def __iter__(self) -> Iterator[Goal]:
        return iter(tuple(self._goals.values()))

    def __len__(self) -> int:
        return len(self._goals)

    def __repr__(self) -> str:
        return f"Goals({', '.join(str(goal) for goal in self)})"

    def _put(self, text: str, worth: float | None) -> None:
        for part in self._read(text):
            self._goals[part.text] = Goal(part.text, part.expression, worth)

    def _read(self, text: str) -> tuple[Condition, ...]:
        if not isinstance(text, str):
            raise GoalError(f"{text!r} is no goal, expected a condition as text such as '(inspected north)'")
        # a planner may be reading the same environment of unified-planning, in a thread of its own
        with lock_of(self._domain):
            return conditions(self._domain, text)
