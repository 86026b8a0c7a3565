"""Amendments of a model as they are written in events, and how a model is amended again as it was before."""

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from kb import owl
from kb.elements import CHECKS, Changeable, Constraint, Estimation
from kb.model import Model

Amendment = Sequence[Any]
"""How elements were amended and which: "declared" or "changed" as `plain_json` writes them, "removed" by id."""


def amendment(how: str, changed: Sequence[Changeable], serials: owl.Serials) -> Amendment:
    if how == "removed":
        return how, owl.element_id(changed[0], serials)
    return how, owl.plain_json(made for one in changed for made in owl.individual(one, serials))


def amend(model: Model, serials: owl.Serials, how: str, written: Any) -> None:  # noqa: ANN401  # what JSON holds
    """Change a model as it was changed before; see `Amendment`."""
    is_id = how == "removed"
    if isinstance(written, str) is not is_id or isinstance(written, list | tuple) is is_id:
        raise TypeError(f"{how} {written!r} is no amendment of a model")
    known = {owl.element_id(one, serials): one for table in model.tables.values() for one in table.values()}
    if is_id:
        model.remove(known[written])
        return
    given = owl.from_json(written)
    declarer = owl.Declarer(model, known)
    if how == "declared":
        with model.at_once():
            declarer.declare(given)
        for one in given:
            if isinstance(made := declarer.known.get(one.id), Constraint | Estimation):
                serials[made] = int(one.id.rpartition(".")[2])
        return
    declarer.nested = {one.id: one for one in given}
    element = known[given[-1].id]
    values = declarer.values(type(element), given[-1])
    can_change = {one for one, field in CHECKS[type(element)].items() if field.can_change}
    model.change(
        element, **{one.name: values.get(one.name, one.default) for one in fields(element) if one.name in can_change}
    )


def rebuilt(declared: Sequence[Any], amendments: Iterable[Amendment]) -> tuple[Model, owl.Serials]:
    """Return the model of a declaration (in `plain_json`) and later amendments, and the numbers of its elements."""
    given = owl.from_json(declared)
    names = [str(value) for one in given if one.kind == owl.MODEL for value in one.values["name"]]
    then = Model(names[0])
    owl.Declarer(then).declare(given)
    numbers = owl.Serials.of(then)
    for one in amendments:
        amend(then, numbers, *one)
    return then, numbers


def amended_alike(then: Model, numbers: owl.Serials, model: Model) -> owl.Serials | None:
    """Return the numbers of a model's elements for those of an equal model; None if the models differ."""
    if then != model:
        return None
    pairs = zip(owl.unnamed(then), owl.unnamed(model), strict=True)
    return owl.Serials((now, numbers[before]) for before, now in pairs)


def differences(then: Model, now: Model, kept_in: str = "store") -> list[str]:
    """Say which statements are in only one of two models; nothing if they are equal. `kept_in` is where `then` is."""
    if then == now:
        return []
    before, after = _statements(then), _statements(now)
    return [
        *(f"{one} is not in the {kept_in}" for one in after if one not in before),
        *(f"{one} is in the {kept_in} only" for one in before if one not in after),
    ] or ["the order of its elements is another"]


def _statements(model: Model) -> dict[str, None]:
    """Return all that a model says; what has no name is known by what is said of it alone."""
    statements: dict[str, None] = {}
    for one in owl.individuals(model):
        given = {name: " and ".join(map(owl.shown, each)) for name, each in one.values.items()}
        said = (f"{name} {shown}" for name, shown in given.items() if name != "position")
        own = one.kind if one.id.rpartition(".")[2].isdigit() else one.id
        statements[f"{own} ({', '.join(said)})"] = None
    return statements
