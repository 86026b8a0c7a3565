"""The state that is believed while a plan is executed: percepts, feasibility, effects of steps.

Planning expects that a step makes an action feasible, but this effect is never believed. If a step
succeeds and the action is still unfeasible, the effect is unmet: plans do not rely on this step
for it again as long as one of the causes that kept the action unfeasible then has lasted.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isfinite
from typing import Any, TypeAlias

from rosa_pddl.domain import (
    FEASIBLE,
    Domain,
    Effect,
    Feasibility,
    Formula,
    SensingError,
    State,
    Step,
    arguments_of,
    exact,
    feasible_atoms,
    head_of,
    initial_state,
    nearest,
    number_fact,
    numbers_in,
    without_feasibility,
)
from rosa_pddl.grounding import binding_of
from rosa_pddl.reader import atom_of
from rosa_pddl.validate import changes, ended, started

_MOST_DOMAINS = 8
# At most this many sensed things with unknown names are reported.
_MOST_IGNORED = 100
# How far ahead forecasts look [s].
_AHEAD_S = 300.0

Sense = Callable[[], Mapping[str, bool | float]]
"""Returns the percepts by their text: whether a fact such as `(lit room)` holds, the value of a
number such as `(length a b)`, and whether an object such as `sample_9 - sample` exists."""


@dataclass(frozen=True)
class _Believed:
    """The facts, the numbers that differ from the file, and what starts of steps changed.

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

    Percepts about objects that the files do not have are ignored; `ignored_percepts` reports them.

    Args:
        domain: what `load_domain` returned; the belief begins with the facts of its problem file.
        kb: says which ROSA actions are feasible.
        sense: returns what is sensed now.
    """

    def __init__(self, domain: Domain, kb: Feasibility, sense: Sense) -> None:
        self.domain = domain
        self._kb = kb
        self._sense = sense
        self._now = _Believed(without_feasibility(domain, initial_state(domain)))
        self._answer: Mapping[str, bool | float] = {}
        self._objects: Mapping[str, bool | float] = {}
        self.sensed = _Sensed()
        self._taken_in: tuple[State, _Sensed] | None = None
        self.ignored_percepts: dict[str, None] = {}

    @property
    def numbers(self) -> Mapping[str, float]:
        """The numbers whose values no longer come from the problem file, by their text."""
        return self._now.numbers

    def use(self, domain: Domain) -> None:
        """Switch to a domain with other objects, and forget what was known about those gone."""
        gone = {*self.domain.types} - {*domain.types}
        self.domain = domain

        def stays(fact: str) -> bool:
            return gone.isdisjoint(arguments_of(fact))

        now = self._now
        numbers = {text: value for text, value in now.numbers.items() if stays(text)}
        undos = dict[object, tuple[State, State]]()
        for key, (taken, given) in now.undos.items():
            undos[key] = frozenset(filter(stays, taken)), frozenset(filter(stays, given))
        self._now = _Believed(frozenset(filter(stays, now.facts)), numbers, undos)
        self._answer = {}
        self.sensed = _Sensed()
        self._taken_in = None
        self.ignored_percepts.clear()

    def appeared(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the objects sensed to have appeared or gone: name, type, whether it is there."""
        self._read()
        names = {name.lower() for name in self.domain.types} if self._objects else set()
        for text, is_there in self._objects.items():
            name, _, kind = text.partition(" - ")
            if is_there is not (name.lower() in names):
                if not isinstance(is_there, bool):
                    message = f"sense returned {is_there!r} for {text!r}, expected True or False"
                    raise SensingError(message)
                yield name, kind, is_there

    def observe(self) -> State:
        """Update the belief with the percepts; return the state, with facts about feasibility."""
        sensed = self._read()
        facts = self._now.facts
        # called several times a tick, mostly with nothing changed: quick in large worlds
        taken_in = self._taken_in
        if taken_in is None or taken_in[0] is not facts or taken_in[1] is not sensed:
            facts = self._updated(facts, sensed)
            self._now = replace(self._now, facts=facts)
            self._taken_in = facts, sensed
        return facts | feasible_atoms(self.domain, self._kb)

    def _updated(self, facts: State, sensed: _Sensed) -> State:
        computed = dict[str, float]()
        for text, value in sensed.numbers.items():
            if head_of(text) in self.domain.computed:
                computed[text] = value
        values = numbers_in(facts) if computed else {}
        old = [number_fact(text, value) for text, value in values.items() if text in computed]
        true = {atom for atom, holds in sensed.facts.items() if holds}
        true.update(number_fact(text, exact(value)) for text, value in computed.items())
        return facts.difference(sensed.facts, old) | true

    def start(self, key: object, step: Step, state: State) -> None:
        """Believe the start effects of a step; `end` or `give_up` with the same key finishes it."""
        before = self._now.facts
        facts = without_feasibility(self.domain, started(self.domain, step, state))
        undos = {**self._now.undos, key: (before - facts, facts - before)}
        self._now = replace(self._now, facts=facts, undos=undos)

    def end(self, key: object, step: Step, state: State) -> None:
        """Believe the end effects of a step that succeeded."""
        facts = without_feasibility(self.domain, ended(self.domain, step, state))
        self._now = replace(self._now, facts=facts, undos=self._undos_but(key))

    def give_up(self, key: object) -> None:
        """Take back the start effects of a step; a second call does nothing."""
        if key in self._now.undos:
            facts = self.unstarted([key], self._now.facts)
            self._now = replace(self._now, facts=facts, undos=self._undos_but(key))

    def unstarted(self, keys: Iterable[object], state: State) -> State:
        """Return a state without the start effects of the steps with these keys."""
        for key in keys:
            taken, given = self._now.undos.get(key, (frozenset(), frozenset()))
            state = (state | taken) - given
        return state

    def _undos_but(self, key: object) -> Mapping[object, tuple[State, State]]:
        return {other: undo for other, undo in self._now.undos.items() if other is not key}

    def _read(self) -> _Sensed:
        try:
            answer = self._sense()
            if not isinstance(answer, Mapping):
                message = f"sense returned {answer!r}, expected a mapping"
                raise SensingError(f"{message} such as {{'(lit room)': True}}")
            if answer != self._answer:
                self.sensed = self._sorted(answer)
                texts = [text for text in answer if " - " in text]
                self._objects = {text: answer[text] for text in texts}
                numbers = {**self._now.numbers, **self.sensed.numbers}
                self._now = replace(self._now, numbers=numbers)
                self._answer = dict(answer)
        except Exception as error:
            error.add_note("this came of what `sense`, or `facts` of a mission, returned or raised")
            raise
        return self.sensed

    def _sorted(self, answer: Mapping[str, bool | float]) -> _Sensed:
        facts: dict[str, bool] = {}
        numbers: dict[str, float] = {}
        objects = {name.lower() for name in self.domain.types}
        for text, value in answer.items():
            if " - " in text:
                continue  # an object, which the executor has added already
            strange = {*text.lower().strip("() ").split()[1:]} - objects
            if strange:  # the world may have more objects
                if len(self.ignored_percepts) < _MOST_IGNORED:
                    hint = nearest(min(strange), objects)
                    ignored = (
                        f"{text} is sensed, but ignored: {min(strange)!r} is no object; {hint}"
                    )
                    self.ignored_percepts[ignored] = None
                continue
            atom = atom_of(self.domain, text)
            plain = value.item() if hasattr(value, "item") else value  # numpy's values, too
            is_number = head_of(atom) in self.domain.numeric
            if is_number and type(plain) in (int, float) and isfinite(plain):
                numbers[atom] = float(plain)
            elif not is_number and isinstance(plain, bool):
                if not self.domain.is_feasibility(atom):
                    facts[atom] = plain
            else:
                expected = "a finite number" if is_number else "True or False"
                raise SensingError(f"sense returned {value!r} for {atom}, expected {expected}")
        return _Sensed(facts, numbers)


