"""What came of a question for a plan, to be printed, written and drawn."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from py_trees.behaviours import Success

from missions.planning.causes import CausalOrder, causal_order
from missions.planning.diagnosis import why_unsolvable
from missions.planning.question import Question
from missions.planning.tree import plan_tree
from rosa_bt import export_xml
from rosa_bt.display import ascii_tree
from rosa_pddl import Outcome, Planner, PlanningResult

__all__ = ["Answer", "answer"]

_UNSOLVABLE = (Outcome.UNSOLVABLE_PROVEN, Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN)


@dataclass(frozen=True)
class Answer:
    """A plan, or why there is none.

    Attributes:
        question: what was asked.
        result: what the planner answered.
        obstacles: why there is no plan, in sentences.
    """

    question: Question
    result: PlanningResult
    obstacles: tuple[str, ...] = ()

    @property
    def data(self) -> dict[str, Any]:
        """Outcome, engine, cost and steps, as JSON has them."""
        steps = [{"action": step.schema, "arguments": list(step.arguments)} for step in self.result.steps]
        result = self.result
        return {"outcome": str(result.outcome), "engine": result.engine, "cost": result.cost, "steps": steps}

    @property
    def order(self) -> CausalOrder:
        """Why the steps come in their order."""
        goals = [goal.expression for goal in self.question.goals]
        return causal_order(self.question.domain, self.result.steps, self.question.state, goals)

    def lines(self) -> Iterator[str]:
        """Yield the plan, a line for each step with the steps that it needs, or why there is none."""
        result = self.result
        if not result.outcome.is_solved:
            yield f"no plan: {result.message or result.outcome}"
            yield from (f"  {obstacle}" for obstacle in self.obstacles)
        else:
            steps = "1 step" if len(result.steps) == 1 else f"{len(result.steps)} steps"
            yield f"{result.outcome} by {result.engine}: {steps}, cost {result.cost or 0:g}"
            links = self.order.links
            for number, step in enumerate(result.steps):
                needs = [f"{' '.join(link.needs)} by {link.source + 1}" for link in links if link.target == number]
                yield f"  {number + 1}  {step}" + (f"  needs {', '.join(needs)}" if needs else "")
        kb = self.question.kb
        yield from (f"out: {kb.why(kb.actions[action])}" for action in self.question.unfeasible)
        yield from (f"note: {oversight}" for oversight in self.question.oversights)

    def tree(self, *, xml: bool) -> str:
        """Return the tree that executes the plan, as BehaviorTree.CPP's XML or as a picture in text."""
        domain = self.question.domain
        idle = dict.fromkeys(domain.schemas, lambda step: Success(str(step)))
        tree = plan_tree(domain, self.result.steps, kb=self.question.kb, behaviours=idle)
        return export_xml(tree) if xml else ascii_tree(tree)


def answer(question: Question, timeout_s: float) -> Answer:
    """Plan with what the mission plans with, or else what the domain needs; if there is no plan, find out why.

    Within limits it is label setting that plans, and otherwise Fast Downward and then Aries.

    Args:
        question: what to plan.
        timeout_s: wall-clock time for each planning [s].

    Raises:
        rosa_pddl.PlannerSettingError: the time is not positive.
    """
    usual = ("label-setting",) if question.domain.limited else ("fast-downward-opt", "aries")
    engine, *fallback = question.engines or usual
    planner = Planner(engine, timeout_s, warm=False, fallback=fallback)
    try:
        result = planner.plan(question.problem)
        obstacles = why_unsolvable(question, planner.plan) if result.outcome in _UNSOLVABLE else []
    finally:
        planner.close()
    return Answer(question, result, tuple(obstacles))
