"""Fast Downward as two programs of its own: the translator of PDDL, and the search.

It is licensed under the GPL-3: nothing of it is imported here. Formats and exit codes are those of its documentation,
"translator output format" and "exit codes".
"""

import re
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeAlias

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.engines.processes import Ended, ProcessHandle
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.outcomes import Outcome, Trouble
from rosa_pddl.problem import Problem
from rosa_pddl.search import Fact, Rule

__all__ = [
    "ADDED",
    "Effect",
    "INSTALL_ADVICE",
    "Operator",
    "SEARCHES",
    "SasTask",
    "Variable",
    "missing_part",
    "parse",
    "program",
    "search",
    "translate",
    "translator",
    "written_domain",
    "written_problem",
]

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that these two programs stand for: the best plan, and a plan."""
ADDED = ("keep!", "finish!")
"""What the names of the actions begin with that are added for a task that fits any state."""
INSTALL_ADVICE = "try 'pip install --force-reinstall up-fast-downward'"
"""What to do when a program does not work."""

_KEEP, _FINISH = ADDED
_DONE = "done!"
_MAY = "may!"
_HEADS = {"AND": "and", "OR": "or", "NOT": "not", "IMPLIES": "imply", "EQUALS": "="}
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
    """A variable of a translated task.

    Attributes:
        layer: -1, or the layer of axioms that derives it.
        values: what each value says, such as `Atom lit(room)`, `NegatedAtom lit(room)` or `<none of those>`.
    """

    layer: int
    values: tuple[str, ...]


class Operator(NamedTuple):
    """An action with its arguments.

    Attributes:
        name: the action and its arguments, in lower case.
        prevail: what must hold and stays so.
        effects: what becomes so.
    """

    name: str
    prevail: tuple[Fact, ...]
    effects: tuple[Effect, ...]


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

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The axioms, by layer."""
        lines = iter(self.axioms.splitlines())
        found = [_rule(lines, self.variables) for _ in range(int(next(lines)))]
        return tuple(sorted(found, key=lambda rule: rule.layer))


# ---------------------------------------------------------------- the programs


def missing_part() -> str | None:
    """Return which of the two programs is not installed, as a file or module; None if both are there."""
    if program() is None:
        return "up_fast_downward"
    return "fast_downward.translate" if translator() is None else None


