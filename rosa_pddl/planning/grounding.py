"""Translates the task of a domain once, beside everything else, such that it fits whatever may come."""

import threading
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import product
from math import prod
from typing import NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

from rosa_pddl.domain import FEASIBLE, Domain, UpThing, head_of
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.costs import Costs
from rosa_pddl.planning.downward import Trouble, translate
from rosa_pddl.planning.grounded import Grounded
from rosa_pddl.planning.outcomes import Outcome
from rosa_pddl.planning.processes import Cut, Leash
from rosa_pddl.planning.uses import Uses
from rosa_pddl.planning.writing import written_domain, written_problem
from rosa_pddl.problem import Problem

__all__ = ["Grounding", "Groundings", "Instantaneous", "instantaneous", "lock_of", "translated"]

Grounding: TypeAlias = Future[Grounded | Trouble]
"""The translated task, or why there is none: a value, as an exception that many raise would keep their frames."""

# Beyond this many, only the atoms of a predicate that held or were told of are kept alive.
_MOST_ATOMS = 5000
_MOST_DOMAINS = 8
_LOCKS: "WeakKeyDictionary[UpThing, threading.Lock]" = WeakKeyDictionary()
_INSTANTANEOUS: "WeakKeyDictionary[Domain, Instantaneous]" = WeakKeyDictionary()


def lock_of(domain: Domain) -> threading.Lock:
    """Return the lock of a domain's environment: unified-planning's are not made for several threads at once."""
    return _LOCKS.setdefault(domain.up_problem.environment, threading.Lock())


class Instantaneous(NamedTuple):
    """A domain whose steps follow one another.

    Attributes:
        up_problem: as unified-planning's problem with instantaneous actions and no facts.
        costs: what steps cost.
        uses: what they use up.
    """

    up_problem: UpThing
    costs: Costs
    uses: Uses


def instantaneous(domain: Domain) -> Instantaneous:
    """Return a domain with instantaneous actions.

    Raises:
        UnsupportedPddlError: Fast Downward cannot be told of this.
    """
    with lock_of(domain):
        if domain not in _INSTANTANEOUS:
            up_problem = Problem(domain, frozenset()).build()
            _INSTANTANEOUS[domain] = Instantaneous(up_problem, Costs(domain, up_problem), Uses(domain))
        return _INSTANTANEOUS[domain]


def translated(
    problem: Problem,
    alive: Mapping[str, tuple[str, ...]] | None,
    leash: Leash,
    limit_s: float,
    memory_bytes: int | None,
) -> Grounded:
    """Translate a problem.

    Args:
        problem: its state is where the translation starts from.
        alive: atoms that may change, by the predicate in the names of unified-planning; None to keep none alive, which
            is for this problem only.
        leash: runs the translator.
        limit_s: wall-clock time that it may take [s].
        memory_bytes: how much data it may hold [B].

    Raises:
        UnsupportedPddlError: Fast Downward cannot be told of this.
        Trouble: the translator gave no task.
        Cut: the leash was cut.
    """
    domain = problem.domain
    up_problem, costs, uses = instantaneous(domain)
    domain_text = written_domain(domain, up_problem, alive)
    kept = [atom for atoms in (alive or {}).values() for atom in atoms]
    problem_text = written_problem(problem, problem.wanted if alive is None else None, kept)
    task = translate(
        domain_text,
        problem_text,
        leash,
        limit_s=limit_s,
        memory_bytes=memory_bytes,
        for_any_state=alive is not None,
    )
    return Grounded(domain, task, costs, uses, problem.state, is_patchable=alive is not None)


@dataclass(frozen=True)
class _Ground:
    base: Problem
    changing: frozenset[str]
    future: Grounding = field(default_factory=Future)


