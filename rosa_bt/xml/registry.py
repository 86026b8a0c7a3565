"""Registers behaviours under the names that files use, and makes them, with arguments and ports from attributes."""

import inspect
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, Literal, TypeVar, get_type_hints, overload

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import ActionBehaviour, HasStatus, IsActionFeasible, Measurement
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction, Retry, UntilSuccess
from rosa_bt.exceptions import RegistryError
from rosa_bt.xml.blackboard import Blackboard, Declared, PortError, Ports, key_of, ports_of
from rosa_bt.xml.controls import NODES
from rosa_bt.xml.nodes import MAX_NODES, Branch

_log = logging.getLogger(__name__)
Factory = Callable[..., Behaviour]
F = TypeVar("F", bound=Factory)
Kind = Literal["action", "condition"]

_FORMS: Final = ("Action", "BehaviorTree", "Condition", "Control", "Decorator", "SubTree", "root")
_OF_NAV2: Final = frozenset(
    (
        "RecoveryNode",
        "PipelineSequence",
        "RoundRobin",
        "RateController",
        "SingleTrigger",
        "GoalUpdatedController",
        "NonblockingSequence",
        "PersistentSequence",
        "PauseResumeController",
    )
)
BUILT_IN: Final = frozenset({*NODES, *_FORMS}) - _OF_NAV2
"""Names that cannot be registered; those of Nav2 can, since its releases differ."""
_ROLES: Final = frozenset({"name", "child", "children", "blackboard", "behaviour_class_name"})
"""Parameters that no attribute of an element sets."""
_VARIOUS: Final = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@dataclass(frozen=True)
class Entry:
    """The behaviour that is registered under a name."""

    factory: Factory
    kind: Kind | None
    bound: Mapping[str, Any]
    """Arguments for every factory that has a parameter of the same name."""

    def children(self) -> tuple[int, int]:
        """Return the least and the greatest number of children that it takes."""
        least = int("child" in self._parameters)
        return (1, MAX_NODES) if "children" in self._parameters else (least, least)

    def make(
        self,
        name: str,
        written: Mapping[str, str],
        branches: Sequence[Branch],
        board: Blackboard,
        note: Callable[[str], object] = _log.warning,
    ) -> Behaviour:
        """Make the behaviour; raise PortError if an attribute is unknown, missing, or of a wrong type."""
        arguments = self.arguments
        ports_of_class = ports_of(self.made)[0]
        mine: dict[str, str] = {}
        later: dict[str, str] = {}
        for key, text in written.items():
            if key in arguments:
                is_key = key_of(text, key) is not None
                is_later = is_key and not arguments[key].required
                (later if is_later else mine)[key] = text
        values = _values(arguments, mine, board)
        behaviour = self.factory(**self._offered(name, branches, board), **values)
        known, outputs = ports_of(behaviour)
        rest = {key: text for key, text in written.items() if key not in arguments or key in known}
        ports = Ports({**arguments, **known}, rest, board)  # raises if one is no port
        for key, name_on_board in ports.keys.items():
            entry = board.entry(name_on_board)
            if entry is not None and known[key].data_type in (Any, object):
                entry.takes_any = True
        attributes = vars(behaviour)
        read_at_start = {}
        for key, text in later.items():
            if key in attributes:
                read_at_start[key] = text
            elif key not in ports_of_class:
                kind = type(behaviour).__name__
                note(
                    f"{key}={text!r} is not read: {kind} keeps no attribute {key!r}; declare a port"
                )
        if read_at_start:
            _read_at_start(behaviour, Ports(arguments, read_at_start, board))
        if isinstance(behaviour, PortsMixin):
            ports.check_required(frozenset(outputs) | mine.keys())
            ports.connect(behaviour)
        if isinstance(behaviour, ActionBehaviour):
            _check_action(behaviour, rest, ports)
        return behaviour

    @cached_property
    def _maker(self) -> Factory:
        maker = self.factory
        while isinstance(maker, partial):
            maker = maker.func
        return maker

    @property
    def made(self) -> type[Behaviour] | None:
        """The class of the behaviour that it makes; None if the factory is a function."""
        return self._maker if isinstance(self._maker, type) else None

    @cached_property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(self.factory).parameters

    @cached_property
    def arguments(self) -> Declared:
        """The parameters that attributes can set, as ports; one with the name of a port has the type of that port."""
        maker = self._maker
        try:
            hints = get_type_hints(getattr(maker, "__init__") if isinstance(maker, type) else maker)  # noqa: B009  # of that class
        except (NameError, TypeError):
            hints = {}
        hints |= {name: port.data_type for name, port in ports_of(self.made)[0].items()}
        taken = {*self.bound, *_ROLES}
        return {
            name: PortInformation(hints.get(name, object), required=one.default is one.empty)
            for name, one in self._parameters.items()
            if one.kind not in _VARIOUS and name not in taken
        }

    def _offered(self, name: str, branches: Sequence[Branch], board: Blackboard) -> dict[str, Any]:
        offered: dict[str, Any] = {
            **self.bound,
            "name": name,
            "children": list(branches),
            "blackboard": board,
        }
        if branches:
            offered["child"] = branches[0]
        takes_name = any(one.kind is one.VAR_KEYWORD for one in self._parameters.values())
        known = {*self._parameters, "name"} if takes_name else self._parameters
        return {key: value for key, value in offered.items() if key in known}


