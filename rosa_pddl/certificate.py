"""What is left of a mission when actions fail: for every combination of feasible ones, whether the goal is in reach.

Each entry is a planning of its own from there, so it is as exact as the planner is.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, combinations
from math import comb

from rosa_pddl.domain import Domain
from rosa_pddl.exceptions import PlannerSettingError
from rosa_pddl.outcomes import PlanningResult
from rosa_pddl.planner import Planner
from rosa_pddl.problem import Problem

_MOST_ENTRIES = 1 << 14


@dataclass(frozen=True)
class Certificate:
    """An answer of the planner for each combination of unfeasible actions, those with few of them first.

    Args:
        entries: the answers by the unfeasible ROSA actions, in the order of the domain; all others are feasible.
    """

    entries: dict[tuple[str, ...], PlanningResult]

    @property
    def fatal(self) -> tuple[str, ...]:
        """The actions whose failure alone ends a mission that could be done."""
        if not self.entries[()].outcome.is_solved:
            return ()
        alone = {out[0]: result.outcome for out, result in self.entries.items() if len(out) == 1}
        return tuple(action for action, outcome in alone.items() if not outcome.is_solved and not outcome.is_trouble)


def certificate(
    domain: Domain, supposing: Callable[[Iterable[str]], Problem], planner: Planner, failures: int | None = None
) -> Certificate:
    """Find out what can be reached with every combination of feasible actions.

    Args:
        domain: what `load_domain` returned.
        supposing: returns what to plan while just these ROSA actions are unfeasible.
        planner: plans; one that is warm answers most questions within a millisecond.
        failures: look at combinations of at most so many unfeasible actions; None for all.

    Raises:
        PlannerSettingError: that many combinations there are not, or too many.
    """
    actions = domain.rosa_actions
    most = len(actions) if failures is None else failures
    if not 0 <= most <= len(actions):
        raise PlannerSettingError(f"failures is {most}, expected 0 to {len(actions)}, as so many actions there are")
    total = sum(comb(len(actions), count) for count in range(most + 1))
    if total > _MOST_ENTRIES:
        message = f"{total} combinations of {len(actions)} actions are too many (at most {_MOST_ENTRIES})"
        raise PlannerSettingError(f"{message}; look at fewer failures at once, such as failures=2")
    chosen = chain.from_iterable(combinations(actions, count) for count in range(most + 1))
    return Certificate({out: planner.plan(supposing(out)) for out in chosen})
