"""The state that is believed while a plan is executed: percepts, feasibility, and the effects of its own steps.

Planning expects that a step makes an action feasible, but this effect is never believed. If a step succeeds and the
action is still unfeasible, the effect is unmet: plans do not rely on this step for it again as long as one of the
causes that kept the action unfeasible then has lasted without a break.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from math import isfinite
from typing import Any, Protocol, runtime_checkable

from kb import KnowledgeBase
from kb.events import Log
from kb.explanation import Explanation
from kb.forecast import FeasibleUntil
from rosa_pddl.domain import (
    Domain,
    Feasibility,
    State,
    Step,
    UpThing,
    arguments_of,
    exact,
    head_of,
    number_fact,
    numbers_in,
)
from rosa_pddl.exceptions import SensingError, UnknownObjectError, UnsupportedPddlError
from rosa_pddl.problem import (
    feasible_atoms,
    initial_state,
    lock_of,
    parameters_of,
    without_feasibility,
)
from rosa_pddl.resource_usage import usage_of
from rosa_pddl.validate import affected_atoms, binding_of, changes, ended, started

_MOST_DOMAINS = 8
# At most this many sensed things with unknown names are reported.
_MOST_PASSED_OVER = 100
# How far ahead forecasts look [s].
_AHEAD_S = 300.0

Sense = Callable[[], Mapping[str, bool | float]]
"""Returns the percepts by their text: whether a fact such as `(lit room)` holds, the value of a number such as
`(length a b)`, and whether an object such as `sample_9 - sample` exists."""


@dataclass(frozen=True)
class _Believed:
    """The facts, the numbers that differ from the file, and what the starts of running steps made false and true.

    All of it is one value, so that an interrupt leaves a change either complete or undone.
    """

    facts: State
    numbers: Mapping[str, float] = field(default_factory=dict)
    undos: Mapping[object, tuple[State, State]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Sensed:
    """The last percepts: whether atoms hold, without feasibility, and the values of numbers."""

    facts: Mapping[str, bool] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)


class Belief:
    """The believed state, which is kept from one planning to the next.

    Percepts about objects that the files do not have are ignored; `passed_over` reports them in sentences.

    Args:
        domain: what `load_domain` returned; the belief begins with the facts of its problem file.
        kb: says which ROSA actions are feasible.
        sense: returns what is sensed now.
    """

    BOOKKEEPING = "_taken_in passed_over"

    def __init__(self, domain: Domain, kb: Feasibility, sense: Sense) -> None:
        self.domain, self._kb, self._sense = domain, kb, sense
        self._now = _Believed(without_feasibility(domain, initial_state(domain)))
        self._numeric = domain.numeric
        self._answer: Mapping[str, bool | float] = {}
        self.sensed = _Sensed()
        self._taken_in: tuple[State, _Sensed] | None = None
        self.passed_over: dict[str, None] = {}

    @property
    def numbers(self) -> Mapping[str, float]:
        """The numbers whose values no longer come from the problem file, by their text."""
        return self._now.numbers

    def use(self, domain: Domain) -> None:
        """Switch to a domain with other objects, and forget what was known about objects that it does not have."""
        gone = {*self.domain.types} - {*domain.types}
        self.domain = domain

        def stays(fact: str) -> bool:
            return gone.isdisjoint(arguments_of(fact))

        now = self._now
        self._now = _Believed(
            frozenset(filter(stays, now.facts)),
            {text: value for text, value in now.numbers.items() if stays(text)},
            {
                key: (frozenset(filter(stays, one)), frozenset(filter(stays, two)))
                for key, (one, two) in now.undos.items()
            },
        )
        self._answer, self.sensed, self._taken_in = {}, _Sensed(), None
        self.passed_over.clear()

    def appeared(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the objects that are sensed to have appeared or gone: name, type, and whether the object is there."""
        self._read()
        for text, is_there in self._answer.items():
            name, mark, kind = str(text).partition(" - ")
            if mark and is_there is not (("object", name.lower()) in self.domain.inside):
                if not isinstance(is_there, bool):
                    raise SensingError(
                        f"sense returned {is_there!r} for {text!r}, expected True or False"
                    )
                yield name, kind, is_there

    def observe(self) -> State:
        """Update the belief with the percepts; return the believed state, with the facts about feasibility."""
        sensed, facts = self._read(), self._now.facts
        # called several times a tick, mostly with nothing changed, which must be quick in large worlds
        if (
            self._taken_in is None
            or self._taken_in[0] is not facts
            or self._taken_in[1] is not sensed
        ):
            computed = {
                text: one
                for text, one in sensed.numbers.items()
                if head_of(text) in self.domain.computed
            }
            known = numbers_in(facts if computed else ()).items()
            old = [number_fact(text, value) for text, value in known if text in computed]
            true = {atom for atom, holds in sensed.facts.items() if holds}
            true.update(number_fact(text, exact(value)) for text, value in computed.items())
            facts = facts.difference(sensed.facts, old) | true
            self._now = replace(self._now, facts=facts)
            self._taken_in = facts, sensed
        return facts | feasible_atoms(self.domain, self._kb)

    def start(self, key: object, step: Step, state: State) -> None:
        """Believe the start effects of a step; `end` or `give_up` with the same key finishes it."""
        before, facts = (
            self._now.facts,
            without_feasibility(self.domain, started(self.domain, step, state)),
        )
        undos = {**self._now.undos, key: (before - facts, facts - before)}
        self._now = replace(self._now, facts=facts, undos=undos)

    def end(self, key: object, step: Step, state: State) -> None:
        """Believe the end effects of a step that succeeded, and that it used up its resources."""
        facts = without_feasibility(self.domain, ended(self.domain, step, state))
        self._now = _Believed(facts, self._used_up(step), self._undos_but(key))

    def give_up(self, key: object, step: Step) -> None:
        """Take back the start effects of a step, but count its resources as used up; a second call does nothing."""
        if key in self._now.undos:
            facts = self.unstarted([key], self._now.facts)
            self._now = _Believed(facts, self._used_up(step), self._undos_but(key))

    def unstarted(self, keys: Iterable[object], state: State) -> State:
        """Return a state without the start effects of the steps with these keys."""
        for taken, given in [self._now.undos[key] for key in keys if key in self._now.undos]:
            state = (state | taken) - given
        return state

    def _undos_but(self, key: object) -> Mapping[object, tuple[State, State]]:
        return {other: undo for other, undo in self._now.undos.items() if other is not key}

    def _used_up(self, step: Step) -> Mapping[str, float]:
        """Return the numbers after a step, successful or not, has used up its limited resources."""
        known = self._now.numbers
        try:
            usage, numbers = usage_of(self.domain), usage_of(self.domain).numbers(known)
            for name, amount in zip(self.domain.limited, usage.uses_of(step), strict=True):
                used = usage.value(amount, numbers)
                if used and f"({name})" not in self.sensed.numbers:
                    known = {
                        **known,
                        f"({name})": float(usage.value(("n", f"({name})"), numbers) + used),
                    }
        except UnsupportedPddlError:
            return (
                self._now.numbers
            )  # with an unknown limit or amount nothing can be planned anyway
        return known

    def _read(self) -> _Sensed:
        try:
            answer = self._sense()
            if not isinstance(answer, Mapping):
                raise SensingError(
                    f"sense returned {answer!r}, expected a mapping such as {{'(lit room)': True}}"
                )
            if answer != self._answer:
                self.sensed = self._sorted(answer)
                self._now = replace(self._now, numbers={**self._now.numbers, **self.sensed.numbers})
                self._answer = dict(answer)
        except Exception as error:
            error.add_note("this came of what `sense` returned or raised")
            raise
        return self.sensed

    def _sorted(self, answer: Mapping[str, bool | float]) -> _Sensed:
        facts: dict[str, bool] = {}
        numbers: dict[str, float] = {}
        for text, value in answer.items():
            if not isinstance(text, str):
                raise SensingError(
                    f"sense returned {text!r}: {value!r}, expected a text such as '(lit room)' first"
                )
            if " - " in text:
                continue  # an object, which the executor has added already
            try:
                atom = self.domain.atom(text)
            except (
                UnknownObjectError
            ) as error:  # the world may have more objects; other errors are raised
                if len(self.passed_over) < _MOST_PASSED_OVER:
                    self.passed_over[f"what is sensed is passed over: {error}"] = None
                continue
            is_number = head_of(atom) in self._numeric
            known = (
                value.item() if hasattr(value, "item") else value
            )  # numpy's values are accepted, too
            if isinstance(known, bool) is is_number or not isinstance(known, bool | int | float):
                expected = "a number" if is_number else "True or False"
                raise SensingError(f"sense returned {value!r} for {atom}, expected {expected}")
            if not isfinite(known):
                raise SensingError(f"sense returned {value!r} for {atom}, expected a finite number")
            if is_number:
                numbers[atom] = float(known)
            elif not self.domain.is_feasibility(atom):
                facts[atom] = bool(known)
        return _Sensed(facts, numbers)


