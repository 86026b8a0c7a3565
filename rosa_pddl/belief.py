"""What is taken to be true while a plan is executed: what is sensed, what is feasible, effects of its own steps."""

from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

from rosa_pddl.domain import Domain, Feasibility, State, Step
from rosa_pddl.problem import feasible_atoms, initial_state, sensed_into, without_feasibility
from rosa_pddl.validate import ended, started

__all__ = ["Belief", "Undo"]


@dataclass(frozen=True)
class Undo:
    """What the start of a step changed.

    Args:
        taken: atoms that it made false.
        given: atoms that it made true.
    """

    taken: State = frozenset()
    given: State = frozenset()


class Belief:
    """The state as it is believed, kept from one planning to the next.

    What is sensed stands. Effects of steps are assumed until something else is sensed; those on feasibility never: what
    is feasible is for the knowledge base to say.

    Args:
        domain: what `load_domain` returned; the facts of its problem file are believed at first.
        kb: says which ROSA actions are feasible.
        sense: returns the facts that are sensed now, by text.
    """

    def __init__(self, domain: Domain, kb: Feasibility, sense: Callable[[], Mapping[str, bool]]) -> None:
        self._domain, self._kb, self._sense = domain, kb, sense
        self._facts = without_feasibility(domain, initial_state(domain))

    @property
    def domain(self) -> Domain:
        """What the facts are about."""
        return self._domain

    def observe(self) -> State:
        """Take in what is sensed; return what is true then, with what is feasible.

        Raises:
            UnknownNameError: a sensed atom is not one of the domain.
        """
        self._facts = without_feasibility(self._domain, sensed_into(self._domain, self._facts, self._sense()))
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

    def take_back(self, undo: Undo) -> None:
        """Believe what would be so had a step not started."""
        self._facts = without([undo], self._facts)


def without(undos: Iterable[Undo], state: State) -> State:
    """Return what a state would be had steps not started."""
    for undo in undos:
        state = (state | undo.taken) - undo.given
    return state
