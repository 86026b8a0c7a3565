"""Tasks as Fast Downward's translator writes them, and its search reads them: variables that have one of some values.

The format is described in Fast Downward's documentation, "translator output format".
"""

from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["Axiom", "Effect", "Fact", "Operator", "SasTask", "Variable", "parse"]

Fact = tuple[int, int]
"""A variable and one of its values, both counted from 0."""
Effect = tuple[tuple[Fact, ...], int, int, int]
"""The facts that it depends on, the variable, the value it must have before (-1: any) and the value it gets."""


@dataclass(frozen=True)
class Variable:
    """A variable of the task.

    Args:
        layer: -1, or the layer of axioms that derives it.
        values: what each value says, such as `Atom lit(room)`, `NegatedAtom lit(room)` or `<none of those>`.
    """

    layer: int
    values: tuple[str, ...]


@dataclass(frozen=True)
class Operator:
    """An action with its arguments.

    Args:
        name: the action and its arguments, in lower case.
        prevail: what must hold and stays so.
        effects: what becomes so.
    """

    name: str
    prevail: tuple[Fact, ...]
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Axiom:
    """A rule that derives the value of a variable.

    Args:
        needs: what must hold.
        variable: what is derived.
        value: what it becomes.
    """

    needs: tuple[Fact, ...]
    variable: int
    value: int


@dataclass(frozen=True)
class SasTask:
    """A translated task; its costs are not kept, as none were translated.

    Args:
        variables: by number.
        mutexes: groups of facts of which at most one holds.
        initial: the value of each variable.
        goal: the facts that shall hold.
        operators: in the order of the file.
        axioms: the text of the section of axioms, from its count on.
    """

    variables: tuple[Variable, ...]
    mutexes: tuple[tuple[Fact, ...], ...]
    initial: tuple[int, ...]
    goal: tuple[Fact, ...]
    operators: tuple[Operator, ...]
    axioms: str

    @property
    def has_axioms(self) -> bool:
        """Whether anything is derived by axioms."""
        return self.axioms.split("\n", 1)[0] != "0"

    def rules(self) -> tuple[Axiom, ...]:
        """Return the axioms, by layer.

        Raises:
            ValueError: their text is none.
        """
        lines = iter(self.axioms.splitlines())
        found = [_axiom(lines) for _ in range(int(next(lines)))]
        return tuple(sorted(found, key=lambda axiom: self.variables[axiom.variable].layer))


def parse(text: str) -> SasTask:
    """Read a translated task.

    Raises:
        ValueError: the text is no such task.
    """
    lines = iter(text.splitlines())
    try:
        return _task(lines)
    except (StopIteration, RuntimeError) as error:
        raise ValueError("the translated task ends too early") from error


def _task(lines: Iterator[str]) -> SasTask:
    _expect(lines, "begin_version", "3", "end_version", "begin_metric")
    next(lines)
    _expect(lines, "end_metric")
    variables = tuple([_variable(lines) for _ in range(int(next(lines)))])
    mutexes = tuple([_mutex(lines) for _ in range(int(next(lines)))])
    _expect(lines, "begin_state")
    initial = tuple([int(next(lines)) for _ in variables])
    _expect(lines, "end_state", "begin_goal")
    goal = _facts(lines)
    _expect(lines, "end_goal")
    operators = tuple([_operator(lines) for _ in range(int(next(lines)))])
    return SasTask(variables, mutexes, initial, goal, operators, "\n".join([*lines, ""]))


def _expect(lines: Iterator[str], *expected: str) -> None:
    for word in expected:
        found = next(lines)
        if found.strip() != word:
            raise ValueError(f"found {found[:40]!r} in a translated task, expected {word!r}")


def _variable(lines: Iterator[str]) -> Variable:
    _expect(lines, "begin_variable")
    next(lines)
    layer = int(next(lines))
    values = tuple([next(lines) for _ in range(int(next(lines)))])
    _expect(lines, "end_variable")
    return Variable(layer, values)


def _mutex(lines: Iterator[str]) -> tuple[Fact, ...]:
    _expect(lines, "begin_mutex_group")
    facts = _facts(lines)
    _expect(lines, "end_mutex_group")
    return facts


def _facts(lines: Iterator[str]) -> tuple[Fact, ...]:
    return tuple([_fact(next(lines)) for _ in range(int(next(lines)))])


def _fact(line: str) -> Fact:
    variable, value = line.split()
    return int(variable), int(value)


def _operator(lines: Iterator[str]) -> Operator:
    _expect(lines, "begin_operator")
    name = next(lines).strip()
    prevail = _facts(lines)
    effects = tuple([_effect(next(lines)) for _ in range(int(next(lines)))])
    next(lines)
    _expect(lines, "end_operator")
    return Operator(name, prevail, effects)


def _axiom(lines: Iterator[str]) -> Axiom:
    _expect(lines, "begin_rule")
    needs = _facts(lines)
    variable, _, value = map(int, next(lines).split())
    _expect(lines, "end_rule")
    return Axiom(needs, variable, value)


def _effect(line: str) -> Effect:
    count, *numbers = map(int, line.split())
    conditions = tuple(zip(numbers[: 2 * count : 2], numbers[1 : 2 * count : 2], strict=True))
    variable, before, after = numbers[2 * count :]
    return conditions, variable, before, after