class LastingFeasibility:
    """A knowledge base whose forecasts count in planning: a step must end while its action is still feasible.

    Forecasts come from `KnowledgeBase.feasible_until`. A new plan must keep to the earliest forecast times, with a
    tenth of its time to spare; a plan under way is kept as long as the expected times allow it. So a forecast that
    varies a little changes no plan. All other attributes are those of the knowledge base.

    Args:
        kb: the knowledge base.
        domain: what `load_domain` returned.
    """

    def __init__(self, kb: KnowledgeBase, domain: Domain) -> None:
        self._kb, self._actions = kb, domain.feasibility
        self._known: tuple[object, dict[str, FeasibleUntil]] = (None, {})

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever a knowledge base offers
        return getattr(self._kb, name)

    def forecasts(self) -> Mapping[str, FeasibleUntil]:
        """Return the forecast for each action that is feasible now, by its fact `(action_feasible ...)`."""
        now = self._kb.now, self._kb.log.last
        if self._known[0] != now:
            feasible = [
                (atom, one) for atom, one in self._actions.items() if self._kb.is_feasible(one)
            ]
            self._known = (
                now,
                {atom: self._kb.feasible_until(one, _AHEAD_S) for atom, one in feasible},
            )
        return self._known[1]


class FeasibilityEvents:
    """Finds the event of the knowledge base that changed feasibility, if the knowledge base keeps a log."""

    def __init__(self, domain: Domain, kb: Feasibility) -> None:
        self._actions = frozenset(domain.rosa_actions)
        log = getattr(kb, "log", None)
        self._log = log if isinstance(log, Log) else None
        self._seen = 0 if self._log is None else self._log.last

    def latest(self) -> int | None:
        """Return the number of the latest event since the previous call that changed an action's status, or None."""
        found = None
        if self._log is not None and self._log.last != self._seen:
            for event in self._log.since(self._seen):
                if any(
                    change.kind == "action" and change.name in self._actions
                    for change in event.changes
                ):
                    found = event.number
            self._seen = self._log.last
        return found


