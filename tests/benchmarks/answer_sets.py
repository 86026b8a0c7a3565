"""The status tables as an answer-set program, solved again by clingo after each event.

Measured values enter as ranks among the thresholds of their attribute, because clingo knows whole numbers only.
Statuses asserted outright do not occur in the stories and are left out. Facts as assumptions of each solving instead of
external atoms were tried too: as fast, within a tenth.
"""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from generated import Happening
from naive_peers import Key, keys

from kb import Model

if TYPE_CHECKING:
    import clingo

__all__ = ["Grounded", "MultiShot"]

RULES = """
holds(C) :- compares(C,A,ge,T), measured(A,R), R >= T.
holds(C) :- compares(C,A,gt,T), measured(A,R), R > T.
holds(C) :- compares(C,A,le,T), measured(A,R), R <= T.
holds(C) :- compares(C,A,lt,T), measured(A,R), R < T.
known(A) :- measured(A,_).
status(C,not_evaluated) :- compares(C,A,_,_), not known(A).
status(C,satisfied) :- holds(C).
status(C,violated) :- compares(C,A,_,_), known(A), not holds(C).
prevented(E) :- constrains(C,E), status(C,violated).

required(A) :- requested(A).
required(F) :- requires(A,F), required(A).
required(P) :- uses(D,P), selected(D).

status(G,unfeasible) :- configures(G,_), prevented(G).
status(G,feasible) :- configures(G,_), not prevented(G).

configurable(P) :- configures(_,P).
possible(P) :- configures(G,P), not prevented(G).
configured(P) :- configures(G,P), selected(G).
misconfigured(P) :- configures(G,P), selected(G), prevented(G).
status(P,failure) :- component(P), failed(P).
out(P) :- component(P), prevented(P).
out(P) :- configurable(P), not possible(P).
status(P,unfeasible) :- out(P), not failed(P).
lost(P) :- status(P,failure).
lost(P) :- out(P).
status(P,configuration_error) :- component(P), required(P), not lost(P), misconfigured(P).
lacking(P) :- component(P), not active(P).
lacking(P) :- configurable(P), not configured(P).
status(P,unsolved) :- required(P), lacking(P), not lost(P), not misconfigured(P).
status(P,solved) :- component(P), required(P), not lacking(P), not lost(P), not misconfigured(P).
status(P,feasible) :- component(P), not required(P), not lost(P).

impossible(D) :- realises(D,_), prevented(D).
impossible(D) :- uses(D,P), lost(P).
wrong(D) :- uses(D,P), status(P,configuration_error).
undone(D) :- uses(D,P), not status(P,solved).
status(D,unfeasible) :- impossible(D).
status(D,implicit_configuration_error) :- realises(D,_), selected(D), not impossible(D), wrong(D).
status(D,unsolved) :- realises(D,_), selected(D), not impossible(D), not wrong(D), undone(D).
status(D,solved) :- realises(D,_), selected(D), not impossible(D), not wrong(D), not undone(D).
status(D,feasible) :- realises(D,_), not selected(D), not impossible(D).

realisable(F) :- realises(D,F), not impossible(D).
in_error(F) :- realises(D,F), selected(D), impossible(D).
implied(F) :- realises(D,F), status(D,implicit_configuration_error).
done(F) :- realises(D,F), status(D,solved).
wanted(F) :- function(F), required(F), realisable(F).
status(F,unfeasible) :- function(F), not realisable(F).
status(F,configuration_error) :- wanted(F), in_error(F).
status(F,implicit_configuration_error) :- wanted(F), not in_error(F), implied(F).
status(F,solved) :- wanted(F), not in_error(F), not implied(F), done(F).
status(F,unsolved) :- wanted(F), not in_error(F), not implied(F), not done(F).
status(F,feasible) :- function(F), realisable(F), not required(F).

barred(A) :- action(A), prevented(A).
barred(A) :- requires(A,F), status(F,unfeasible).
faulty(A) :- requires(A,F), status(F,configuration_error).
faulty(A) :- requires(A,F), status(F,implicit_configuration_error).
pending(A) :- requires(A,F), not status(F,solved).
status(A,unfeasible) :- barred(A).
status(A,implicit_configuration_error) :- action(A), required(A), not barred(A), faulty(A).
status(A,unsolved) :- action(A), required(A), not barred(A), not faulty(A), pending(A).
status(A,solved) :- action(A), required(A), not barred(A), not faulty(A), not pending(A).
status(A,feasible) :- action(A), not required(A), not barred(A).
#show status/2.
"""
CHANGEABLE = """
#external measured(A,R) : bounded(A,N), R = 0..2*N.
#external requested(A) : action(A).
#external failed(P) : component(P).
#external active(P) : component(P).
#external selected(D) : realises(D,_).
#external selected(G) : configures(G,_).
"""
OPERATORS = {">=": "ge", ">": "gt", "<=": "le", "<": "lt"}
KIND_OF = {
    "failed": "component",
    "active": "component",
    "requested": "action",
    "measured": "attribute",
}


