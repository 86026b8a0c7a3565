"""Making the behaviours of the user: arguments and ports from attributes, each as the type that is declared."""

from collections.abc import Mapping
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.parsers.blackboard import Blackboard
from rosa_bt.parsers.nodes import Branch
from rosa_bt.parsers.ports import Declared, Port, PortError, Ports, wire
from rosa_bt.parsers.registry import Entry

__all__ = ["make_registered"]

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
    declared = {key: port for key, port in entry.arguments().items() if key not in ports}
    if entry.takes_any:
        declared = {**dict.fromkeys(written, _FREE), **declared}
    mine = {key: text for key, text in written.items() if key in declared}
    rest = {key: text for key, text in written.items() if key not in declared}
    behaviour = entry.make(name, _arguments(declared, mine, board), branches)
    if isinstance(behaviour, PortsMixin):
        _connect(behaviour, rest, mine, board)
    elif rest:
        Ports(declared, rest, board)  # says which ports there are
    return behaviour


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
            "parameter as Port, or declare it in INPUT_PORTS (py_trees.ports)"
        )
    return ports.get(name)


def _connect(behaviour: PortsMixin, rest: Mapping[str, str], mine: Mapping[str, str], board: Blackboard) -> None:
    ports = Ports({**behaviour.input_ports(), **behaviour.output_ports()}, rest, board)
    ports.check_required(frozenset(behaviour.output_ports()) | mine.keys())
    wire(behaviour, ports)
    if isinstance(behaviour, ActionBehaviour) and ports.key("action") is None:
        behaviour.kb.is_feasible(behaviour.action)  # an unknown action is found here, not in the middle of a mission
