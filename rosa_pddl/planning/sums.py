"""Sums of numbers and of numeric facts such as `(travel_cost a b)`, whose values may differ each time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from rosa_pddl.domain import Domain, Schema, Step, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.problem import Exact, exact

__all__ = [
    "ExactNumbers",
    "Numbers",
    "Sum",
    "Template",
    "arguments_of",
    "missing_number",
    "numbers_of_the_file",
    "template_of",
]

Numbers = Mapping[str, float]
"""The values of numeric facts by their text."""
ExactNumbers = Mapping[str, Exact]
"""The same, with decimals taken as they are written."""


@dataclass(frozen=True)
class Sum:
    """A constant, and numeric facts with their factors.

    Args:
        constant: added to the rest.
        terms: factor and text of each numeric fact.
    """

    constant: Exact
    terms: tuple[tuple[Exact, str], ...] = ()

    def value(self, numbers: Numbers) -> float:
        """Return the sum.

        Raises:
            KeyError: a numeric fact has no value.
        """
        return float(self.constant + sum(factor * numbers[key] for factor, key in self.terms))

    def exact_value(self, numbers: ExactNumbers) -> Exact:
        """Return the sum without rounding anything.

        Raises:
            KeyError: a numeric fact has no value.
        """
        return self.constant + sum(factor * numbers[key] for factor, key in self.terms)


@dataclass(frozen=True)
class Template:
    """A sum with parameters.

    Args:
        constant: added to the rest.
        terms: factor and words of each numeric fact; words with a mark are parameters.
    """

    constant: Exact
    terms: tuple[tuple[Exact, tuple[str, ...]], ...] = ()

    def bound(self, binding: Mapping[str, str]) -> Sum:
        """Return the sum with its parameters, such as `?x`, replaced by what they are bound to."""
        terms = [(factor, " ".join(binding.get(word, word) for word in words)) for factor, words in self.terms]
        return Sum(self.constant, tuple((factor, f"({text})") for factor, text in terms))

    def scaled(self, factor: Exact) -> "Template":
        """Return the sum times a factor."""
        return Template(factor * self.constant, tuple((factor * weight, words) for weight, words in self.terms))

    def plus(self, other: "Template") -> "Template":
        """Return the sum of both."""
        return Template(self.constant + other.constant, self.terms + other.terms)


def arguments_of(schema: Schema, step: Step) -> Mapping[str, str]:
    """Return what the parameters of a step's action, such as `?x`, are bound to."""
    return {f"?{name}": word for (name, _), word in zip(schema.parameters, step.arguments, strict=True)}


def missing_number(error: KeyError, numbers: Mapping[str, object], file: str) -> UnsupportedPddlError:
    """Make the error that says which numeric fact has no value."""
    key = str(error.args[0])
    message = f"{key} is needed but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the problem"
    return UnsupportedPddlError(f"{message} ({nearest(key, list(numbers)[:1000])})", file)


def template_of(domain: Domain, cost: UpThing) -> Template:
    """Return an amount as a sum.

    Raises:
        UnsupportedPddlError: it is none.
    """
    if cost.is_constant():
        return Template(exact(cost.constant_value()))
    if cost.is_fluent_exp():
        words = [domain.outside[cost.fluent().name]]
        for part in cost.args:
            parameter = part.is_parameter_exp()
            words.append(f"?{part.parameter().name}" if parameter else domain.outside[part.object().name])
        return Template(0, ((1, tuple(words)),))
    parts = [template_of(domain, part) for part in cost.args]
    if cost.is_plus():
        return _summed(parts)
    if cost.is_minus():
        return parts[0].plus(parts[1].scaled(-1))
    if cost.is_times():
        numbers = [part for part in parts if not part.terms]
        if len(numbers) >= len(parts) - 1:
            product = next((part for part in parts if part.terms), Template(1))
            for number in numbers:
                product = product.scaled(number.constant)
            return product
    message = f"the cost {cost} is no sum of numbers and numeric facts; Fast Downward plans with those only"
    raise UnsupportedPddlError(message, domain.file)


def _summed(parts: Iterable[Template]) -> Template:
    total = Template(0)
    for part in parts:
        total = total.plus(part)
    return total


def numbers_of_the_file(domain: Domain) -> Iterable[tuple[str, Exact]]:
    """Yield the numeric facts that the problem file states, with their values."""
    for expression, value in domain.up_problem.explicit_initial_values.items():
        if not value.is_bool_constant():
            words = [expression.fluent().name, *(argument.object().name for argument in expression.args)]
            yield f"({' '.join(domain.outside[word] for word in words)})", exact(value.constant_value())