def translate(domain: str, problem: str, process: ProcessHandle, *, limit_s: float, for_any_state: bool) -> SasTask:
    """Translate a task.

    Args:
        domain: PDDL text.
        problem: PDDL text.
        process: runs the program.
        limit_s: wall-clock time that it may take [s].
        for_any_state: whether to keep what is of no use from the initial state and for the goal.

    Raises:
        Trouble: there is no translated task.
        Cancelled: it is not wanted any more.
    """
    with TemporaryDirectory(prefix="rosa_pddl_") as folder:
        place = Path(folder)
        (place / "domain.pddl").write_text(domain, encoding="utf-8")
        (place / "problem.pddl").write_text(problem, encoding="utf-8")
        options = _FITS_ANY_STATE if for_any_state else ()
        ended = _run(
            process,
            [sys.executable, "-m", "fast_downward.translate", *options, "domain.pddl", "problem.pddl"],
            limit_s=limit_s,
            environment={"PYTHONPATH": str(translator()), "PYTHONDONTWRITEBYTECODE": "1"},
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
    """Search a plan.

    Args:
        text: the task.
        strategy: how, in the words of Fast Downward.
        process: runs the program.
        limit_s: wall-clock time that it may take [s].

    Returns:
        The names of the operators of the plan, which have to be numbers; or that it is unsolvable.

    Raises:
        Trouble: there is no answer.
        Cancelled: it is not wanted any more.
    """
    command = [str(program()), "--search", strategy, "--internal-plan-file", "/dev/null"]
    ended = _run(process, command, given=text.encode(), limit_s=limit_s)
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


def _run(process: ProcessHandle, command: Sequence[str], *, limit_s: float, **settings: object) -> Ended:
    try:
        ended = process.run(command, limit_s=limit_s, **settings)  # type: ignore[arg-type]  # handed through as given
    except OSError as error:
        raise Trouble(Outcome.ENGINE_MISSING, f"it cannot be started ({error}); {INSTALL_ADVICE}") from error
    if ended.is_late:
        raise Trouble(Outcome.OUT_OF_TIME, f"no answer after {limit_s:.3g} s; allow more time or ask less")
    return ended


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


def written_domain(domain: Domain, up_problem: UpThing, alive: Collection[str] | None) -> str:
    """Write the domain file.

    Args:
        domain: what `load_domain` returned.
        up_problem: its instantaneous actions.
        alive: predicates (of `up_problem`) some of whose atoms are kept alive; None to write what is planned once only.

    Raises:
        UnsupportedPddlError: a formula that the translator does not read.
    """
    parts = [f"(define (domain d) (:types {_types(up_problem)})"]
    parts.append(f"(:constants {' '.join(f'{thing.name} - {thing.type.name}' for thing in up_problem.all_objects)})")
    predicates = [fluent for fluent in up_problem.fluents if fluent.type.is_bool_type()]
    signatures = [f"({fluent.name} {_typed(fluent.signature)})" for fluent in predicates]
    kept = [fluent for fluent in predicates if fluent.name in (alive or ())]
    signatures += [f"({_MAY}{fluent.name} {_typed(fluent.signature)})" for fluent in kept]
    parts.append(f"(:predicates ({_DONE}) {' '.join(signatures)})")
    parts += [_action(domain, action) for action in up_problem.actions]
    if alive is not None:
        parts += [_keeper(fluent) for fluent in kept]
        parts.append(f"(:action {_FINISH} :parameters () :precondition (and) :effect ({_DONE}))")
    return "\n".join([*parts, ")"])


def written_problem(problem: Problem, goals: Iterable[UpThing] | None, alive: Iterable[str] = ()) -> str:
    """Write the problem file.

    Args:
        problem: its state.
        goals: what shall hold; None for the stand-in.
        alive: atoms that may hold.
    """
    domain = problem.domain
    facts = [_inside_atom(domain, atom) for atom in sorted(problem.state)]
    facts += [f"({_MAY}{_inside_atom(domain, atom)[1:]}" for atom in alive]
    goal = f"({_DONE})" if goals is None else f"(and {' '.join(_formula(domain, goal) for goal in goals)})"
    return "\n".join(["(define (problem p) (:domain d) (:init", *facts, f") (:goal {goal}))"])


def _inside_atom(domain: Domain, atom: str) -> str:
    """Return an atom in the names of unified-planning's problem."""
    head, *words = atom[1:-1].split()
    inside = domain.inside
    names = [inside["predicate", head.lower()], *(inside["object", word.lower()] for word in words)]
    return f"({' '.join(names)})"


def _types(up_problem: UpThing) -> str:
    return " ".join(f"{kind.name} - {kind.father.name if kind.father else 'object'}" for kind in up_problem.user_types)


def _typed(parameters: Iterable[UpThing]) -> str:
    return " ".join(f"?{parameter.name} - {parameter.type.name}" for parameter in parameters)


def _keeper(fluent: UpThing) -> str:
    arguments = "".join(f" ?{parameter.name}" for parameter in fluent.signature)
    return (
        f"(:action {_KEEP}{fluent.name} :parameters ({_typed(fluent.signature)}) "
        f":precondition ({_MAY}{fluent.name}{arguments}) :effect ({fluent.name}{arguments}))"
    )


def _action(domain: Domain, action: UpThing) -> str:
    conditions = " ".join(_formula(domain, condition) for condition in action.preconditions)
    effects = " ".join(text for effect in action.effects for text in _effect(domain, effect))
    return (
        f"(:action {action.name} :parameters ({_typed(action.parameters)}) "
        f":precondition (and {conditions}) :effect (and {effects}))"
    )


def _effect(domain: Domain, effect: UpThing) -> Iterator[str]:
    if not effect.fluent.type.is_bool_type():
        return
    atom, value = _formula(domain, effect.fluent), effect.value
    for truth, literal in ((True, atom), (False, f"(not {atom})")):
        needed = [] if effect.condition.is_true() else [_formula(domain, effect.condition)]
        if value.is_bool_constant():
            if bool(value.constant_value()) is not truth:
                continue
        else:
            needed.append(_formula(domain, value) if truth else f"(not {_formula(domain, value)})")
        text = f"(when (and {' '.join(needed)}) {literal})" if needed else literal
        yield f"(forall ({_typed(effect.forall)}) {text})" if effect.forall else text


def _formula(domain: Domain, formula: UpThing) -> str:
    if formula.is_fluent_exp():
        return _list(formula.fluent().name, (_formula(domain, part) for part in formula.args))
    if formula.is_parameter_exp():
        return f"?{formula.parameter().name}"
    if formula.is_variable_exp():
        return f"?{formula.variable().name}"
    if formula.is_object_exp():
        return str(formula.object().name)
    if formula.is_bool_constant():
        return "(and)" if formula.constant_value() else "(or)"
    if formula.is_exists() or formula.is_forall():
        head = "exists" if formula.is_exists() else "forall"
        return f"({head} ({_typed(formula.variables())}) {_formula(domain, formula.arg(0))})"
    parts = [_formula(domain, part) for part in formula.args]
    if formula.is_iff():
        return f"(and (imply {parts[0]} {parts[1]}) (imply {parts[1]} {parts[0]}))"
    if formula.node_type.name not in _HEADS:
        raise UnsupportedPddlError(f"Fast Downward does not read {formula}", domain.file)
    return _list(_HEADS[formula.node_type.name], parts)


def _list(head: str, parts: Iterable[str]) -> str:
    return "(" + " ".join([head, *parts]) + ")"


# ---------------------------------------------------------------- what the translator writes


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
    variable = Variable(int(next(lines)), tuple([next(lines) for _ in range(int(next(lines)))]))
    _expect(lines, "end_variable")
    return variable


def _mutex(lines: Iterator[str]) -> tuple[Fact, ...]:
    _expect(lines, "begin_mutex_group")
    facts = _facts(lines)
    _expect(lines, "end_mutex_group")
    return facts


def _facts(lines: Iterator[str]) -> tuple[Fact, ...]:
    pairs = [next(lines).split() for _ in range(int(next(lines)))]
    return tuple([(int(variable), int(value)) for variable, value in pairs])


def _operator(lines: Iterator[str]) -> Operator:
    _expect(lines, "begin_operator")
    name = next(lines).strip()
    prevail = _facts(lines)
    effects = tuple([_sas_effect(next(lines)) for _ in range(int(next(lines)))])
    next(lines)
    _expect(lines, "end_operator")
    return Operator(name, prevail, effects)


def _rule(lines: Iterator[str], variables: Sequence[Variable]) -> Rule:
    _expect(lines, "begin_rule")
    needs = _facts(lines)
    variable, _, value = map(int, next(lines).split())
    _expect(lines, "end_rule")
    return Rule(variables[variable].layer, needs, variable, value)


def _sas_effect(line: str) -> Effect:
    count, *numbers = map(int, line.split())
    conditions = tuple(zip(numbers[: 2 * count : 2], numbers[1 : 2 * count : 2], strict=True))
    variable, before, after = numbers[2 * count :]
    return conditions, variable, before, after