class LastingFeasibility:
    """A knowledge base whose forecasts count: a step must end while its action is feasible.

    Forecasts come from `KnowledgeBase.feasible_until`. A new plan must keep to the earliest times
    forecast, with a tenth to spare; a plan under way is kept as long as the expected times allow
    it. So a forecast that varies a little changes no plan. All other attributes are those of the
    knowledge base.

    Args:
        kb: the knowledge base.
        domain: what `load_domain` returned.
    """

    def __init__(self, kb: Any, domain: Domain) -> None:  # noqa: ANN401  # all that a kb offers
        self._kb = kb
        self._actions = domain.feasibility
        self._cache: tuple[object, dict[str, Any]] = (None, {})

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever a knowledge base offers
        return getattr(self._kb, name)

    def forecasts(self) -> Mapping[str, Any]:
        """Return the forecast for each action that is feasible now, by its feasibility fact.

        Without an event there is nothing new but the time.
        """
        if self._cache[0] != self._kb.log.last:
            forecasts = dict[str, Any]()
            for atom, action in self._actions.items():
                if self._kb.is_feasible(action):
                    forecasts[atom] = self._kb.feasible_until(action, _AHEAD_S)
            self._cache = self._kb.log.last, forecasts
        now = self._kb.now
        return {atom: each._replace(now=now) for atom, each in self._cache[1].items()}


