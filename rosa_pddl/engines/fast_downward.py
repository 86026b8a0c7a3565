"""Fast Downward as two programs of its own: the translator of PDDL, and the search.

It is licensed under the GPL-3: nothing of it is imported here. Formats and exit codes are those of its documentation,
"translator output format" and "exit codes".
"""

import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeAlias, TypeVar

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.engines.processes import INSTALL_ADVICE, Ended, ProcessHandle
from rosa_pddl.outcomes import Outcome, Trouble
from rosa_pddl.problem import Problem
from rosa_pddl.search import Fact, Rule
from rosa_pddl.validate import text_of

T = TypeVar("T")

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that these two programs stand for: the best plan, and a plan."""
ADDED = ("keep!", "finish!")
"""What the names of the actions begin with that are added for a task that fits any state."""

_KEEP, _FINISH = ADDED
_DONE = "done!"
_MAY = "may!"
_STEP = re.compile(rb"^(\d+) \(\d+\)$", re.MULTILINE)
_LENGTH = re.compile(rb"Plan length: (\d+) step")
_FITS_ANY_STATE = ("--keep-unreachable-facts", "--keep-unimportant-variables")
_OUTCOMES = {
    10: Outcome.UNSOLVABLE_PROVEN,
    11: Outcome.UNSOLVABLE_PROVEN,
    12: Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    20: Outcome.OUT_OF_MEMORY,
    21: Outcome.OUT_OF_TIME,
    22: Outcome.OUT_OF_MEMORY,
    23: Outcome.OUT_OF_TIME,
    34: Outcome.UNSUPPORTED,
}

Effect: TypeAlias = tuple[tuple[Fact, ...], int, int, int]
"""The facts that it depends on, the variable, the value it must have before (-1: any) and the value it gets."""


class Variable(NamedTuple):
    """A variable of a translated task: the layer of axioms that derives it, or -1, and what each value says.

    That is `Atom lit(room)`, `NegatedAtom lit(room)` or `<none of those>`.
    """

    layer: int
    values: tuple[str, ...]


class Operator(NamedTuple):
    """An action with its arguments, in lower case: what must hold and stays so, and what becomes so."""

    name: str
    prevail: tuple[Fact, ...]
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class SasTask:
    """A translated task; its costs are not kept, as none were translated.

    Of each group of mutexes at most one fact holds. Axioms are rules by layer, and the text of their section.
    """

    variables: tuple[Variable, ...]
    mutexes: tuple[tuple[Fact, ...], ...]
    initial: tuple[int, ...]
    goal: tuple[Fact, ...]
    operators: tuple[Operator, ...]
    rules: tuple[Rule, ...]
    axioms: str


# ---------------------------------------------------------------- the programs


def missing_part() -> str | None:
    """Return which of the two programs is not installed, as a file or module; None if both are there."""
    if program() is None:
        return "up_fast_downward"
    return "fast_downward.translate" if translator() is None else None


def translate(domain: str, problem: str, process: ProcessHandle, *, limit_s: float, for_any_state: bool) -> SasTask:
    """Translate PDDL text in so much wall-clock time [s]; raises Trouble, or Cancelled.

    A task for any state keeps what is of no use from the initial state and for the goal.
    """
    with TemporaryDirectory(prefix="rosa_pddl_") as folder:
        place = Path(folder)
        (place / "domain.pddl").write_text(domain, encoding="utf-8")
        (place / "problem.pddl").write_text(problem, encoding="utf-8")
        options = _FITS_ANY_STATE if for_any_state else ()
        ended = process.ask(
            [sys.executable, "-m", "fast_downward.translate", *options, "domain.pddl", "problem.pddl"],
            limit_s=limit_s,
            environment={"PYTHONPATH": str(translator())},
            folder=folder,
        )
        written = place / "output.sas"
        if ended.code != 0 or not written.exists():
            raise _trouble("the translator", ended)
        try:
            return parse(written.read_text(encoding="utf-8"))
        except ValueError as error:
            raise Trouble(Outcome.ENGINE_CRASHED, f"the translator wrote rubbish: {error}") from error


def search(text: str, strategy: str, process: ProcessHandle, *, limit_s: float) -> tuple[int, ...] | Outcome:
    """Search a plan in so much wall-clock time [s]; raises Trouble, or Cancelled.

    Returns the names of its operators, which have to be numbers, or that it is unsolvable.
    """
    command = [str(program()), "--search", strategy, "--internal-plan-file", "/dev/null"]
    ended = process.ask(command, given=text.encode(), limit_s=limit_s)
    if ended.code in (0, 1, 2, 3):
        length = _LENGTH.search(ended.output)
        numbers = tuple(int(number) for number in _STEP.findall(ended.output))
        if length is None or int(length.group(1)) != len(numbers):
            raise Trouble(Outcome.ENGINE_CRASHED, f"the search promised a plan but showed none: {ended.last_words}")
        return numbers
    outcome = _OUTCOMES.get(ended.code)
    if outcome is not None and not outcome.is_trouble:
        return outcome
    raise _trouble("the search", ended)


def _trouble(who: str, ended: Ended) -> Trouble:
    if ended.is_endless:
        return Trouble(Outcome.ENGINE_CRASHED, f"{who} printed without end: {ended.last_words}")
    outcome = _OUTCOMES.get(ended.code, Outcome.ENGINE_CRASHED)
    if outcome is Outcome.ENGINE_CRASHED:
        how = f"was killed by signal {-ended.code}" if ended.code < 0 else f"ended with exit code {ended.code}"
        return Trouble(outcome, f"{who} {how}; {INSTALL_ADVICE}. It said: {ended.last_words}")
    return Trouble(outcome, f"{who} said: {ended.last_words}")


@cache
def program() -> Path | None:
    """Return the file of the search; None if it is not installed."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "downward" / "builds" / "release" / "bin" / "downward"
    return path if path.exists() else None


