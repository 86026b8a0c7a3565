"""Amendments of a model as they are written in events, and how a model is amended again as it was before."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any, NamedTuple

from kb.elements import Changeable, Constraint, Estimation
from kb.facts import tables_of
from kb.model import Model
from kb.owl.declaring import Declarer
from kb.owl.individuals import Serials, element_id, from_json, individual, individuals, plain_json


class Amendment(NamedTuple):
    """Elements "declared" or "changed", as `plain_json` writes them, or the id of the one with which others went."""

    how: str
    written: Any


def amendment(how: str, changed: Sequence[Changeable], serials: Serials) -> Amendment:
    if how == "removed":
        return Amendment(how, element_id(changed[0], serials))
    return Amendment(how, plain_json(made for one in changed for made in individual(one, serials)))


def amend(model: Model, serials: Serials, how: str, written: Any) -> None:  # noqa: ANN401  # what JSON holds
    """Change a model as it was changed before; see `Amendment`."""
    is_id = how == "removed"
    if isinstance(written, str) is not is_id or isinstance(written, list | tuple) is is_id:
        raise TypeError(f"{how} {written!r} is no amendment of a model")
    named = (one for table in tables_of(model).values() for one in table.values())
    everything: tuple[Changeable, ...] = (*named, *model.constraints, *model.estimations)
    known = {element_id(one, serials): one for one in everything}
    if is_id:
        model.remove(known[written])
        return
    given = from_json(written)
    declarer = Declarer(model, known)
    if how == "declared":
        declarer.declare(given)
        for one in given:
            if isinstance(made := declarer.known.get(one.id), Constraint | Estimation):
                serials.give(made, int(one.id.rpartition(".")[2]))
        return
    declarer.nested = {one.id: one for one in given}
    element = known[given[-1].id]
    values = declarer.values(type(element), given[-1])
    unsaid = {one.name: one.default for one in fields(element) if one.default is not MISSING and one.name != "kind"}
    fresh = {**unsaid, **values}
    model.change(
        element, **{name: value for name, value in fresh.items() if _plain(value) != _plain(getattr(element, name))}
    )


def amended_alike(declared: Sequence[Any], amendments: Iterable[Amendment], model: Model) -> Serials | None:
    """Return the numbers for a model that is as one declared so (in `plain_json`) and amended so; None if it is not."""
    then = Model(model.name)
    Declarer(then).declare(from_json(declared))
    numbers = Serials(then)
    for one in amendments:
        amend(then, numbers, *one)
    if plain_json(individuals(then)) != plain_json(individuals(model)):
        return None
    serials = Serials(Model(model.name))
    for before, now in zip(then.constraints, model.constraints, strict=True):
        serials.give(now, numbers.of(before))
    for was, given in zip(then.estimations, model.estimations, strict=True):
        serials.give(given, numbers.of(was))
    return serials


def differences(stored: Iterable[Any], given: Iterable[Any]) -> Iterator[str]:
    """Say how a model differs from another one, both as `plain_json` writes them."""
    before = {own: (kind, values) for kind, own, values in stored}
    now = {own: (kind, values) for kind, own, values in given}
    for own in {**before, **now}:
        if own not in now:
            yield f"{own} is in the store only"
        elif own not in before:
            yield f"{own} is not in the store"
        elif before[own] != now[own]:
            (was, old), (kind, new) = before[own], now[own]
            names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
            words = [f"{name} {_shown(new.get(name))}, in the store {_shown(old.get(name))}" for name in names]
            yield f"{own} has {', '.join(words)}" if words else f"{own} is a {kind}, in the store a {was}"


def _plain(value: object) -> object:
    return repr(dict(value)) if isinstance(value, Mapping) else value


def _shown(values: Sequence[Any] | None) -> str:
    shown = [one["ref"] if isinstance(one, dict) else repr(one) for one in values or ()]
    return " and ".join(shown) or "none"