def _values(declared: Declared, mine: Mapping[str, str], board: Blackboard) -> dict[str, Any]:
    """Return the arguments of the constructor from attributes."""
    for name, port in declared.items():
        if port.required and name not in mine:
            raise PortError(
                f"{name!r} is missing; write {name}=... in the element, or hand it to BehaviourRegistry"
            )
        if name in mine and (pointed := key_of(mine[name], name)) is not None:
            raise PortError(
                f"{name!r} is needed when the tree is made, but {{{pointed}}} is known when it is ticked; declare it "
                "in INPUT_PORTS (py_trees.ports), and let the constructor do without it"
            )
    ports = Ports(declared, mine, board)
    return {name: ports.get(name) for name in mine}


def _read_at_start(behaviour: Behaviour, ports: Ports) -> None:
    """Let a behaviour read its attributes that are keys, each time before `initialise` is called."""
    initialise = behaviour.initialise

    def read_and_initialise() -> None:
        values = {name: ports.get(name) for name in ports.keys if ports.exists(name)}
        vars(behaviour).update(values)
        initialise()

    vars(behaviour)["initialise"] = read_and_initialise


def _check_action(leaf: ActionBehaviour, rest: Mapping[str, str], ports: Ports) -> None:
    """Raise now, not during a mission, if the action is missing, given twice, or not in the model."""
    said = leaf.named_action
    if said is not None and rest.get("action", said) != said:
        raise PortError(
            f"the constructor says already that 'action' is {said!r}, so {rest['action']!r} would never be read; "
            "leave action=... out, or let the constructor do without it"
        )
    if said is None and "action" not in rest:
        raise PortError("'action' is missing; write action=... in the element")
    if said is None and "action" in ports.literals:
        leaf.kb.is_feasible(ports.get("action"))


def _do_until_unfeasible(
    name: str, children: Sequence[Branch], *, memory: bool = False
) -> DoUntilUnfeasible:
    if len(children) != 2:
        raise RegistryError(
            f"it has {len(children)} children; it takes 2: the task, and what is done meanwhile"
        )
    return DoUntilUnfeasible(name, *children, memory=memory)


def _safe_switch(
    name: str, children: Sequence[Branch], action: str, after: list[str], blackboard: Blackboard
) -> SafeSwitch:
    *steps, task = children
    if len(steps) != len(after):
        raise RegistryError(
            f"it has {len(children)} children; it takes one for each action in `after`, and the task"
        )
    return SafeSwitch(
        name, task, dict(zip(after, steps, strict=True)), blackboard, action, "@last_action"
    )


