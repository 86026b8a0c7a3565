"""What is left of a mission when actions fail: for every combination of feasible ones, whether the goal is in reach.

Each entry is a planning of its own from there, so it is as exact as the planner is.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import chain, combinations
from math import comb
from pathlib import Path
from typing import Protocol

from rosa_pddl.domain import Domain
from rosa_pddl.exceptions import PlannerSettingError
from rosa_pddl.outcomes import Outcome, PlanningResult
from rosa_pddl.problem import Problem
from rosa_pddl.validate import flaw

_MOST_ENTRIES = 1 << 14


@dataclass(frozen=True)
class Certificate:
    """An answer of the planner for each combination of unfeasible actions, those with few of them first.

    Args:
        entries: the answers by the unfeasible ROSA actions, in the order of the domain; all others are feasible.
    """

    entries: dict[tuple[str, ...], PlanningResult]

    @classmethod
    def load(cls, path: str | Path, domain: Domain) -> "Certificate":
        """Read what `rosa plan --certificate --json` wrote; PlannerSettingError if it is none of this domain."""
        try:
            entries = dict[tuple[str, ...], PlanningResult]()
            for one in json.loads(Path(path).read_text())["entries"]:
                steps = tuple(domain.step(step["action"], step["arguments"]) for step in one["steps"])
                result = PlanningResult(Outcome(one["outcome"]), steps, one["engine"], cost=one["cost"])
                entries[tuple(one["unfeasible"])] = result
            return cls(entries)
        except (OSError, ValueError, KeyError, TypeError) as error:
            message = f"{path} is no certificate of {domain.file} ({type(error).__name__}: {error})"
            raise PlannerSettingError(f"{message}; write one with rosa plan --certificate --json") from error

    def prepared(self, problem: Problem) -> PlanningResult | None:
        """Return the plan for what is unfeasible in a problem, or as little of its end as works there; None if none.

        What is forecast to become unfeasible may have to be taken as that already.
        """
        domain, state, until = problem.domain, problem.state, problem.until
        atoms = {domain.feasible_atom(one): one for one in domain.rosa_actions}
        left_out = {step for step, times in problem.weights.items() if not times}
        for lasting in (state, state - until.keys()) if until else (state,):
            actions = tuple(one for atom, one in atoms.items() if atom not in lasting)
            found = self.entries.get(actions, PlanningResult(Outcome.UNSUPPORTED))
            for count in range(1, 1 + len(found.steps)):
                rest = found.steps[-count:]
                if left_out.isdisjoint(rest) and flaw(domain, rest, state, problem.wanted, until) is None:
                    return replace(found, outcome=Outcome.SOLVED, steps=rest, schedule=())
        return None

    @property
    def fatal(self) -> tuple[str, ...]:
        """The actions whose failure alone ends a mission that could be done."""
        if not self.entries[()].outcome.is_solved:
            return ()
        alone = {out[0]: result.outcome for out, result in self.entries.items() if len(out) == 1}
        return tuple(action for action, outcome in alone.items() if outcome.is_unsolvable)


class Plans(Protocol):
    """What a certificate needs of a planner."""

    def plan(self, problem: Problem) -> PlanningResult: ...


def certificate(
    domain: Domain, supposing: Callable[[Iterable[str]], Problem], planner: Plans, failures: int | None = None
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