@runtime_checkable
class _Explaining(Protocol):
    """The explanations that a knowledge base may offer; `kb.KnowledgeBase` does."""

    def explain(self, element: str) -> Explanation: ...

    def why(self, element: str) -> str: ...


@dataclass(frozen=True)
class UnmetEffect:
    """A step that succeeded without making an action feasible as expected."""

    step: Step
    action: str
    causes: frozenset[str]
    why: str

    def __str__(self) -> str:
        return f"{self.step} did not make {self.action} feasible: {self.why}"


class ExpectedEffects:
    """Provides a domain for planning, without the effects on feasibility that were unmet."""

    def __init__(self, domain: Domain, kb: Feasibility) -> None:
        self._domain, self._kb = domain, kb
        self._unmet: dict[tuple[Step, str], UnmetEffect] = {}
        self._without = lru_cache(_MOST_DOMAINS)(self._made)

    def use(self, domain: Domain) -> None:
        self._domain = domain
        self._without.cache_clear()

    @property
    def unmet(self) -> tuple[UnmetEffect, ...]:
        return tuple(self._unmet.values())

    @property
    def domain(self) -> Domain:
        return self._without(frozenset(self._unmet)) if self._unmet else self._domain

    def ended(self, step: Step, state: State) -> tuple[UnmetEffect, ...]:
        """Note that a step succeeded; return its unmet effects."""
        why = self._kb.why if isinstance(self._kb, _Explaining) else "{} is unfeasible".format
        found = tuple(
            UnmetEffect(step, action, _causes(self._kb, action), why(action))
            for action in self._expected(step, state)
            if not self._kb.is_feasible(action)
        )
        self._unmet |= {(one.step, one.action): one for one in found}
        return found

    def update(self) -> bool:
        """Forget unmet effects whose causes have gone; return whether there were any."""
        before = len(self._unmet)
        for key, unmet in tuple(self._unmet.items()):
            feasible = self._kb.is_feasible(unmet.action)
            left = frozenset() if feasible else unmet.causes & _causes(self._kb, unmet.action)
            if left:
                self._unmet[key] = replace(unmet, causes=left)
            else:
                del self._unmet[key]
        return len(self._unmet) < before

    def _expected(self, step: Step, state: State) -> Iterator[str]:
        schema = self._domain.schema_of[step.schema]
        effects = schema.start_effects + schema.end_effects
        _, made = changes(self._domain, effects, binding_of(self._domain, step), state)
        known = self._domain.feasibility
        yield from (known[atom] for atom in sorted(made & known.keys()))

    def _made(self, unmet: frozenset[tuple[Step, str]]) -> Domain:
        with lock_of(self._domain):
            return _without_effects(self._domain, sorted(unmet, key=str))