@cache
def translator() -> Path | None:
    """Return the folder that holds the package of the translator; None if it is not installed."""
    found = find_spec("fast_downward")
    for place in (found.submodule_search_locations or ()) if found is not None else ():
        if (Path(place) / "translate" / "__main__.py").exists():
            return Path(place).parent
    search_program = program()
    if search_program is not None and (search_program.parent / "fast_downward" / "translate" / "__main__.py").exists():
        return search_program.parent
    return None


# ---------------------------------------------------------------- what the translator reads
#
# The names are those of unified-planning's problem, which are unique. Action costs are not written: they are put into
# the translated task, because they may differ each time. What changes between plannings would be folded away by the
# translator. An atom is kept by one more action that makes it true, for the atoms that `may` hold: then the translator
# takes it for something that can be so or not. These actions, and the one that reaches the stand-in for the goal, are
# dropped afterwards.


def written_domain(up_problem: UpThing, alive: Collection[str] | None) -> str:
    """Write the domain file, with the instantaneous actions of `up_problem`, some of whose predicates are kept alive.

    None writes what is planned once only.
    """
    types = [f"{kind.name} - {kind.father.name if kind.father else 'object'}" for kind in up_problem.user_types]
    parts = [f"(define (domain d) (:types {' '.join(types)})"]
    parts.append(f"(:constants {' '.join(f'{thing.name} - {thing.type.name}' for thing in up_problem.all_objects)})")
    predicates = [fluent for fluent in up_problem.fluents if fluent.type.is_bool_type()]
    signatures = [f"({fluent.name} {_typed(fluent.signature)})" for fluent in predicates]
    kept = [fluent for fluent in predicates if fluent.name in (alive or ())]
    signatures += [f"({_MAY}{fluent.name} {_typed(fluent.signature)})" for fluent in kept]
    parts.append(f"(:predicates ({_DONE}) {' '.join(signatures)})")
    parts += [_action(action) for action in up_problem.actions]
    if alive is not None:
        parts += [_keeper(fluent) for fluent in kept]
        parts.append(_as_action(_FINISH, (), "(and)", f"({_DONE})"))
    return "\n".join([*parts, ")"])


def written_problem(problem: Problem, goals: Iterable[UpThing] | None, alive: Iterable[str] = ()) -> str:
    """Write the problem file; without goals that of the stand-in. Atoms that are alive may hold."""
    domain = problem.domain
    facts = [_inside(domain, atom) for atom in sorted(problem.state)]
    facts += [f"({_MAY}{_inside(domain, atom)[1:]}" for atom in alive]
    goal = f"({_DONE})" if goals is None else f"(and {' '.join(map(formula_of, goals))})"
    return "\n".join(["(define (problem p) (:domain d) (:init", *facts, f") (:goal {goal}))"])


def _inside(domain: Domain, atom: str) -> str:
    head, *words = atom[1:-1].lower().split()
    names = [domain.inside["predicate", head], *[domain.inside["object", word] for word in words]]
    return f"({' '.join(names)})"


def _typed(parameters: Iterable[UpThing]) -> str:
    return " ".join(f"?{parameter.name} - {parameter.type.name}" for parameter in parameters)


def _keeper(fluent: UpThing) -> str:
    arguments = "".join(f" ?{parameter.name}" for parameter in fluent.signature)
    atom = f"{fluent.name}{arguments})"
    return _as_action(_KEEP + fluent.name, fluent.signature, f"({_MAY}{atom}", f"({atom}")