class Groundings:
    """The translated task of each domain, made in a thread of its own when first asked for.

    Which atoms are kept alive depends on what was asked for and told so far, never on how long anything takes. What
    the translator finds reachable from the first state is alive anyway. Atoms of predicates that the actions only make
    true, only make false, or that say what is feasible are kept alive by themselves; atoms of predicates that no action
    changes are so once they were told of, or were found to have changed.

    Args:
        limit_s: wall-clock time that a translation may take [s].
        memory_bytes: how much data the translator may hold [B].
    """

    def __init__(self, limit_s: float, memory_bytes: int | None) -> None:
        self._limit_s = limit_s
        self._memory_bytes = memory_bytes
        self._grounds: dict[Domain, _Ground] = {}
        self._leashes: set[Leash] = set()
        self._lock = threading.Lock()

    def ask(self, problem: Problem, changing: Iterable[str] = ()) -> Grounding:
        """Begin to translate if that is needed, without waiting.

        Args:
            problem: what is to be planned.
            changing: atoms that may change, such as those that are sensed.
        """
        with self._lock:
            ground = self._grounds.get(problem.domain)
            told = frozenset(changing)
            if ground is not None:
                told |= _untouched(problem.domain, (problem.state ^ ground.base.state) - ground.changing)
                if told <= ground.changing:
                    return ground.future
                told |= ground.changing
                problem = ground.base
            ground = _Ground(problem, told)
            self._grounds.pop(problem.domain, None)
            self._grounds[problem.domain] = ground
            if len(self._grounds) > _MOST_DOMAINS:
                del self._grounds[next(iter(self._grounds))]
            name = f"translator of {problem.domain.name}"
            threading.Thread(target=self._work, args=(ground,), name=name, daemon=True).start()
            return ground.future

    def close(self) -> None:
        """Stop what is being translated, and forget the rest."""
        with self._lock:
            self._grounds.clear()
            for leash in self._leashes:
                leash.cut()

    def _work(self, ground: _Ground) -> None:
        leash = Leash()
        self._leashes.add(leash)
        try:
            alive = _alive(ground.base, ground.changing)
            ground.future.set_result(translated(ground.base, alive, leash, self._limit_s, self._memory_bytes))
        except Trouble as trouble:
            ground.future.set_result(trouble)
        except UnsupportedPddlError as error:
            ground.future.set_result(Trouble(Outcome.UNSUPPORTED, str(error)))
        except Cut:
            ground.future.set_result(Trouble(Outcome.ENGINE_CRASHED, "the planner was closed"))
        except Exception as error:  # whatever it is, it belongs to those who wait for the task
            ground.future.set_result(Trouble(Outcome.ENGINE_CRASHED, f"{type(error).__name__}: {error}"))
        finally:
            self._leashes.discard(leash)


def _untouched(domain: Domain, atoms: Iterable[str]) -> frozenset[str]:
    """Return the atoms of predicates that no action changes."""
    added, deleted = _directions(domain)
    touched = {domain.outside[name] for name in added | deleted}
    return frozenset(atom for atom in atoms if head_of(atom) not in touched)


def _alive(problem: Problem, changing: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the atoms to keep alive, by predicate."""
    domain = problem.domain
    added, deleted = _directions(domain)
    alive: dict[str, set[str]] = {}
    for fluent in domain.up_problem.fluents:
        name = fluent.name
        moves = name in added and name in deleted
        one_way = name in added or name in deleted
        if fluent.type.is_bool_type() and (domain.outside[name].lower() == FEASIBLE or (one_way and not moves)):
            alive[name] = set(_instances(problem, fluent))
    for atom in changing:
        name = domain.inside["predicate", head_of(atom).lower()]
        if not (name in added and name in deleted):
            alive.setdefault(name, set()).add(atom)
    return {name: tuple(sorted(atoms)) for name, atoms in alive.items()}


def _directions(domain: Domain) -> tuple[set[str], set[str]]:
    """Return the predicates that actions make true, and those that they make false."""
    added: set[str] = set()
    deleted: set[str] = set()
    for schema in domain.schema_of.values():
        for effect in schema.start_effects + schema.end_effects:
            name = effect.fluent.fluent().name
            if not effect.value.is_false():
                added.add(name)
            if not effect.value.is_true():
                deleted.add(name)
    return added, deleted


def _instances(problem: Problem, fluent: UpThing) -> Iterator[str]:
    domain = problem.domain
    head = domain.outside[fluent.name]
    choices = [domain.objects_of(domain.outside[parameter.type.name]) for parameter in fluent.signature]
    if prod(map(len, choices)) > _MOST_ATOMS:
        yield from (atom for atom in problem.state if head_of(atom) == head)
        return
    yield from (f"({' '.join((head, *words))})" for words in product(*choices))