def _causes(kb: Feasibility, action: str) -> frozenset[str]:
    """Return the root causes why an action is unfeasible, as kind and name; the action if the kb cannot explain."""
    if not isinstance(kb, _Explaining):
        return frozenset({action})
    found, left, seen = set[str](), [kb.explain(action)], set[str]()
    while left:
        reason = left.pop()
        key, causes = f"{reason.kind} {reason.name}", tuple(reason.causes)
        if key not in seen:
            seen.add(key)
            left += causes
            found |= set() if causes else {key}
    return frozenset(found)


def _without_effects(domain: Domain, unmet: Iterable[tuple[Step, str]]) -> Domain:
    """Return a domain in which the given steps no longer make the given actions feasible."""
    schemas = dict(domain.schema_of)
    for step, action in unmet:
        schema, limited = schemas[step.schema], partial(_limited, domain, step, action)
        schemas[step.schema] = replace(
            schema,
            start_effects=tuple(map(limited, schema.start_effects)),
            end_effects=tuple(map(limited, schema.end_effects)),
        )
    return replace(domain, schema_of=schemas)


def _limited(domain: Domain, step: Step, action: str, effect: UpThing) -> UpThing:
    """Return an effect that no longer makes a ROSA action feasible when the objects are those of the step."""
    affected = affected_atoms(domain, [effect], binding_of(domain, step))
    if not domain.makes_feasible(effect) or domain.feasible_atom(action) not in affected:
        return effect
    problem, manager = domain.up_problem, domain.up_problem.environment.expression_manager
    things = [
        problem.object(domain.inside["object", name.lower()]) for name in (*step.arguments, action)
    ]
    places = [*parameters_of(domain, domain.schema_of[step.schema]), effect.fluent.arg(0)]
    same = [
        manager.Equals(place, manager.ObjectExp(thing))
        for place, thing in zip(places, things, strict=True)
    ]
    made = effect.clone()
    made.set_condition(manager.And(effect.condition, manager.Not(manager.And(same))))
    return made