class _Program:
    """A model as facts of the program; every element is a number."""

    control: "clingo.Control"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.keys = [*keys(model), *(("attribute", name) for name in model.attributes)]
        self.number = {key: number for number, key in enumerate(self.keys)}
        bounds: dict[str, set[float]] = defaultdict(set)
        for constraint in model.constraints:
            bounds[constraint.attribute].add(constraint.value)
        self.bounds = {name: sorted(bounds[name]) for name in model.attributes}
        self.structure = " ".join(self._structure())

    def _structure(self) -> Iterator[str]:
        model, number = self.model, self.number
        kinds = {"Action": "action", "FunctionDesign": "design", "Component": "component"}
        for kind, table in (
            ("action", model.actions),
            ("function", model.functions),
            ("component", model.components),
        ):
            yield from (f"{kind}({number[kind, name]})." for name in table)
        for name, bounds in self.bounds.items():
            yield f"bounded({number['attribute', name]},{len(bounds)})."
        for action in model.actions.values():
            for function in action.functions:
                yield f"requires({number['action', action.name]},{number['function', function]})."
        for design in model.designs.values():
            yield f"realises({number['design', design.name]},{number['function', design.function]})."
            for component in design.components:
                yield f"uses({number['design', design.name]},{number['component', component]})."
        for one in model.configurations.values():
            yield f"configures({number['configuration', one.name]},{number['component', one.component]})."
        for position, one in enumerate(model.constraints):
            this, attribute = number["constraint", position], number["attribute", one.attribute]
            threshold = self.rank(one.attribute, one.value)
            yield f"compares({this},{attribute},{OPERATORS[one.operator]},{threshold})."
            for element in one.constrained:
                kind = kinds.get(type(element).__name__, "configuration")
                yield f"constrains({this},{number[kind, element.name]})."

    def rank(self, attribute: str, value: float) -> int:
        """Return where a value lies: odd numbers are thresholds, even ones lie between them."""
        bounds = self.bounds[attribute]
        below = bisect_left(bounds, value)
        return 2 * below + (below < len(bounds) and bounds[below] == value)

    def atom(self, happening: Happening) -> tuple[str, list[int]]:
        """Return the predicate and the arguments that say what happened."""
        what, name, value = happening
        kind = KIND_OF.get(what) or ("design" if name in self.model.designs else "configuration")
        place = self.number[kind, name]
        return what, [place, self.rank(name, value)] if what == "measured" else [place]

    def statuses(self) -> Mapping[Key, str]:
        found = {}
        with self.control.solve(yield_=True) as handle:
            for symbol in handle.model().symbols(shown=True):
                element, status = symbol.arguments
                key = self.keys[element.number]
                assert key not in found, key
                found[key] = status.name.replace("_", " ")
        return found


class MultiShot(_Program):
    """Grounded once; facts are external atoms that are set and cleared between one solving and the next."""

    def __init__(self, model: Model, told: Iterable[Happening]) -> None:
        from clingo import Control

        super().__init__(model)
        self.control = Control(["--warn=none"])
        self.control.enable_cleanup = (
            False  # nothing is ever released; a quarter faster without looking for that
        )
        self.control.add("base", [], RULES + CHANGEABLE + self.structure)
        self.control.ground([("base", [])])
        self.measured: dict[str, object] = {}
        for happening in told:
            self.assign(happening)

    def assign(self, happening: Happening) -> None:
        from clingo import Function, Number

        predicate, arguments = self.atom(happening)
        symbol = Function(predicate, [Number(one) for one in arguments])
        if predicate == "measured":
            if happening.name in self.measured:
                self.control.assign_external(self.measured[happening.name], False)
            self.measured[happening.name] = symbol
        self.control.assign_external(symbol, happening.value is not False)

    def tell(self, happening: Happening) -> None:
        self.assign(happening)
        assert self.control.solve().satisfiable


class Grounded(_Program):
    """Grounded and solved anew for each event, from plain facts, so that grounding can simplify all."""

    def __init__(self, model: Model, told: Iterable[Happening]) -> None:
        super().__init__(model)
        self.facts: dict[tuple[str, str], str] = {}
        for happening in told:
            self.note(happening)

    def note(self, happening: Happening) -> None:
        predicate, arguments = self.atom(happening)
        if happening.value is False:
            self.facts.pop((predicate, happening.name), None)
        else:
            self.facts[predicate, happening.name] = f"{predicate}({','.join(map(str, arguments))})."

    def tell(self, happening: Happening) -> None:
        from clingo import Control

        self.note(happening)
        self.control = Control(["--warn=none"])
        self.control.add("base", [], RULES + self.structure + " ".join(self.facts.values()))
        self.control.ground([("base", [])])
        assert self.control.solve().satisfiable
