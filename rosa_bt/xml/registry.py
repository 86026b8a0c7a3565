"""Registers behaviours under the names that files use."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any, Literal, TypeVar, overload

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation

from rosa_bt.behaviours import HasStatus, IsActionFeasible, Measurement
from rosa_bt.composites import DoUntilUnfeasible
from rosa_bt.decorators import ForAction, Retry, UntilSuccess
from rosa_bt.exceptions import RegistryError
from rosa_bt.xml.blackboard import Declared

Factory = Callable[..., Behaviour]
F = TypeVar("F", bound=Factory)
Kind = Literal["action", "condition"]

_ROLES = frozenset({"name", "child", "children", "blackboard", "behaviour_class_name"})
"""Parameters that no attribute of an element sets."""
_VARIOUS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_DEFAULTS: Mapping[str, Factory] = {
    kind.__name__: kind
    for kind in (
        *(HasStatus, IsActionFeasible, Measurement),
        *(DoUntilUnfeasible, ForAction, Retry, UntilSuccess),
    )
}


@dataclass(frozen=True)
class Registration:
    """A behaviour that is registered under a name."""

    factory: Factory
    kind: Kind | None
    bound: Mapping[str, Any]
    """Arguments for every factory that has a parameter of the same name."""

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        try:
            return inspect.signature(self.factory, eval_str=True).parameters
        except (NameError, TypeError):  # an annotation is known to type checkers only
            return inspect.signature(self.factory).parameters

    @property
    def child_parameters(self) -> list[str]:
        """The parameters that take one child each, in the order of the children."""
        parameters = self.parameters.items()
        return [
            name
            for name, parameter in parameters
            if name == "child" or parameter.annotation is Behaviour
        ]

    @property
    def children(self) -> tuple[float, float]:
        """The least and the greatest number of children that it takes."""
        count = len(self.child_parameters)
        return (1, inf) if "children" in self.parameters else (count, count)

    @property
    def arguments(self) -> Declared:
        """The parameters that attributes can set, as ports."""
        roles = {*self.bound, *_ROLES, *self.child_parameters}
        arguments = {}
        for name, parameter in self.parameters.items():
            if parameter.kind not in _VARIOUS and name not in roles:
                is_required = parameter.default is parameter.empty
                has_type = parameter.annotation is not parameter.empty
                data_type = parameter.annotation if has_type else object
                arguments[name] = PortInformation(data_type, is_required)
        return arguments

    def make(self, offered: Mapping[str, Any], arguments: Mapping[str, Any]) -> Behaviour:
        """Make the behaviour of its arguments, and of what is offered and has a parameter."""
        parameters = set(self.parameters)
        if any(parameter.kind == _VARIOUS[1] for parameter in self.parameters.values()):
            parameters.add("name")
        offered = {**self.bound, **offered}
        taken = {key: offered[key] for key in offered.keys() & parameters}
        return self.factory(**taken, **arguments)


class BehaviourRegistry:
    """The behaviours that files of trees can use, by name.

    Args:
        bound: arguments for every factory that has a parameter of the same name, e.g. `kb=kb`.
            IsActionFeasible, HasStatus, Measurement, ForAction, DoUntilUnfeasible, Retry and
            UntilSuccess are registered from the start; all but the last two need a `kb`.

    Attributes:
        entries: the registered behaviours, by name.

    Example::

        registry = BehaviourRegistry(kb=kb)

        @registry.register("search")
        class Search(RosaAction): ...
    """

    def __init__(self, **bound: Any) -> None:  # noqa: ANN401  # whatever the behaviours of the user need
        self.bound = bound
        self.entries = {name: Registration(make, None, bound) for name, make in _DEFAULTS.items()}

    @overload
    def register(self, name: str, *, kind: Kind | None = None) -> Callable[[F], F]: ...

    @overload
    def register(self, name: str, factory: F, *, kind: Kind | None = None) -> F: ...

    def register(
        self, name: str, factory: Factory | None = None, *, kind: Kind | None = None
    ) -> object:
        """Register a class of behaviours, or a function that makes a behaviour; also a decorator.

        The parameters `name`, `child` and `children` are set from the file, `blackboard` to that of
        the tree; those that are annotated as Behaviour take one child each. Every other parameter,
        and every port of py_trees, is an attribute, converted to its declared type.

        Args:
            name: the tag or ID in the file; a node of that name is replaced.
            factory: the class or function, which is returned as it is; without it, a decorator is
                returned.
            kind: "condition" for a leaf that is ticked again after it has finished, even if it was
                not reset; "action" for a leaf that is not. Without it, the file decides, or else
                the class: without `initialise` and `terminate` of its own, it makes conditions.

        Raises:
            RegistryError: the name is taken.
        """
        if factory is None:
            return lambda factory: self.register(name, factory, kind=kind)
        if name in self.entries and self.entries[name].factory is not _DEFAULTS.get(name):
            raise RegistryError(f"{name!r} is registered already; choose another name")
        self.entries[name] = Registration(factory, kind, self.bound)
        return factory

    def name_of(self, behaviour: Behaviour) -> str | None:
        """Return the name of its class, or its own if a function is registered under that."""
        for name, entry in self.entries.items():
            is_its = name == behaviour.name and not isinstance(entry.factory, type)
            if is_its or entry.factory is type(behaviour):
                return name
        return None