class FeasibilityEvents:
    """Finds the event of the knowledge base that changed feasibility, if it keeps a log."""

    def __init__(self, kb: Feasibility) -> None:
        self._log: Any = getattr(kb, "log", None)
        self._seen = 0 if self._log is None else self._log.last

    def latest(self, domain: Domain) -> int | None:
        """Return the number of the latest event since the last call that changed an action."""
        latest = None
        if self._log is not None and self._log.last != self._seen:
            for event in self._log.since(self._seen):
                for change in event.changes:
                    if change.kind == "action" and change.name in domain.rosa_actions:
                        latest = event.number
            self._seen = self._log.last
        return latest


@dataclass(frozen=True)
class UnmetEffect:
    """A step that succeeded without making an action feasible as expected."""

    step: Step
    action: str
    causes: frozenset[str]
    why: str

    def __str__(self) -> str:
        return f"{self.step} did not make {self.action} feasible: {self.why}"


Limit: TypeAlias = tuple[str, tuple[tuple[str, str], ...], str]
"""A PDDL action, objects for some of its variables, and the ROSA action that it does not cure."""


class ExpectedEffects:
    """Provides a domain for planning, without effects on feasibility that cannot be expected.

    These are the effects that were unmet, and those of actions that cannot change what makes the
    other action unfeasible.
    """

    def __init__(self, domain: Domain, kb: Feasibility) -> None:
        self._domain = domain
        self._kb = kb
        self._unmet: dict[Limit, UnmetEffect] = {}
        self._hopeless = hopeless_promises(domain, kb)
        self._limited = lru_cache(_MOST_DOMAINS)(_limited)

    def use(self, domain: Domain) -> None:
        """Switch to a domain with other objects."""
        self._domain = domain

    @property
    def unmet(self) -> tuple[UnmetEffect, ...]:
        """The unmet effects."""
        return tuple(self._unmet.values())

    @property
    def domain(self) -> Domain:
        """The domain without the effects that cannot be expected."""
        limits = self._hopeless.union(self._unmet)
        return self._limited(self._domain, limits) if limits else self._domain

    def ended(self, step: Step, state: State) -> tuple[UnmetEffect, ...]:
        """Note that a step succeeded; return its unmet effects."""
        domain = self._domain
        binding = binding_of(domain, step)
        _, added = changes(domain, domain.schema_of[step.schema].effects, binding, state)
        unmet = dict[Limit, UnmetEffect]()
        for atom in sorted(added & domain.feasibility.keys()):
            action = domain.feasibility[atom]
            if not self._kb.is_feasible(action):
                limit = step.schema, tuple(binding.items()), action
                causes = causes_of(self._kb, action)
                unmet[limit] = UnmetEffect(step, action, causes, why_of(self._kb, action))
        self._unmet |= unmet
        return tuple(unmet.values())

    def update(self) -> None:
        """Forget unmet effects whose causes have gone."""
        self._hopeless = hopeless_promises(self._domain, self._kb)
        for limit, unmet in tuple(self._unmet.items()):
            left = frozenset[str]()
            if not self._kb.is_feasible(unmet.action):
                left = unmet.causes & causes_of(self._kb, unmet.action)
            self._unmet[limit] = replace(unmet, causes=left)
            if not left:
                del self._unmet[limit]

    def assumptions(self, steps: Iterable[Step], state: State) -> tuple[str, ...]:
        """Return what a plan assumes about what makes actions feasible, in sentences.

        Nothing is assumed about an action whose model says what it restores, if the cause is known.
        """
        domain = self._domain
        sentences = dict[str, None]()
        model = getattr(self._kb, "model", None)
        feasibility = domain.feasibility
        for step in steps:
            schema = domain.schema_of[step.schema]
            _, added = changes(domain, schema.effects, binding_of(domain, step), state)
            restores = ()
            if model is not None and step.action is not None:
                restores = model.actions[step.action].restores
            for atom in sorted((added - state) & feasibility.keys()):
                cured = feasibility[atom]
                is_supposed = self._kb.is_feasible(cured)  # unfeasible for no known cause
                if is_supposed or not restores:
                    why = f"{cured} is unfeasible" if is_supposed else why_of(self._kb, cured)
                    sentences[f"assumes that {step.schema} cures: {why}"] = None
            state = ended(domain, step, started(domain, step, state))
        return tuple(sentences)


