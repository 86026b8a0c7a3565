"""How a knowledge base continues from what a store holds: the model as it was amended, and every fact."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from kb.contents import Contents, tables_of
from kb.declaring import Declarer
from kb.elements import Changeable, Constraint, Estimation
from kb.exceptions import InvalidValue
from kb.history import Attempt, Process, VetoAnswer
from kb.individuals import (
    Individual,
    Ref,
    Serials,
    element_id,
    from_json,
    individuals,
    name_of,
    parameter_values,
    plain_json,
)
from kb.inference.network import Node
from kb.inference.settling import settle
from kb.inference.state import Reason
from kb.model import Model
from kb.rdfxml import BASE
from kb.reconfiguration import ReconfigurationPlan, plain
from kb.requests import RequiredAction
from kb.status import Status
from kb.store.journal import COLUMNS, Record
from kb.store.writer import Store, StoreError

if TYPE_CHECKING:
    from kb.knowledge_base import KnowledgeBase

__all__ = ["Past", "base_of", "open_store", "resume"]

_ARRAYS: Final[Mapping[str, str]] = {kind: column for column, kind in COLUMNS.items()}


class Past(NamedTuple):
    """What a store holds.

    Attributes:
        store: open, and not writing yet.
        facts: in order.
        serials: the numbers that elements without a name have in them.
    """

    store: Store
    facts: Sequence[Individual]
    serials: Serials


def base_of(model: Contents) -> str:
    """Return the IRI of a model."""
    return f"{BASE}{next(individuals(model)).id}"


def open_store(model: Model, path: str | Path, keep: int) -> Past:
    """Open the store of a model, or make it; the model is amended as it was before.

    Raises:
        InvalidValue: the path is none.
        StoreError: the file cannot be used, or is the store of another model.
    """
    if not isinstance(path, str | Path) or not str(path):
        raise InvalidValue(f"a store is the path of a file, or None for none, not {path!r}")
    given = list(individuals(model))
    written = json.dumps(plain_json(given))
    store = Store(Path(path), base_of(model), written, given, keep)
    try:
        declared = store.declared
        differences = [] if declared == written else list(_differences(json.loads(declared), json.loads(written)))
        amendments = [json.loads(one) for one in store.amendments()]
        if not differences:
            serials = Serials(model)
            _amend(model, serials, amendments)
        else:
            serials = _as_amended(store, model, from_json(json.loads(declared)), amendments, differences)
        facts = store.open(base_of(model))
    except BaseException:
        store.release()
        raise
    return Past(store, facts, serials)


def resume(kb: "KnowledgeBase", facts: Iterable[Individual], now: float) -> None:
    """Enter what was told before; plans and attempts that were under way are abandoned."""
    resumption = _Resumption(kb)
    for fact in facts:
        resumption.enter(fact)
    left = list(kb._open_plans)
    kb._open_plans.clear()
    for plan in left:
        plan._finish("abandoned", now)
    given_up = [attempt for attempt in kb._attempts if attempt.end is None]
    for attempt in given_up:
        attempt._finish("abandoned", "nobody saw what came of it", now)
    kb._journal.enter(now, kb._known, (), [*left, *given_up])
    settle(kb._known, resumption.nodes.values())


class _Resumption:
    """Enters facts in a knowledge base, in order."""

    def __init__(self, kb: "KnowledgeBase") -> None:
        self.kb, self.journal = kb, kb._journal
        there = (kb._network.find(one) for one in _everything(kb.model) if not isinstance(one, Estimation))
        self.nodes = {element_id(node.element, self.journal.serials): node for node in there}
        self.inner: dict[str, Individual] = {}
        self.plans: dict[str, ReconfigurationPlan] = {}

    def enter(self, fact: Individual) -> None:
        """Enter what still is so, and what is on record."""
        if fact.kind in ("Parameter", "Preference"):
            self.inner[fact.id] = fact
        elif fact.kind == "Measurement":
            self._measurement(fact)
        elif fact.kind in _ARRAYS and "end" not in fact.values:
            self._state(fact)
        elif fact.kind == "ParametersInForce" and "end" not in fact.values:
            self._parameters(fact)
        elif fact.kind in _RECORDS:
            record = _RECORDS[fact.kind](self, fact)
            if record is not None:
                self.journal.adopt_record(_number(fact), record)

    def _measurement(self, fact: Individual) -> None:
        measurements, node = self.kb._measurements, self._node(fact, "measures")
        if node is None:
            return
        value, time = _only(fact, "value"), _only(fact, "time")
        if "latest" in fact.values:
            measurements.history_of(node).add(time, value)
            return
        for _ in measurements.due(time):
            pass  # what has become so with time is entered, and inferred with all the rest
        measurements.take(node, value, time)

    def _state(self, fact: Individual) -> None:
        node, column = self._node(fact, "about"), _ARRAYS[fact.kind]
        if node is None:
            return
        value: Status | bool = Status(_only(fact, "status")) if "status" in fact.values else True
        if isinstance(value, Status) and column == "verdict":
            self.kb._measurements.resume(node, value, _only(fact, "start"))
        else:
            getattr(self.kb._known, column)[node.index] = value
        text, until = _only(fact, "reason", ""), _only(fact, "until")
        self.kb._known.give_reason(column, node, text, until)
        if until is not None:
            self.kb._lapses.set(node.index, until)
        reason = Reason(text, until) if text or until is not None else None
        self.journal.adopt(_number(fact), column, node, value, reason)

    def _parameters(self, fact: Individual) -> None:
        node = self._node(fact, "about")
        if node is not None:
            self.kb._in_force[node.name] = self._given_parameters(fact)
            self.journal.adopt_configured(_number(fact), node.name)

    def required_action(self, fact: Individual) -> RequiredAction:
        """Enter a request."""
        weights = dict(self._weight(one.id) for one in fact.values.get("hasPreference", ()) if isinstance(one, Ref))
        preference: str | Mapping[str, float] | None = MappingProxyType(weights) if weights else None
        if list(weights.values()) == [1.0]:
            (preference,) = weights
        reason = _only(fact, "reason", "")
        record = RequiredAction(_name(fact, "about"), preference, *_span(fact), _only(fact, "result"), reason)
        self.kb._history.append(record)
        node = self._node(fact, "about")
        if record.end is None and node is not None:
            self.kb._open[record.action] = record
            self.kb._known.requested[node.index] = True
        return record

    def plan(self, fact: Individual) -> ReconfigurationPlan:
        """Enter a plan."""
        activate, deactivate, parameters = (
            _names(fact, word) for word in ("activates", "deactivates", "setsParametersOf")
        )
        reason, result = _only(fact, "reason", ""), _only(fact, "result")
        known = self.kb._network.components
        nodes = [known[name] for name in (*activate, *deactivate) if name in known]
        plan = ReconfigurationPlan(activate, deactivate, parameters, reason, *_span(fact), result, plain(nodes))
        self.plans[fact.id] = plan
        self.kb._plans.append(plan)
        if plan.end is None:
            self.kb._open_plans.append(plan)
        return plan

    def process(self, fact: Individual) -> Process:
        """Enter a process."""
        process = Process(_name(fact, "about"), _only(fact, "pid"), *_span(fact))
        self.kb._processes.append(process)
        return process

    def attempt(self, fact: Individual) -> Attempt | None:
        """Enter an attempt."""
        plan = self._plan_of(fact)
        if plan is None:
            return None
        configured = _names(fact, "setsParametersOf")
        attempt = Attempt(
            plan,
            _name(fact, "about"),
            _only(fact, "operation"),
            configured[0] if configured else None,
            MappingProxyType(self._given_parameters(fact)),
            _only(fact, "number"),
            *_span(fact),
            _only(fact, "result"),
            _only(fact, "reason", ""),
        )
        self.kb._attempts.append(attempt)
        return attempt

    def answer(self, fact: Individual) -> VetoAnswer | None:
        """Enter what was answered about a plan."""
        plan = self._plan_of(fact)
        if plan is None:
            return None
        answer = VetoAnswer(plan, _only(fact, "time"), _only(fact, "isVetoed"), _only(fact, "reason", ""))
        self.kb._answers.append(answer)
        return answer

    def _plan_of(self, fact: Individual) -> ReconfigurationPlan | None:
        """Return the plan that a fact is about; None if it was of another knowledge base."""
        (value,) = fact.values.get("ofPlan", (None,))
        return self.plans.get(value.id) if isinstance(value, Ref) else None

    def _given_parameters(self, fact: Individual) -> dict[str, Any]:
        inner = (self.inner[one.id] for one in fact.values.get("hasParameter", ()) if isinstance(one, Ref))
        return parameter_values(inner)

    def _weight(self, own: str) -> tuple[str, float]:
        inner = self.inner[own]
        return _name(inner, "prefers"), _only(inner, "weight")

    def _node(self, fact: Individual, word: str) -> Node | None:
        """Return the element that a fact is about; None if it is in the model no longer."""
        (value,) = fact.values[word]
        return self.nodes.get(value.id) if isinstance(value, Ref) else None


_RECORDS: Final[Mapping[str, Callable[[_Resumption, Individual], Record | None]]] = {
    "RequiredAction": _Resumption.required_action,
    "ReconfigurationPlan": _Resumption.plan,
    "ComponentProcess": _Resumption.process,
    "Attempt": _Resumption.attempt,
    "VetoAnswer": _Resumption.answer,
}


def _only(fact: Individual, word: str, unsaid: Any = None) -> Any:  # noqa: ANN401  # of the type that was written
    (value,) = fact.values.get(word, (unsaid,))
    return value


def _span(fact: Individual) -> tuple[float, float | None]:
    return _only(fact, "start"), _only(fact, "end")


def _names(fact: Individual, word: str) -> tuple[str, ...]:
    return tuple(name_of(one.id) for one in fact.values.get(word, ()) if isinstance(one, Ref))


def _name(fact: Individual, word: str) -> str:
    (name,) = _names(fact, word)
    return name


def _number(fact: Individual) -> int:
    return int(fact.id.rpartition(".")[2])


def _amend(model: Model, serials: Serials, amendments: Iterable[Mapping[str, Any]]) -> None:
    """Change a model again as it was changed before."""
    for amendment in amendments:
        known = {element_id(one, serials): one for one in _everything(model)}
        ((how, what),) = amendment.items()
        if how == "removed":
            model.remove(known[what])
            continue
        given = from_json(what)
        declarer = Declarer(model, known)
        if how == "declared":
            declarer.declare(given)
            for one in given:
                if isinstance(made := declarer.known.get(one.id), Constraint | Estimation):
                    serials.give(made, _number(one))
        else:
            declarer.nested = {one.id: one for one in given}
            _change(model, declarer, known[given[-1].id], given[-1])


def _change(model: Model, declarer: Declarer, element: Changeable, wanted: Individual) -> None:
    values = declarer.values(type(element), wanted)
    unsaid = {one.name: one.default for one in fields(element) if one.default is not MISSING and one.name != "kind"}
    fresh = {**unsaid, **values}
    changed = {name: value for name, value in fresh.items() if _plain(value) != _plain(getattr(element, name))}
    model.change(element, **changed)


def _plain(value: object) -> object:
    return repr(dict(value)) if isinstance(value, Mapping) else value


def _everything(model: Model) -> Iterator[Changeable]:
    for table in tables_of(model).values():
        yield from table.values()
    yield from model.constraints
    yield from model.estimations


def _as_amended(
    store: Store,
    model: Model,
    declared: Iterable[Individual],
    amendments: Iterable[Mapping[str, Any]],
    differences: Sequence[str],
) -> Serials:
    """Return the numbers for a model that is amended already as the store says.

    Raises:
        StoreError: it is not.
    """
    then = Model(model.name)
    Declarer(then).declare(declared)
    numbers = Serials(then)
    _amend(then, numbers, amendments)
    if plain_json(individuals(then)) != plain_json(individuals(model)):
        raise _other_model(store, differences)
    serials = Serials(Model(model.name))
    for before, now in zip(then.constraints, model.constraints, strict=True):
        serials.give(now, numbers.of(before))
    for was, given in zip(then.estimations, model.estimations, strict=True):
        serials.give(given, numbers.of(was))
    return serials


def _other_model(store: Store, differences: Sequence[str]) -> StoreError:
    told = "; ".join(differences[:3]) + ("; ..." if len(differences) > 3 else "")
    return StoreError(f"{store.path}: the store is of another model: {told}. Give that model, or name another file")


def _differences(stored: Iterable[Any], given: Iterable[Any]) -> Iterator[str]:
    """Say how a model differs from the one in a store."""
    before = {own: (kind, values) for kind, own, values in stored}
    now = {own: (kind, values) for kind, own, values in given}
    for own in [*before, *(one for one in now if one not in before)]:
        if own not in now:
            yield f"{own} is in the store only"
        elif own not in before:
            yield f"{own} is not in the store"
        elif before[own] != now[own]:
            (was, old), (kind, new) = before[own], now[own]
            names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
            told = [f"{name} {_shown(new.get(name))}, in the store {_shown(old.get(name))}" for name in names]
            yield f"{own} has {', '.join(told)}" if told else f"{own} is a {kind}, in the store a {was}"


def _shown(values: Sequence[Any] | None) -> str:
    shown = [one["ref"] if isinstance(one, dict) else repr(one) for one in values or ()]
    return " and ".join(shown) or "none"
