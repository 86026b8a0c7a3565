"""Making the behaviours of the user: arguments and ports from attributes, each as the type that is declared."""

from collections.abc import Mapping
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import ActionBehaviour, HasStatus, IsActionFeasible, KbBehaviour, Measurement
from rosa_bt.parsers.blackboard import Blackboard, key_of
from rosa_bt.parsers.nodes import Branch
from rosa_bt.parsers.ports import Declared, Port, PortError, Ports, wire
from rosa_bt.parsers.registry import Entry

__all__ = ["make_registered"]

_ASKING: Final[Mapping[type, tuple[type[KbBehaviour], tuple[str, ...]]]] = {
    ActionBehaviour: (IsActionFeasible, ("action",)),
    HasStatus: (HasStatus, ("element", "status")),
    Measurement: (Measurement, ("attribute", "operator", "value")),
}
"""By kind of our leaves: one whose constructor checks what is written, and the ports that the kind needs."""
_FREE = PortInformation(object, required=False)


def make_registered(
    entry: Entry, name: str, written: Mapping[str, str], board: Blackboard, branches: list[Branch]
) -> Behaviour:
    """Make what is registered.

    Args:
        entry: what is registered.
        name: what the behaviour is called.
        written: its attributes.
        board: what it reads and writes.
        branches: its children.

    Raises:
        PortError: an attribute has no meaning for it, is missing, or is of another type.
    """
    ports = entry.class_ports or {}
    declared = {key: _both(port, ports.get(key)) for key, port in entry.arguments().items()}
    if entry.takes_any:
        declared = {**dict.fromkeys(written, _FREE), **declared}
    mine = {key: text for key, text in written.items() if key in declared}
    for key in ports:  # what has a key is read from the port, unless the constructor cannot do without it
        if key in mine and not declared[key].required and key_of(mine[key], key) is not None:
            del mine[key]
    rest = {key: text for key, text in written.items() if key not in declared or key in ports}
    behaviour = entry.make(name, _arguments(declared, mine, board), branches)
    if isinstance(behaviour, PortsMixin):
        _connect(behaviour, rest, declared, mine, board)
    elif rest:
        Ports(declared, rest, board)  # says which ports there are
    return behaviour


def _both(parameter: PortInformation, port: PortInformation | None) -> PortInformation:
    """Return a parameter of the constructor; one that is a port of the class, too, has the type of the port."""
    if port is None or parameter.data_type is Port:
        return parameter
    return PortInformation(port.data_type, required=parameter.required)


def _arguments(declared: Declared, mine: Mapping[str, str], board: Blackboard) -> dict[str, Any]:
    ports = Ports(declared, mine, board)
    for name, port in declared.items():
        if port.required and name not in mine:
            raise PortError(f"{name!r} is missing; write {name}=... in the element, or hand it to BehaviourRegistry")
    return {name: _argument(name, declared[name], ports) for name in mine}


def _argument(name: str, port: PortInformation, ports: Ports) -> Any:  # noqa: ANN401  # of the type that is declared
    key = ports.key(name)
    if port.data_type is Port or (key is not None and port.data_type in (object, Any)):
        return Port(ports, name)
    if key is not None:
        raise PortError(
            f"{name!r} is needed when the tree is made, but {{{key}}} is known when it is ticked; annotate the "
            "parameter as Port, or declare it in INPUT_PORTS (py_trees.ports) and let the constructor do without it"
        )
    return ports.get(name)


def _connect(
    behaviour: PortsMixin, rest: Mapping[str, str], declared: Declared, mine: Mapping[str, str], board: Blackboard
) -> None:
    known = {**behaviour.input_ports(), **behaviour.output_ports()}
    if not rest.keys() <= known.keys():
        Ports({**declared, **known}, rest, board)  # says which there are, those of the constructor, too
    ports = Ports(known, rest, board)
    ports.check_required(frozenset(behaviour.output_ports()) | mine.keys())
    wire(behaviour, ports)
    for kind, (checking, names) in _ASKING.items():
        if isinstance(behaviour, KbBehaviour) and isinstance(behaviour, kind):
            held = {name: getattr(behaviour, f"_{name}") for name in names}
            _check_held({name: value for name, value in held.items() if name not in mine}, rest)
            open_names = [name for name in names if held[name] is None]
            _check_open(checking, behaviour, open_names, rest, ports)


def _check_held(held: Mapping[str, object], rest: Mapping[str, str]) -> None:
    """Raise if something is written that the constructor has decided otherwise without hearing of it."""
    for name, value in held.items():
        said = getattr(value, "name", value)  # a leaf may hold the view of what was named
        if said is not None and rest.get(name, str(said)) != str(said):
            raise PortError(
                f"the constructor says already that {name!r} is {said!r}, so {rest[name]!r} would never be read; "
                f"leave {name}=... out, or let the constructor do without it"
            )


def _check_open(
    checking: type[KbBehaviour], leaf: KbBehaviour, names: list[str], rest: Mapping[str, str], ports: Ports
) -> None:
    """Find here, not in the middle of a mission, what is missing or is nothing that the knowledge base has."""
    for name in names:
        if name not in rest:
            raise PortError(f"{name!r} is missing; write {name}=... in the element")
    checking(leaf.name, leaf.kb, **{name: ports.get(name) for name in names if ports.is_literal(name)})
