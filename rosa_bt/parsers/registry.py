"""Which behaviour stands behind which name in a file."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, TypeVar, get_type_hints, overload

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import HasStatus, IsActionFeasible, Measurement, WaitForArchitecture
from rosa_bt.parsers.controls import CONTROLS
from rosa_bt.parsers.exceptions import RegistryError
from rosa_bt.parsers.leaves import LEAVES
from rosa_bt.parsers.nodes import Branch
from rosa_bt.parsers.ports import Declared
from rosa_bt.parsers.wrappers import DECORATORS

__all__ = ["BUILT_IN", "BehaviourRegistry", "Entry", "Kind"]

Factory = Callable[..., Behaviour]
F = TypeVar("F", bound=Factory)
Kind = Literal["action", "condition"]

_FORMS: Final = ("Action", "BehaviorTree", "Condition", "Control", "Decorator", "SubTree", "root")
BUILT_IN: Final = frozenset({*CONTROLS, *DECORATORS, *LEAVES, *_FORMS})
"""Names that have their meaning already."""
_OUR_LEAVES: Final = (HasStatus, IsActionFeasible, Measurement, WaitForArchitecture)
_ROLES: Final = frozenset({"name", "child", "children", "behaviour_class_name"})
"""Parameters that no attribute is meant for."""
_VARIOUS: Final = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@dataclass(frozen=True)
class Entry:
    """What is registered under a name.

    Attributes:
        factory: makes the behaviour.
        kind: what was said of it; None for nothing.
        bound: arguments that every factory is given that has a parameter of that name.
    """

    factory: Factory
    kind: Kind | None
    bound: Mapping[str, Any]

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        """Return the parameters of the factory."""
        return inspect.signature(self.factory).parameters

    @property
    def class_ports(self) -> Declared | None:
        """Return the ports that py_trees knows of, if the factory is a class that declares them."""
        maker = _maker(self.factory)
        if isinstance(maker, type) and issubclass(maker, PortsMixin):
            return {**maker.input_ports(), **maker.output_ports()}
        return None

    @property
    def takes_any(self) -> bool:
        """Whether the factory takes whatever is written, in `**ports`; those of a class with ports are not for that."""
        return self.class_ports is None and any(one.kind is one.VAR_KEYWORD for one in self.parameters.values())

    @property
    def name_parameter(self) -> str:
        """Return the parameter that takes the name: `name`, or else the first one that a function needs."""
        if "name" in self.parameters or isinstance(_maker(self.factory), type):
            return "name"
        needed = [one.name for one in self.parameters.values() if one.default is one.empty and one.kind not in _VARIOUS]
        return next((name for name in needed if name not in self.bound and name not in _ROLES), "name")

    def arguments(self) -> Declared:
        """Return the parameters that can be written as attributes, as ports."""
        maker = _maker(self.factory)
        try:
            hints = get_type_hints(getattr(maker, "__init__") if isinstance(maker, type) else maker)  # noqa: B009  # of the class that it is
        except (NameError, TypeError):
            hints = {}
        taken = {*self.bound, *_ROLES, self.name_parameter}
        return {
            name: _port(one, hints.get(name, object))
            for name, one in self.parameters.items()
            if one.kind not in _VARIOUS and name not in taken
        }

    def make(self, name: str, arguments: Mapping[str, Any], branches: list[Branch]) -> Behaviour:
        """Make the behaviour."""
        offered: dict[str, Any] = {**self.bound, self.name_parameter: name, "children": branches}
        if branches:
            offered["child"] = branches[0]
        takes_more = any(one.kind is one.VAR_KEYWORD for one in self.parameters.values())
        given = {
            key: value for key, value in offered.items() if key in self.parameters or (key == "name" and takes_more)
        }
        return self.factory(**given, **arguments)

    def children(self) -> tuple[int, int]:
        """Return how many children it takes, at least and at most."""
        if "children" in self.parameters:
            return 1, 10_000
        return (1, 1) if "child" in self.parameters else (0, 0)


def _maker(factory: Factory) -> Factory:
    """Return the class or function that a partial one calls."""
    return _maker(factory.func) if isinstance(factory, partial) else factory


def _port(parameter: inspect.Parameter, hint: object) -> PortInformation:
    is_free = parameter.default is not inspect.Parameter.empty
    return PortInformation(hint, required=not is_free)


class BehaviourRegistry:
    """Behaviours by the names that files call them.

    Args:
        bound: arguments for every factory that has a parameter of that name, e.g. `kb=kb`. With a `kb`,
            IsActionFeasible, HasStatus, Measurement and WaitForArchitecture are there already, and the clock of the
            knowledge base is that of the trees.

    Example:
        ```
        registry = BehaviourRegistry(kb=kb)

        @registry.register("search")
        class Search(RosaAction): ...
        ```
    """

    def __init__(self, **bound: Any) -> None:  # noqa: ANN401  # whatever the user's behaviours need
        self.bound: Final = dict(bound)
        own = _OUR_LEAVES if "kb" in bound else ()
        self._entries = {leaf.__name__: Entry(leaf, None, self.bound) for leaf in own}
        self._given: set[str] = set()

    @overload
    def register(self, name: F) -> F: ...

    @overload
    def register(self, name: str, *, kind: Kind | None = None) -> Callable[[F], F]: ...

    @overload
    def register(self, name: str, factory: F, *, kind: Kind | None = None) -> F: ...

    def register(self, name: str | Factory, factory: Factory | None = None, *, kind: Kind | None = None) -> object:
        """Register a class of behaviours, or a function that makes one; also as a decorator.

        Parameters that are called `name`, `child` and `children` get what the file says; every other parameter, and
        every port that py_trees knows of, is an attribute, read as the type it declares.

        Args:
            name: the tag or ID in the file; a bare `@registry.register` takes the name of the class or function.
            factory: the class or function; without one, a decorator is returned.
            kind: "condition" for a leaf that is to be asked again when it has finished and was not reset, "action" for
                one that is not. Without it, what the file says (`<Condition ID=...>` or its TreeNodesModel), and else:
                a class that overrides neither `initialise` nor `terminate` makes conditions.

        Returns:
            The factory, unchanged.

        Raises:
            RegistryError: the name is taken.
        """
        if callable(name):
            return self.register(name.__name__, name)
        if factory is None:
            return lambda given: self.register(name, given, kind=kind)
        if name in BUILT_IN:
            raise RegistryError(f"{name!r} is a node of BehaviorTree.CPP itself; choose another name")
        if name in self._given:
            raise RegistryError(f"{name!r} is registered already; choose another name, or make another registry")
        if not callable(factory):
            raise RegistryError(f"{name!r} is a class of behaviours or a function that makes one, not {factory!r}")
        if kind not in (None, "action", "condition"):
            raise RegistryError(f"a leaf is an 'action' or a 'condition', not {kind!r}")
        self._given.add(name)
        self._entries[name] = Entry(factory, kind, self.bound)
        return factory

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __getitem__(self, name: str) -> Entry:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def name_of(self, behaviour: Behaviour) -> str | None:
        """Return the name under which the class of a behaviour is registered, or its own if a function has that."""
        for name, entry in self._entries.items():
            if entry.factory is type(behaviour):
                return name
        own = self._entries.get(behaviour.name)
        return behaviour.name if own is not None and not isinstance(own.factory, type) else None
