"""Which ROSA action a PDDL action does: found from conventions, or told."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, Domain, Schema, UpThing
from rosa_pddl.exceptions import UnknownNameError, nearest

__all__ = ["rosa_action_of", "with_told"]


def rosa_action_of(
    name: str, conditions: Iterable[UpThing], parameters: Iterable[UpThing], outside: Mapping[str, str]
) -> str | None:
    """Return the parameter (without its mark) or the constant that is the ROSA action; None if there is none.

    Args:
        name: of the PDDL action.
        conditions: of it, as unified-planning expressions.
        parameters: of it, as unified-planning has them.
        outside: the files' spelling by unified-planning's names.
    """
    said = {outside[one.fluent().name].lower(): one for one in conditions if one.is_fluent_exp() and len(one.args) == 1}
    for predicate in (f"{name.lower()}_action", FEASIBLE):
        if predicate in said:
            argument = said[predicate].arg(0)
            return str(argument.parameter().name) if argument.is_parameter_exp() else outside[argument.object().name]
    actions = [
        one.name for one in parameters if one.type.is_user_type() and outside[one.type.name].lower() == ACTION_TYPE
    ]
    return actions[0] if len(actions) == 1 else None


def with_told(domain: Domain, actions: Mapping[str, str]) -> Domain:
    """Return a domain whose PDDL actions do the ROSA actions that are told, and need them to be feasible.

    Raises:
        UnknownNameError: there is no such PDDL action or parameter.
    """
    for name, told in actions.items():
        if name not in domain.schema_of:
            raise UnknownNameError(f"{domain.file} has no PDDL action {name!r}; {nearest(name, domain.schema_of)}")
        parameters = [f"?{parameter}" for parameter, _ in domain.schema_of[name].parameters]
        if told.startswith("?") and told not in parameters:
            raise UnknownNameError(f"the PDDL action {name!r} has no parameter {told!r}; {nearest(told, parameters)}")
        domain = _Told(domain).made(name, told)
    return domain


class _Told:
    """Adds to a domain, which stays as it is."""

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._problem = domain.up_problem.clone()
        self._inside, self._outside = dict(domain.inside), dict(domain.outside)
        self._types = dict(domain.types)

    def made(self, name: str, told: str) -> Domain:
        domain = self._domain
        action = self._problem.action(domain.inside["action", name.lower()])
        rosa_action = told.removeprefix("?")
        argument = action.parameter(rosa_action) if told.startswith("?") else self._object(rosa_action)
        schema = replace(domain.schema_of[name], action=rosa_action)
        condition = self._feasible()(argument)
        if not any(self._is_feasibility(one) for one in schema.start + schema.over_all + schema.end):
            schema = self._guarded(schema, action, condition)
        rosa_actions = tuple(thing for thing, lineage in self._types.items() if ACTION_TYPE in lineage)
        return replace(
            domain,
            rosa_actions=rosa_actions,
            up_problem=self._problem,
            schema_of={**domain.schema_of, name: schema},
            inside=self._inside,
            outside=self._outside,
            types=self._types,
            places={("object", one): (domain.file, 1) for one in rosa_actions} | dict(domain.places),
            _atoms={},
        )

    def _is_feasibility(self, condition: UpThing) -> bool:
        return condition.is_fluent_exp() and self._outside[condition.fluent().name].lower() == FEASIBLE

    def _guarded(self, schema: Schema, action: UpThing, condition: UpThing) -> Schema:
        from unified_planning.model import EndTiming, OpenTimeInterval, StartTiming

        if hasattr(action, "add_precondition"):
            action.add_precondition(condition)
            return replace(schema, start=(*schema.start, condition))
        action.add_condition(OpenTimeInterval(StartTiming(), EndTiming()), condition)
        return replace(schema, over_all=(*schema.over_all, condition))

    def _object(self, name: str) -> UpThing:
        known = self._inside.get(("object", name.lower()))
        if known is None:
            known = self._unique(name.lower())
            self._problem.add_object(known, self._type())
            self._inside["object", name.lower()], self._outside[known] = known, name
            self._types[name] = (ACTION_TYPE,)
        elif ACTION_TYPE not in self._types[self._outside[known]]:
            raise UnknownNameError(f"the object {name!r} of {self._domain.file} is not of type {ACTION_TYPE!r}")
        return self._problem.environment.expression_manager.ObjectExp(self._problem.object(known))

    def _type(self) -> UpThing:
        for user_type in self._problem.user_types:
            if self._outside[user_type.name].lower() == ACTION_TYPE:
                return user_type
        known = self._unique(ACTION_TYPE)
        self._outside[known] = ACTION_TYPE
        self._inside["type", ACTION_TYPE] = known
        return self._problem.environment.type_manager.UserType(known)

    def _feasible(self) -> UpThing:
        key = ("predicate", FEASIBLE)
        if key not in self._inside:
            known = self._unique(FEASIBLE)
            self._inside[key], self._outside[known] = known, FEASIBLE
            environment = self._problem.environment
            from unified_planning.model import Fluent

            signature = {"a": self._type()}
            fluent = Fluent(known, environment.type_manager.BoolType(), environment=environment, **signature)
            self._problem.add_fluent(fluent, default_initial_value=False)
        return self._problem.fluent(self._inside[key])

    def _unique(self, name: str) -> str:
        while name in self._outside:
            name += "_"
        return name
