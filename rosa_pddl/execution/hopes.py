"""Hopes that were disappointed: a step ended well, but what it was to make feasible stayed unfeasible.

Such a hope is not relied upon again while it is in doubt. It is as long as something that kept the action from being
feasible when the step had ended has done so ever since: the step has shown that it does not change that. If all of it
has gone, or the action was feasible in between, whatever keeps it from being feasible now is something else.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Protocol, runtime_checkable

from rosa_pddl.domain import Domain, Feasibility, State, Step, UpThing
from rosa_pddl.planning.grounding import lock_of
from rosa_pddl.problem import action_costs
from rosa_pddl.validate import affected_atoms, binding_of, changes

__all__ = ["Disappointment", "Hopes"]

_MOST_DOMAINS = 8


class Reason(Protocol):
    """An element, and what its status follows from."""

    @property
    def kind(self) -> str:
        """The element's kind."""

    @property
    def name(self) -> str:
        """The element's name."""

    @property
    def causes(self) -> "Iterable[Reason]":
        """What the status follows from."""


@runtime_checkable
class _Explaining(Protocol):
    """What a knowledge base may offer beside feasibility; `kb.KnowledgeBase` does."""

    def explain(self, element: str) -> Reason:
        """Say why an action has its status."""

    def why(self, element: str) -> str:
        """Say the same in a sentence."""


@dataclass(frozen=True)
class Disappointment:
    """A step that ended well without making feasible what it was to.

    Args:
        step: what was done.
        action: the ROSA action that stayed unfeasible.
        causes: what has kept it from being feasible ever since, by kind and name.
        why: the same in a sentence.
    """

    step: Step
    action: str
    causes: frozenset[str]
    why: str

    def __str__(self) -> str:
        return f"{self.step} did not make {self.action} feasible: {self.why}"


class Hopes:
    """Which hopes are in doubt, and the domain without them.

    Args:
        domain: what `load_domain` returned.
        kb: says what is feasible; one that explains itself also says why not.
    """

    def __init__(self, domain: Domain, kb: Feasibility) -> None:
        self._domain, self._kb = domain, kb
        self._doubts: dict[tuple[Step, str], Disappointment] = {}
        self._without = lru_cache(_MOST_DOMAINS)(self._made)

    @property
    def doubts(self) -> tuple[Disappointment, ...]:
        """What is not relied upon, in the order in which it happened."""
        return tuple(self._doubts.values())

    @property
    def domain(self) -> Domain:
        """The domain without the hopes that are in doubt; the same object for the same ones."""
        return self._without(frozenset(self._doubts)) if self._doubts else self._domain

    def ended(self, step: Step, state: State) -> tuple[Disappointment, ...]:
        """Take in that a step ended well; return the hopes that it did not fulfil."""
        found = tuple(
            Disappointment(step, action, _causes(self._kb, action), _why(self._kb, action))
            for action in self._hoped(step, state)
            if not self._kb.is_feasible(action)
        )
        self._doubts |= {(one.step, one.action): one for one in found}
        return found

    def look(self) -> bool:
        """Take in what is known now; return whether some hope is not in doubt any more."""
        before = len(self._doubts)
        for key, doubt in tuple(self._doubts.items()):
            feasible = self._kb.is_feasible(doubt.action)
            left = frozenset() if feasible else doubt.causes & _causes(self._kb, doubt.action)
            if left:
                self._doubts[key] = replace(doubt, causes=left)
            else:
                del self._doubts[key]
        return len(self._doubts) < before

    def _hoped(self, step: Step, state: State) -> Iterator[str]:
        """Yield the ROSA actions that a step is to make feasible."""
        schema = self._domain.schema_of[step.schema]
        effects = schema.start_effects + schema.end_effects
        _, made = changes(self._domain, effects, binding_of(self._domain, step), state)
        known = {self._domain.feasible_atom(one): one for one in self._domain.rosa_actions}
        yield from (known[atom] for atom in sorted(made & known.keys()))

    def _made(self, doubts: frozenset[tuple[Step, str]]) -> Domain:
        with lock_of(self._domain):
            return _without(self._domain, sorted(doubts, key=str))


def _causes(kb: Feasibility, action: str) -> frozenset[str]:
    """Return what an action is unfeasible for in the end, by kind and name; of a kb that cannot tell, the action."""
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


def _why(kb: Feasibility, action: str) -> str:
    return kb.why(action) if isinstance(kb, _Explaining) else f"{action} is unfeasible"


def _without(domain: Domain, doubts: Iterable[tuple[Step, str]]) -> Domain:
    """Return a domain in which some steps are not hoped to make some actions feasible.

    What is translated for Fast Downward gets conditions that say for which objects there is no hope; they vanish when
    it is translated. Temporal engines seldom know such conditions, so for them the effect is left out for all objects.
    """
    problem, schemas = domain.up_problem.clone(), dict(domain.schema_of)
    for step, action in doubts:
        schema, up_action = schemas[step.schema], problem.action(domain.inside["action", step.schema.lower()])
        limited = partial(_limited, domain, up_action, step, action)
        schemas[step.schema] = replace(
            schema,
            start_effects=tuple(map(limited, schema.start_effects)),
            end_effects=tuple(map(limited, schema.end_effects)),
        )
        effects = up_action.effects
        for listed in effects.values() if isinstance(effects, dict) else [effects]:
            listed[:] = [effect for effect in listed if not _hopes_for(domain, effect, step, action)]
    _keep_costs(domain, problem)
    return replace(domain, up_problem=problem, schema_of=schemas, _atoms={})


def _keep_costs(domain: Domain, problem: UpThing) -> None:
    """Tell a problem what its actions cost, as unified-planning finds that by whole actions, of which some changed."""
    from unified_planning.model.metrics import MinimizeActionCosts

    given = action_costs(domain)
    if given is not None:
        costs = {problem.action(action.name): cost for action, cost in given.costs.items()}
        problem.clear_quality_metrics()
        problem.add_quality_metric(MinimizeActionCosts(costs, given.default, problem.environment))


def _hopes_for(domain: Domain, effect: UpThing, step: Step, action: str) -> bool:
    if not effect.fluent.type.is_bool_type() or effect.value.is_false():
        return False
    return domain.feasible_atom(action) in affected_atoms(domain, [effect], binding_of(domain, step))


def _limited(domain: Domain, up_action: UpThing, step: Step, action: str, effect: UpThing) -> UpThing:
    """Return an effect that does not come about for the objects of a step, if it hopes for a ROSA action there."""
    if not _hopes_for(domain, effect, step, action):
        return effect
    manager = domain.up_problem.environment.expression_manager
    things = [domain.up_problem.object(domain.inside["object", name.lower()]) for name in (*step.arguments, action)]
    places = [*(manager.ParameterExp(one) for one in up_action.parameters), effect.fluent.arg(0)]
    same = [manager.Equals(place, manager.ObjectExp(thing)) for place, thing in zip(places, things, strict=True)]
    made = effect.clone()
    made.set_condition(manager.And(effect.condition, manager.Not(manager.And(same))))
    return made
