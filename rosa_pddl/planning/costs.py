"""What steps cost."""

from collections.abc import Iterable

from rosa_pddl.domain import Domain, Step, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.sums import (
    Numbers,
    Sum,
    Template,
    arguments_of,
    missing_number,
    numbers_of_the_file,
    template_of,
)
from rosa_pddl.problem import Problem

__all__ = ["Costs"]


class Costs:
    """The costs of the steps of a domain: those of its metric, or 1 for each step if it has none.

    Args:
        domain: what `load_domain` returned.
        up_problem: the same with instantaneous actions.

    Raises:
        UnsupportedPddlError: a cost is no sum of numbers and numeric facts.
    """

    def __init__(self, domain: Domain, up_problem: UpThing) -> None:
        self._file = domain.problem_file
        metric = up_problem.quality_metrics[0] if up_problem.quality_metrics else None
        self._templates: dict[str, Template] = {}
        for action in up_problem.actions:
            cost = None if metric is None else metric.get_action_cost(action)
            fixed = 1 if metric is None else 0
            self._templates[domain.outside[action.name]] = (
                Template(fixed) if cost is None else template_of(domain, cost)
            )
        self._schemas = domain.schema_of
        self._told = {text: float(value) for text, value in numbers_of_the_file(domain)}

    def of(self, step: Step) -> Sum:
        """Return what a step costs."""
        return self._templates[step.schema].bound(arguments_of(self._schemas[step.schema], step))

    def numbers(self, problem: Problem) -> Numbers:
        """Return the values of numeric facts: those of the problem file, or what the problem says instead."""
        atom = problem.domain.atom
        return {**self._told, **{atom(text): value for text, value in problem.costs.items()}}

    def total(self, steps: Iterable[Step], numbers: Numbers) -> float:
        """Return what a plan costs.

        Raises:
            UnsupportedPddlError: a numeric fact has no value.
        """
        try:
            return sum(self.of(step).value(numbers) for step in steps)
        except KeyError as error:
            raise self.missing(error, numbers) from error

    def missing(self, error: KeyError, numbers: Numbers) -> UnsupportedPddlError:
        """Make the error that says which numeric fact has no value."""
        return missing_number(error, numbers, self._file)
