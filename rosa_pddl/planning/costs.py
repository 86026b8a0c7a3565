"""What steps cost: sums of numbers and of numeric facts such as `(travel_cost a b)`, which may differ each time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from rosa_pddl.domain import Domain, Step, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.problem import Problem

__all__ = ["CostSum", "Costs", "Numbers"]

Numbers = Mapping[str, float]
"""The values of numeric facts by their text."""


@dataclass(frozen=True)
class CostSum:
    """A constant, and numeric facts with their factors.

    Args:
        constant: added to the rest.
        terms: factor and text of each numeric fact.
    """

    constant: float
    terms: tuple[tuple[float, str], ...] = ()

    def value(self, numbers: Numbers) -> float:
        """Return the sum.

        Raises:
            KeyError: a numeric fact has no value.
        """
        return self.constant + sum(factor * numbers[key] for factor, key in self.terms)


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
        self._sums: dict[str, tuple[tuple[str, ...], _Template]] = {}
        for action in up_problem.actions:
            cost = None if metric is None else metric.get_action_cost(action)
            parameters = tuple(f"?{parameter.name}" for parameter in action.parameters)
            fixed = 1.0 if metric is None else 0.0
            template = _Template(fixed, ()) if cost is None else _template(domain, cost)
            self._sums[domain.outside[action.name]] = (parameters, template)
        self._told = dict(_numbers_of_the_file(domain))

    def of(self, step: Step) -> CostSum:
        """Return what a step costs."""
        parameters, template = self._sums[step.schema]
        binding = dict(zip(parameters, step.arguments, strict=True))
        terms = [(factor, " ".join(binding.get(word, word) for word in words)) for factor, words in template.terms]
        return CostSum(template.constant, tuple((factor, f"({text})") for factor, text in terms))

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
        key = str(error.args[0])
        message = f"{key} is a cost but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the problem"
        return UnsupportedPddlError(f"{message} ({nearest(key, list(numbers)[:1000])})", self._file)


@dataclass(frozen=True)
class _Template:
    """A sum with parameters: of each term the factor and the words, of which those with a mark are parameters."""

    constant: float
    terms: tuple[tuple[float, tuple[str, ...]], ...]

    def scaled(self, factor: float) -> "_Template":
        return _Template(factor * self.constant, tuple((factor * weight, words) for weight, words in self.terms))

    def plus(self, other: "_Template") -> "_Template":
        return _Template(self.constant + other.constant, self.terms + other.terms)


def _template(domain: Domain, cost: UpThing) -> _Template:
    if cost.is_constant():
        return _Template(float(cost.constant_value()), ())
    if cost.is_fluent_exp():
        words = [domain.outside[cost.fluent().name]]
        for part in cost.args:
            parameter = part.is_parameter_exp()
            words.append(f"?{part.parameter().name}" if parameter else domain.outside[part.object().name])
        return _Template(0.0, ((1.0, tuple(words)),))
    parts = [_template(domain, part) for part in cost.args]
    if cost.is_plus():
        return _summed(parts)
    if cost.is_minus():
        return parts[0].plus(parts[1].scaled(-1.0))
    if cost.is_times():
        numbers = [part for part in parts if not part.terms]
        if len(numbers) >= len(parts) - 1:
            product = next((part for part in parts if part.terms), _Template(1.0, ()))
            for number in numbers:
                product = product.scaled(number.constant)
            return product
    message = f"the cost {cost} is no sum of numbers and numeric facts; Fast Downward plans with those only"
    raise UnsupportedPddlError(message, domain.file)


def _summed(parts: Iterable[_Template]) -> _Template:
    total = _Template(0.0, ())
    for part in parts:
        total = total.plus(part)
    return total


def _numbers_of_the_file(domain: Domain) -> Iterable[tuple[str, float]]:
    for expression, value in domain.up_problem.explicit_initial_values.items():
        if not value.is_bool_constant():
            words = [expression.fluent().name, *(argument.object().name for argument in expression.args)]
            yield f"({' '.join(domain.outside[word] for word in words)})", float(value.constant_value())
