"""The status tables as SPARQL over an ontology of owlready2, asked again after each event.

Each line of a table is one query, in the order of the tables: it gives a status to what has none yet.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from generated import Happening
from naive_peers import Key, keys

from kb import Model

__all__ = ["Ontology", "SparqlPeer"]

PREFIX = "PREFIX : <http://robot/#>\n"
COMPLEMENT = {">=": "<", ">": "<=", "<=": ">", "<": ">="}
COMPARED = (
    "?x :operator '{}' . ?x :compares ?a . ?a :measured ?v . ?x :threshold ?t . FILTER(?v {} ?t)"
)
PREVENTED = "?c :constrains ?x . ?c :status 'violated'"
CONFIGURABLE = "FILTER EXISTS { ?o :configures ?x }"

REQUIRED = (
    "?x :requested true",
    "?a :required true . ?a :requires ?x",
    "?d :selected true . ?d :uses ?x",
)
TABLES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "constraint": (
        ("not evaluated", "?x :compares ?a . FILTER NOT EXISTS { ?a :measured ?v }"),
        *(("satisfied", COMPARED.format(operator, operator)) for operator in COMPLEMENT),
        *(
            ("violated", COMPARED.format(operator, complement))
            for operator, complement in COMPLEMENT.items()
        ),
    ),
    "configuration": (("unfeasible", PREVENTED), ("feasible", "")),
    "component": (
        ("failure", "?x :failed true"),
        (
            "unfeasible",
            CONFIGURABLE + " FILTER NOT EXISTS { ?g :configures ?x . ?g :status 'feasible' }",
        ),
        ("unfeasible", PREVENTED),
        (
            "configuration error",
            "?x :required true . ?g :configures ?x . ?g :selected true . ?g :status 'unfeasible'",
        ),
        ("unsolved", "?x :required true . FILTER NOT EXISTS { ?x :active true }"),
        (
            "unsolved",
            "?x :required true . "
            + CONFIGURABLE
            + " FILTER NOT EXISTS { ?g :configures ?x . ?g :selected true }",
        ),
        ("solved", "?x :required true"),
        ("feasible", ""),
    ),
    "design": (
        ("unfeasible", PREVENTED),
        ("unfeasible", "?x :uses ?p . ?p :status 'failure'"),
        ("unfeasible", "?x :uses ?p . ?p :status 'unfeasible'"),
        (
            "implicit configuration error",
            "?x :selected true . ?x :uses ?p . ?p :status 'configuration error'",
        ),
        ("unsolved", "?x :selected true . ?x :uses ?p . ?p :status ?s . FILTER(?s != 'solved')"),
        ("solved", "?x :selected true"),
        ("feasible", ""),
    ),
    "function": (
        (
            "unfeasible",
            "FILTER NOT EXISTS { ?d :realises ?x . ?d :status ?s . FILTER(?s != 'unfeasible') }",
        ),
        (
            "configuration error",
            "?x :required true . ?d :realises ?x . ?d :selected true . ?d :status 'unfeasible'",
        ),
        (
            "implicit configuration error",
            "?x :required true . ?d :realises ?x . ?d :status '{status}'",
        ),
        ("solved", "?x :required true . ?d :realises ?x . ?d :status 'solved'"),
        ("unsolved", "?x :required true"),
        ("feasible", ""),
    ),
    "action": (
        ("unfeasible", PREVENTED),
        ("unfeasible", "?x :requires ?f . ?f :status 'unfeasible'"),
        (
            "implicit configuration error",
            "?x :required true . ?x :requires ?f . ?f :status 'configuration error'",
        ),
        (
            "implicit configuration error",
            "?x :required true . ?x :requires ?f . ?f :status '{status}'",
        ),
        (
            "unsolved",
            "?x :required true . ?x :requires ?f . ?f :status ?s . FILTER(?s != 'solved')",
        ),
        ("solved", "?x :required true"),
        ("feasible", ""),
    ),
}
RELATIONS = ("compares", "constrains", "configures", "uses", "realises", "requires")
DATA = (
    "operator",
    "threshold",
    "measured",
    "failed",
    "active",
    "requested",
    "selected",
    "required",
    "status",
)
KIND_OF = {
    "failed": "component",
    "active": "component",
    "requested": "action",
    "measured": "attribute",
}


def queries() -> Iterator[str]:
    """Yield what computes every status from the facts, in order."""
    for derived in ("status", "required"):
        yield f"DELETE {{ ?x :{derived} ?y }} WHERE {{ ?x :{derived} ?y }}"
    for pattern in REQUIRED:
        yield f"INSERT {{ ?x :required true }} WHERE {{ {pattern} }}"
    for kind, lines in TABLES.items():
        for status, pattern in lines:
            where = f"?x a :{kind} . FILTER NOT EXISTS {{ ?x :status ?any }} {pattern.replace('{status}', status)}"
            yield f"INSERT {{ ?x :status '{status}' }} WHERE {{ {where} }}"


class Ontology:
    """A model as individuals of a world in memory, related by properties."""

    def __init__(self, model: Model) -> None:
        import types

        from owlready2 import DataProperty, FunctionalProperty, ObjectProperty, Thing, World

        self.model = model
        self.world = World()
        self.ontology = self.world.get_ontology("http://robot/#")
        self.keys = [*keys(model), *(("attribute", name) for name in model.attributes)]
        with self.ontology:
            for name in RELATIONS:
                types.new_class(name, (ObjectProperty,))
            for name in DATA:
                types.new_class(name, (DataProperty, FunctionalProperty))
            kinds = {kind: types.new_class(kind, (Thing,)) for kind in dict(self.keys)}
            self.individuals = {
                key: kinds[key[0]](f"n{number}") for number, key in enumerate(self.keys)
            }
        self._relate()

    def _relate(self) -> None:
        model, one = self.model, self.individuals
        kinds = {"Action": "action", "FunctionDesign": "design", "Component": "component"}
        for action in model.actions.values():
            one["action", action.name].requires = [
                one["function", name] for name in action.functions
            ]
        for design in model.designs.values():
            this = one["design", design.name]
            this.realises = [one["function", design.function]]
            this.uses = [one["component", name] for name in design.components]
        for name, configuration in model.configurations.items():
            one["configuration", name].configures = [one["component", configuration.component]]
        for number, constraint in enumerate(model.constraints):
            this = one["constraint", number]
            this.compares = [one["attribute", constraint.attribute]]
            this.operator, this.threshold = constraint.operator, constraint.value
            this.constrains = [
                one[kinds.get(type(element).__name__, "configuration"), element.name]
                for element in constraint.constrained
            ]

    def individual(self, happening: Happening) -> Any:
        what, name, _ = happening
        kind = KIND_OF.get(what) or ("design" if name in self.model.designs else "configuration")
        return self.individuals[kind, name]


class SparqlPeer(Ontology):
    """Facts are properties of individuals; the queries are prepared once and run after each event."""

    def __init__(self, model: Model, told: Iterable[Happening]) -> None:
        super().__init__(model)
        for happening in told:
            self.note(happening)
        self.queries = [self.world.prepare_sparql(PREFIX + text) for text in queries()]

    def note(self, happening: Happening) -> None:
        setattr(
            self.individual(happening),
            happening.what,
            None if happening.value is False else happening.value,
        )

    def tell(self, happening: Happening) -> None:
        self.note(happening)
        with self.ontology:
            for query in self.queries:
                query.execute()

    def statuses(self) -> Mapping[Key, str]:
        rows = list(self.world.sparql(PREFIX + "SELECT ?x ?s { ?x :status ?s }"))
        found = {self.keys[int(individual.name[1:])]: status for individual, status in rows}
        assert len(found) == len(rows)
        return found
