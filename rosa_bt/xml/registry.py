"""Registers behaviours under the names that files use, and makes them of attributes."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeVar, overload

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import ActionBehaviour, HasStatus, IsActionFeasible, Measurement
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction, Retry, UntilSuccess
from rosa_bt.exceptions import RegistryError
from rosa_bt.xml.blackboard import Blackboard, Declared, PortError, Ports, key_of, ports_of
from rosa_bt.xml.nodes import MAX_NODES, NODES, Branch

Factory = Callable[..., Behaviour]
F = TypeVar("F", bound=Factory)
Kind = Literal["action", "condition"]

_FORMS = ("Action", "BehaviorTree", "Condition", "Control", "Decorator", "SubTree", "root")
_OF_NAV2 = frozenset(
    [
        "GoalUpdatedController",
        "NonblockingSequence",
        "PauseResumeController",
        "PersistentSequence",
        "PipelineSequence",
        "RateController",
        "RecoveryNode",
        "RoundRobin",
        "SingleTrigger",
    ]
)
BUILT_IN = frozenset({*NODES, *_FORMS}) - _OF_NAV2
"""Names that cannot be registered; those of Nav2 can, since its releases differ."""
_ROLES = frozenset({"name", "child", "children", "blackboard", "behaviour_class_name"})
"""Parameters that no attribute of an element sets."""
_VARIOUS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@dataclass(frozen=True)
class Entry:
    """The behaviour that is registered under a name."""

    factory: Factory
    kind: Kind | None
    bound: Mapping[str, Any]
    """Arguments for every factory that has a parameter of the same name."""

    @cached_property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        try:
            return inspect.signature(self.factory, eval_str=True).parameters
        except (NameError, TypeError):  # an annotation is known to type checkers only
            return inspect.signature(self.factory).parameters

    @property
    def children(self) -> tuple[int, int]:
        """The least and the greatest number of children that it takes."""
        least = int("child" in self.parameters)
        return (1, MAX_NODES) if "children" in self.parameters else (least, least)

    @cached_property
    def arguments(self) -> Declared:
        """The parameters that attributes can set, as ports.

        One with the name of a port has the type of that port.
        """
        ports = ports_of(self.factory)[0]
        arguments = {}
        for name, parameter in self.parameters.items():
            if parameter.kind not in _VARIOUS and name not in {*self.bound, *_ROLES}:
                data_type = parameter.annotation
                if name in ports:
                    data_type = ports[name].data_type
                elif data_type is parameter.empty:
                    data_type = object
                arguments[name] = PortInformation(data_type, parameter.default is parameter.empty)
        return arguments

    def make(
        self,
        name: str,
        written: Mapping[str, str],
        branches: Sequence[Branch],
        board: Blackboard,
        note: Callable[[str], object],
    ) -> Behaviour:
        """Make the behaviour; raise if an attribute is unknown, missing, or of a wrong type."""
        literals, keys = self._divided(written)
        offered = {**self.bound, "name": name, "children": list(branches), "blackboard": board}
        if branches:
            offered["child"] = branches[0]
        parameters = set(self.parameters)
        if any(parameter.kind == _VARIOUS[1] for parameter in self.parameters.values()):
            parameters.add("name")
        arguments = {key: offered[key] for key in offered.keys() & parameters}
        constants = Ports(self.arguments, literals, board)
        behaviour = self.factory(**arguments, **{key: constants.get(key) for key in literals})
        declared, outputs = ports_of(behaviour)
        others = {
            key: text
            for key, text in written.items()
            if key in declared or key not in self.arguments
        }
        ports = Ports({**self.arguments, **declared}, others, board)
        for port, key in ports.keys.items():
            if declared[port].data_type in (Any, object):
                board.make(key).takes_any = True
        attributes = vars(behaviour)
        for key, text in keys.items():
            if key not in declared and key not in attributes:
                problem = f"{type(behaviour).__name__} keeps no attribute {key!r}; declare a port"
                note(f"{key}={text!r} is not read: {problem}")
        at_start = {key: text for key, text in keys.items() if key in attributes}
        if at_start:
            _read_at_start(behaviour, Ports(self.arguments, at_start, board))
        if isinstance(behaviour, ActionBehaviour):
            _check_action(behaviour, ports)
        if isinstance(behaviour, PortsMixin):
            ports.check_required({*outputs, *literals})
            ports.connect(behaviour)
        return behaviour

    def _divided(self, written: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
        """Return the attributes that are arguments, with a literal and with a key."""
        literals = dict[str, str]()
        keys = dict[str, str]()
        for name, argument in self.arguments.items():
            text = written.get(name)
            is_literal = text is not None and key_of(text, name) is None
            if argument.required and not is_literal:
                advice = f"write {name}=... with a value, hand it to BehaviourRegistry"
                problem = f"{name!r} is needed when the tree is made"
                raise PortError(f"{problem}; {advice}, or declare a port in INPUT_PORTS")
            if text is not None:
                (literals if is_literal else keys)[name] = text
        return literals, keys


def _read_at_start(behaviour: Behaviour, ports: Ports) -> None:
    """Let a behaviour read its attributes that are keys before each `initialise`."""
    initialise = behaviour.initialise

    def read_and_initialise() -> None:
        for name in ports.keys:
            if ports.exists(name):
                vars(behaviour)[name] = ports.get(name)
        initialise()

    vars(behaviour)["initialise"] = read_and_initialise


def _check_action(leaf: ActionBehaviour, ports: Ports) -> None:
    """Raise now if the action is missing, given twice, or not in the model."""
    name = ports.literals.get("action")
    if leaf.named_action is None and "action" not in {*ports.keys, *ports.literals}:
        raise PortError("'action' is missing; write action=... in the element")
    if leaf.named_action not in (None, name or leaf.named_action):
        problem = f"the constructor says already that 'action' is {leaf.named_action!r}"
        raise PortError(f"{problem}, so {name!r} would never be read; leave action=... out")
    if name is not None:
        leaf.kb.is_feasible(name)


def _do_until_unfeasible(
    name: str, children: Sequence[Branch], *, memory: bool = False
) -> DoUntilUnfeasible:
    if len(children) != 2:
        raise RegistryError("it takes 2 children: the task, and what is done meanwhile")
    return DoUntilUnfeasible(name, *children, memory=memory)


def _safe_switch(
    name: str, children: Sequence[Branch], action: str, after: list[str], blackboard: Blackboard
) -> SafeSwitch:
    *steps, task = children
    if len(steps) != len(after):
        raise RegistryError("it takes a child for each action in `after`, and the task")
    transitions = dict(zip(after, steps, strict=True))
    return SafeSwitch(name, task, transitions, blackboard.root, action)


_ALWAYS: Mapping[str, Factory] = {"Retry": Retry, "UntilSuccess": UntilSuccess}
_WITH_KB: Mapping[str, Factory] = {
    **{kind.__name__: kind for kind in (HasStatus, IsActionFeasible, Measurement, ForAction)},
    **{"DoUntilUnfeasible": _do_until_unfeasible, "SafeSwitch": _safe_switch},
}


class BehaviourRegistry:
    """The behaviours that files of trees can use, by name.

    Args:
        bound: arguments for every factory that has a parameter of the same name, e.g. `kb=kb`.
            Retry and UntilSuccess are registered from the start; with a `kb` also IsActionFeasible,
            HasStatus, Measurement, ForAction, DoUntilUnfeasible and SafeSwitch.

    Attributes:
        entries: the registered behaviours, by name.

    Example::

        registry = BehaviourRegistry(kb=kb)

        @registry.register("search")
        class Search(RosaAction): ...
    """

    def __init__(self, **bound: Any) -> None:  # noqa: ANN401  # whatever the behaviours of the user need
        self.bound = bound
        self._own = {**_ALWAYS, **(_WITH_KB if "kb" in bound else {})}
        self.entries = {name: Entry(make, None, bound) for name, make in self._own.items()}

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

        The parameters `name`, `child` and `children` are set from the file, `blackboard` to that of
        the tree. Every other parameter, and every port of py_trees, is an attribute, converted to
        its declared type.

        Args:
            name: the tag or ID in the file; a bare `@registry.register` takes the name of the class
                or function.
            factory: the class or function, which is returned as it is; without it, a decorator is
                returned.
            kind: "condition" for a leaf that is ticked again after it has finished, even if it was
                not reset; "action" for a leaf that is not. Without it, the file decides, or else
                the class: without `initialise` and `terminate` of its own, it makes conditions.

        Raises:
            RegistryError: the name is taken, or an argument is of a wrong kind.
        """
        if callable(name):
            return self.register(name.__name__, name)
        if factory is None:
            return lambda factory: self.register(name, factory, kind=kind)
        problem = ""
        if name in BUILT_IN:
            problem = f"{name!r} is a node of BehaviorTree.CPP itself; choose another name"
        elif name in self.entries and name not in self._own:
            problem = f"{name!r} is registered already; choose another name"
        if problem:
            raise RegistryError(problem)
        self._own.pop(name, None)
        self.entries[name] = Entry(factory, kind, self.bound)
        return factory

    def name_of(self, behaviour: Behaviour) -> str | None:
        """Return the name of its class, or its own if a function is registered under that."""
        for name, entry in self.entries.items():
            if entry.factory is type(behaviour):
                return name
        own = self.entries.get(behaviour.name)
        return behaviour.name if own is not None and not isinstance(own.factory, type) else None