def _action(action: UpThing) -> str:
    conditions = " ".join(map(formula_of, action.preconditions))
    effects = " ".join(text for effect in action.effects for text in literals_of(effect))
    return _as_action(action.name, action.parameters, f"(and {conditions})", f"(and {effects})")


def _as_action(name: str, parameters: Iterable[UpThing], precondition: str, effect: str) -> str:
    return f"(:action {name} :parameters ({_typed(parameters)}) :precondition {precondition} :effect {effect})"


def literals_of(effect: UpThing) -> Iterator[str]:
    """Write what an effect makes true and what it makes false, on their conditions; nothing for a number."""
    if not effect.fluent.type.is_bool_type():
        return
    atom, value = formula_of(effect.fluent), effect.value
    for truth, literal in ((True, atom), (False, f"(not {atom})")):
        needed = [] if effect.condition.is_true() else [formula_of(effect.condition)]
        if value.is_bool_constant():
            if bool(value.constant_value()) is not truth:
                continue
        else:
            needed.append(formula_of(value) if truth else f"(not {formula_of(value)})")
        text = f"(when (and {' '.join(needed)}) {literal})" if needed else literal
        yield f"(forall ({_typed(effect.forall)}) {text})" if effect.forall else text


def formula_of(formula: UpThing) -> str:
    """Write a formula in the names of unified-planning's problem."""
    return text_of(None, formula, {})


# ---------------------------------------------------------------- what the translator writes


def parse(text: str) -> SasTask:
    """Read a translated task; raises ValueError if the text is none."""
    lines = iter(text.splitlines())
    try:
        return _task(lines)
    except (StopIteration, RuntimeError) as error:
        raise ValueError("the translated task ends too early") from error


def _task(lines: Iterator[str]) -> SasTask:
    _expect(lines, "begin_version", "3", "end_version", "begin_metric")
    next(lines)
    _expect(lines, "end_metric")
    variables = _several(lines, _variable)
    mutexes = _several(lines, _mutex)
    _expect(lines, "begin_state")
    initial = tuple([int(next(lines)) for _ in variables])
    _expect(lines, "end_state", "begin_goal")
    goal = _facts(lines)
    _expect(lines, "end_goal")
    operators = _several(lines, _operator)
    axioms = list(lines)
    rules = _several(iter(axioms), lambda rest: _rule(rest, variables))
    by_layer = tuple(sorted(rules, key=lambda rule: rule.layer))
    return SasTask(variables, mutexes, initial, goal, operators, by_layer, "\n".join([*axioms, ""]))


def _expect(lines: Iterator[str], *expected: str) -> None:
    for word in expected:
        found = next(lines)
        if found.strip() != word:
            raise ValueError(f"found {found[:40]!r} in a translated task, expected {word!r}")


def _several(lines: Iterator[str], read: Callable[[Iterator[str]], T]) -> tuple[T, ...]:
    return tuple([read(lines) for _ in range(int(next(lines)))])


def _variable(lines: Iterator[str]) -> Variable:
    _expect(lines, "begin_variable")
    next(lines)
    variable = Variable(int(next(lines)), _several(lines, next))
    _expect(lines, "end_variable")
    return variable


def _mutex(lines: Iterator[str]) -> tuple[Fact, ...]:
    _expect(lines, "begin_mutex_group")
    facts = _facts(lines)
    _expect(lines, "end_mutex_group")
    return facts


def _facts(lines: Iterator[str]) -> tuple[Fact, ...]:
    pairs = _several(lines, lambda rest: next(rest).split())
    return tuple([(int(variable), int(value)) for variable, value in pairs])


def _operator(lines: Iterator[str]) -> Operator:
    _expect(lines, "begin_operator")
    name = next(lines).strip()
    prevail = _facts(lines)
    effects = _several(lines, _sas_effect)
    next(lines)
    _expect(lines, "end_operator")
    return Operator(name, prevail, effects)


def _rule(lines: Iterator[str], variables: Sequence[Variable]) -> Rule:
    _expect(lines, "begin_rule")
    needs = _facts(lines)
    variable, _, value = map(int, next(lines).split())
    _expect(lines, "end_rule")
    return Rule(variables[variable].layer, needs, variable, value)


def _sas_effect(lines: Iterator[str]) -> Effect:
    count, *numbers = map(int, next(lines).split())
    conditions = tuple(zip(numbers[: 2 * count : 2], numbers[1 : 2 * count : 2], strict=True))
    variable, before, after = numbers[2 * count :]
    return conditions, variable, before, after