def _limited(domain: Domain, limits: Iterable[Limit]) -> Domain:
    """Return a domain in which actions do not make others feasible beyond limits."""
    schemas = dict(domain.schema_of)
    for name, objects, action in sorted(limits):
        pairs = [("same", *pair) for pair in objects]

        def limited(
            effect: Effect, pairs: Sequence[Formula] = pairs, cured: str = action
        ) -> Effect:
            if effect.kind != "add" or effect.name.lower() != FEASIBLE:
                return effect
            excluded = ("and", *pairs, ("same", effect.terms[0], cured))
            return effect._replace(condition=("and", effect.condition, ("not", excluded)))

        schemas[name] = schemas[name].with_effects(limited)
    return replace(domain, schema_of=schemas)


def hopeless_promises(domain: Domain, kb: Any) -> frozenset[Limit]:  # noqa: ANN401  # may explain
    """Return the ROSA actions that PDDL actions cannot make feasible now, though they promise it.

    An action says in the model what it restores: attributes and components. It makes another one
    feasible only if some remedy of that one consists of these.
    """
    model = getattr(kb, "model", None)
    if model is None:
        return frozenset()
    unfeasible = [action for action in domain.rosa_actions if not kb.is_feasible(action)]
    hopeless = set[Limit]()
    for schema in domain.schema_of.values() if unfeasible else ():
        if FEASIBLE not in {e.name.lower() for e in schema.effects if e.kind == "add"}:
            continue
        for curing in domain.rosa_actions:
            cure = model.actions[curing]
            if not cure.restores or not domain.may_do(schema, curing):
                continue
            done = ((f"?{schema.action}", curing),) if schema.action != curing else ()
            for action in unfeasible:
                if not kb.explain(action).is_restored_by(cure):
                    hopeless.add((schema.name, done, action))
    return frozenset(hopeless)


def why_of(kb: Any, action: str) -> str:  # noqa: ANN401  # it may explain
    """Return in words why an action is unfeasible."""
    return str(kb.why(action)) if hasattr(kb, "why") else f"{action} is unfeasible"


def causes_of(kb: Any, action: str) -> frozenset[str]:  # noqa: ANN401  # it may explain
    """Return the root causes why an action is unfeasible, as kind and name.

    The action if unknown.
    """
    if not hasattr(kb, "explain"):
        return frozenset({action})
    causes = set[str]()
    seen = set[str]()
    left = [kb.explain(action)]
    while left:
        reason = left.pop()
        key = f"{reason.kind} {reason.name}"
        if key not in seen:
            seen.add(key)
            deeper = tuple(reason.causes)
            left += deeper
            if not deeper:
                causes.add(key)
    return frozenset(causes)