_ALWAYS: Final[Mapping[str, Factory]] = {"Retry": Retry, "UntilSuccess": UntilSuccess}
_OURS: Final[Mapping[str, Factory]] = {
    **_ALWAYS,
    "HasStatus": HasStatus,
    "IsActionFeasible": IsActionFeasible,
    "Measurement": Measurement,
    "ForAction": ForAction,
    "DoUntilUnfeasible": _do_until_unfeasible,
    "SafeSwitch": _safe_switch,
}
"""What is registered from the start, with a knowledge base or without."""


class BehaviourRegistry:
    """The behaviours that files of trees can use, by name.

    Args:
        bound: arguments for every factory that has a parameter of the same name, e.g. `kb=kb`. Retry
            and UntilSuccess are registered from the start; with a `kb` also IsActionFeasible,
            HasStatus, Measurement, ForAction, DoUntilUnfeasible and SafeSwitch.

    Attributes:
        entries: the registered behaviours, by name.

    Example::

        registry = BehaviourRegistry(kb=kb)

        @registry.register("search")
        class Search(RosaAction): ...
    """

    def __init__(self, **bound: Any) -> None:  # noqa: ANN401  # whatever the behaviours of the user need
        self.bound: Final = dict(bound)
        own = _OURS if "kb" in bound else _ALWAYS
        self.entries: Final = {
            name: Entry(factory, None, self.bound) for name, factory in own.items()
        }

    @overload
    def register(self, name: F) -> F: ...

    @overload
    def register(self, name: str, *, kind: Kind | None = None) -> Callable[[F], F]: ...

    @overload
    def register(self, name: str, factory: F, *, kind: Kind | None = None) -> F: ...

    def register(
        self, name: str | Factory, factory: Factory | None = None, *, kind: Kind | None = None
    ) -> object:
        """Register a class of behaviours, or a function that makes a behaviour; also a decorator.

        The parameters `name`, `child` and `children` are set from the file, `blackboard` to that of the tree. Every
        other parameter, and every port of py_trees, is an attribute, converted to its declared type.

        Args:
            name: the tag or ID in the file; a bare `@registry.register` takes the name of the class or function.
            factory: the class or function, which is returned as it is; without it, a decorator is returned.
            kind: "condition" for a leaf that is ticked again after it has finished, even if it was not reset; "action"
                for a leaf that is not. Without it, the file decides (`<Condition ID=...>` or its TreeNodesModel), or
                else the class: without `initialise` and `terminate` of its own, it makes conditions.

        Raises:
            RegistryError: the name is taken, or an argument is of a wrong kind.
        """
        if callable(name):
            return self.register(name.__name__, name)
        if factory is None:
            return lambda given: self.register(name, given, kind=kind)
        if name in BUILT_IN:
            raise RegistryError(
                f"{name!r} is a node of BehaviorTree.CPP itself; choose another name"
            )
        if name in self.entries and self.entries[name].factory is not _OURS.get(name):
            raise RegistryError(
                f"{name!r} is registered already; choose another name, or make another registry"
            )
        if not callable(factory):
            raise RegistryError(
                f"{name!r} is a class of behaviours or a function that makes one, not {factory!r}"
            )
        if kind not in (None, "action", "condition"):
            raise RegistryError(f"a leaf is an 'action' or a 'condition', not {kind!r}")
        self.entries[name] = Entry(factory, kind, self.bound)
        return factory

    def name_of(self, behaviour: Behaviour) -> str | None:
        """Return the name under which the class is registered, or the behaviour's own if a function has that name."""
        for name, entry in self.entries.items():
            if entry.factory is type(behaviour):
                return name
        own = self.entries.get(behaviour.name)
        return behaviour.name if own is not None and not isinstance(own.factory, type) else None
