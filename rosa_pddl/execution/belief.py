"""What is taken to be true while a plan is executed: what is sensed, what is feasible, effects of its own steps."""

from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from math import isfinite

from rosa_pddl.domain import Domain, Feasibility, State, Step, head_of
from rosa_pddl.exceptions import SensingError, UnsupportedPddlError
from rosa_pddl.planning.uses import Uses
from rosa_pddl.problem import Problem, feasible_atoms, initial_state, without_feasibility
from rosa_pddl.validate import ended, started

__all__ = ["Belief", "Sense", "Undo", "without"]

Sense = Callable[[], Mapping[str, bool | float]]
"""Returns what is sensed now: by text, whether a fact such as `(lit room)` holds, and the value of a number such as
`(length a b)`."""


@dataclass(frozen=True)
class Undo:
    """What the start of a step changed.

    Args:
        taken: atoms that it made false.
        given: atoms that it made true.
    """

    taken: State = frozenset()
    given: State = frozenset()


@dataclass(frozen=True)
class _Sensed:
    """What was sensed: atoms, feasibility left out, with whether they hold, those that do, and numbers."""

    facts: Mapping[str, bool] = field(default_factory=dict)
    true: State = frozenset()
    numbers: Mapping[str, float] = field(default_factory=dict)

    def updated(self, facts: Mapping[str, bool], numbers: Mapping[str, float]) -> "_Sensed":
        """Return the same after more was sensed; where no fact changed, the facts are the same object."""
        if not facts:
            return replace(self, numbers={**self.numbers, **numbers})
        true = self.true.difference(facts) | {atom for atom, holds in facts.items() if holds}
        return _Sensed({**self.facts, **facts}, true, {**self.numbers, **numbers})


class Belief:
    """The state as it is believed, kept from one planning to the next.

    What is sensed stands. Effects of steps are assumed until something else is sensed; those on feasibility never: what
    is feasible is for the knowledge base to say. Numbers stay what they were sensed to be last; what of a resource is
    used up grows by what steps use, if it is not sensed.

    Args:
        domain: what `load_domain` returned; the facts of its problem file are believed at first.
        kb: says which ROSA actions are feasible.
        sense: returns what is sensed now.
    """

    def __init__(self, domain: Domain, kb: Feasibility, sense: Sense) -> None:
        self._domain, self._kb, self._sense = domain, kb, sense
        self._facts = without_feasibility(domain, initial_state(domain))
        self._numeric = domain.numeric
        self._answer: Mapping[str, bool | float] = {}
        self._sensed = _Sensed()
        self._taken_in: tuple[State, Mapping[str, bool]] | None = None
        self._numbers: Mapping[str, float] = {}
        self._uses = Uses(domain)

    @property
    def domain(self) -> Domain:
        """What the facts are about."""
        return self._domain

    @property
    def numbers(self) -> Mapping[str, float]:
        """The numbers that are no more what the problem file says, by their text."""
        return self._numbers

    @property
    def sensed_atoms(self) -> AbstractSet[str]:
        """The atoms that were spoken of when it was last sensed."""
        return self._sensed.facts.keys()

    def observe(self) -> State:
        """Take in what is sensed; return what is true then, with what is feasible.

        Raises:
            SensingError: what is sensed is no mapping from texts to what holds and to numbers.
            UnknownNameError: what is sensed is not of the domain.
        """
        sensed = self._read()
        # large worlds are looked at several times a tick, and mostly nothing has changed
        if self._taken_in is None or self._taken_in[0] is not self._facts or self._taken_in[1] is not sensed.facts:
            self._facts = self._facts.difference(sensed.facts) | sensed.true
            self._taken_in = (self._facts, sensed.facts)
        return self._facts | feasible_atoms(self._domain, self._kb)

    def start(self, step: Step, state: State) -> Undo:
        """Assume the effects of a step's start; return what takes them back."""
        before = self._facts
        self._facts = without_feasibility(self._domain, started(self._domain, step, state))
        return Undo(before - self._facts, self._facts - before)

    def end(self, step: Step, state: State) -> None:
        """Assume the effects of a step's end."""
        self._facts = without_feasibility(self._domain, ended(self._domain, step, state))

    def assume(self, gone: AbstractSet[str], come: AbstractSet[str]) -> None:
        """Assume that atoms became false, and others true; what becomes true wins, as PDDL says."""
        self._facts = without_feasibility(self._domain, (self._facts - gone) | come)

    def use_up(self, step: Step) -> None:
        """Assume that a step, however it ended, used up what it may."""
        known = Problem(self._domain, frozenset(), costs=self._numbers)
        try:
            numbers = self._uses.numbers(known)
            used = [self._uses.value(amount, numbers) for amount in self._uses.of(step)]
        except UnsupportedPddlError:
            return  # nothing can be planned within limits of which nothing is known
        for resource, amount in zip(self._domain.limited, used, strict=True):
            key = f"({resource.name})"
            if amount and key not in self._sensed.numbers:
                self._numbers = {**self._numbers, key: float(numbers.get(key, 0) + amount)}

    def take_back(self, undo: Undo) -> None:
        """Believe what would be so had a step not started."""
        self._facts = without([undo], self._facts)

    def _read(self) -> _Sensed:
        try:
            answer = self._sense()
            if not isinstance(answer, Mapping):
                raise SensingError(f"sense returned {answer!r}, expected a mapping such as {{'(lit room)': True}}")
            if answer != self._answer:
                self._sensed = self._told(answer)
                self._answer, self._numbers = dict(answer), {**self._numbers, **self._sensed.numbers}
        except Exception as error:
            error.add_note("this came of what `sense` returned or raised")
            raise
        return self._sensed

    def _told(self, answer: Mapping[str, bool | float]) -> _Sensed:
        """Return what an answer tells; only what differs from the last one is read."""
        old, before = self._answer, self._sensed
        if not old.keys() <= answer.keys():
            old, before = {}, _Sensed()
        new = {text: value for text, value in answer.items() if text not in old or old[text] != value}
        return before.updated(*self._sorted(new))

    def _sorted(self, answer: Mapping[str, bool | float]) -> tuple[Mapping[str, bool], Mapping[str, float]]:
        """Return facts and numbers."""
        facts: dict[str, bool] = {}
        numbers: dict[str, float] = {}
        for text, value in answer.items():
            if not isinstance(text, str):
                raise SensingError(f"sense returned {text!r}: {value!r}, expected a text such as '(lit room)' first")
            atom = self._domain.atom(text)
            is_number = head_of(atom) in self._numeric
            known = value.item() if hasattr(value, "item") else value  # what numpy makes is as good
            if isinstance(known, bool) is is_number or not isinstance(known, bool | int | float):
                expected = "a number" if is_number else "True or False"
                raise SensingError(f"sense returned {value!r} for {atom}, expected {expected}")
            if not isfinite(known):
                raise SensingError(f"sense returned {value!r} for {atom}, expected a finite number")
            if is_number:
                numbers[atom] = float(known)
            elif not self._domain.is_feasibility(atom):
                facts[atom] = bool(known)
        return facts, numbers


def without(undos: Iterable[Undo], state: State) -> State:
    """Return what a state would be had steps not started."""
    for undo in undos:
        state = (state | undo.taken) - undo.given
    return state
