"""Ports: what a node is told in its attributes, as a value of the type that it declares, at the time it asks."""

from collections.abc import Mapping
from typing import Any, Final, get_origin

from py_trees.common import Access
from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import convert_str_to_type, is_instance_of_type

from rosa_bt.exceptions import RosaBtError
from rosa_bt.parsers.blackboard import Blackboard, key_of
from rosa_bt.parsers.exceptions import hint

__all__ = ["Declared", "Port", "PortError", "Ports", "wire"]

Declared = Mapping[str, PortInformation]
"""Which ports a node has."""


class PortError(RosaBtError, ValueError):
    """A port is not declared, lacks a value, or has one of another type."""


class Ports:
    """The ports of one node.

    Args:
        declared: which it has.
        written: the attributes of its element, without `name`, `ID` and those that begin with an underscore.
        blackboard: of the SubTree that it is in.

    Raises:
        PortError: an attribute is no port of it, one that is required is missing, or a literal is of another type.
    """

    def __init__(self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard) -> None:
        self._declared = declared
        self._blackboard = blackboard
        self._keys: dict[str, str] = {}
        self._literals: dict[str, Any] = {}
        for name, text in written.items():
            if name not in declared:
                raise PortError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            key = key_of(text, name)
            if key is None:
                self._literals[name] = self._converted(name, text)
            else:
                self._keys[name] = key

    def check_required(self, but: frozenset[str] = frozenset()) -> None:
        """Raise unless every port that needs a value, except the outputs, is given one or has a default."""
        for name, port in self._declared.items():
            given = name in self._keys or name in self._literals or port.has_default
            if port.required and not given and name not in but:
                raise PortError(f"the port {name!r} is missing; write {name}=... in the element")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now, other than its default."""
        return name in self._literals or (name in self._keys and self._keys[name] in self._blackboard)

    def get(self, name: str) -> Any:  # noqa: ANN401  # of the type that the port declares
        """Return the value that a port has now, or its default."""
        if name in self._literals:
            return self._literals[name]
        key = self._keys.get(name)
        if key is not None and key in self._blackboard:
            return self._converted(name, self._blackboard[key])
        if self._declared[name].has_default:
            return self._declared[name].default_value
        missing = f"there is no {key!r} on the blackboard (yet)" if key else "the element gives it none"
        raise PortError(f"the port {name!r} has no value: {missing}")

    def set(self, name: str, value: object) -> None:
        """Write what a port puts out; a port without a key puts it nowhere."""
        if name in self._keys:
            self._blackboard[self._keys[name]] = value

    def unset(self, name: str) -> None:
        """Take what a port has put out from the blackboard."""
        if name in self._keys:
            self._blackboard.pop(self._keys[name], None)

    def key(self, name: str) -> str | None:
        """Return the key that a port points at; None for a literal or nothing."""
        return self._keys.get(name)

    def is_literal(self, name: str) -> bool:
        """Tell whether a port is given a value in the element itself."""
        return name in self._literals

    def _converted(self, name: str, value: object) -> Any:  # noqa: ANN401  # of the type that the port declares
        wanted = self._declared[name].data_type
        if wanted in (Any, object, Port):
            return value
        if isinstance(value, str) and wanted is not str:
            return self._read(name, value, wanted)
        if wanted is float and isinstance(value, int):
            return float(value)
        if wanted is int and isinstance(value, float) and value.is_integer():
            return int(value)
        if not _is_of(value, wanted):
            raise PortError(f"the port {name!r} takes {_spoken(wanted)}, not {value!r}")
        return value

    def _read(self, name: str, text: str, wanted: Any) -> Any:  # noqa: ANN401  # py_trees takes any type
        try:
            done, value = convert_str_to_type(text, wanted)
        except (ValueError, TypeError):
            done, value = False, None
        if not done:
            raise PortError(f"the port {name!r} takes {_spoken(wanted)}, not {text!r}")
        return value


def _is_of(value: object, wanted: Any) -> bool:  # noqa: ANN401  # py_trees takes any type
    try:
        return is_instance_of_type(value, wanted)
    except NotImplementedError:
        return isinstance(value, get_origin(wanted))


def _spoken(wanted: Any) -> str:  # noqa: ANN401  # py_trees takes any type
    return f"a value of type {getattr(wanted, '__name__', wanted)}"


class Port:
    """One port, for behaviours that do not use py_trees' ports: handed to a parameter that is given a `{key}`.

    Args:
        ports: of the node.
        name: of the port.
    """

    def __init__(self, ports: Ports, name: str) -> None:
        self._ports = ports
        self.name = name

    def get(self) -> Any:  # noqa: ANN401  # whatever is on the blackboard
        """Return the value that it has now."""
        return self._ports.get(self.name)

    def set(self, value: object) -> None:
        """Write a value."""
        self._ports.set(self.name, value)


class _Client:
    """Stands in for py_trees' blackboard client, whose storage is one for the whole process."""

    def __init__(self, ports: Ports, declared: Declared) -> None:
        self._ports = ports
        self._declared = declared
        self.remappings: Final[dict[str, str]] = {}

    def register_key(self, key: str, access: Access, required: bool = False, remap_to: str | None = None) -> None:
        """Do nothing: a node has the ports that it declares."""

    def is_registered(self, key: str) -> bool:
        return key in self._declared

    def absolute_name(self, key: str) -> str:
        return self._ports.key(key) or key

    def exists(self, key: str) -> bool:
        return self._ports.exists(key)

    def get(self, key: str) -> Any:  # noqa: ANN401  # of the type that the port declares
        return self._ports.get(key)

    def set(self, key: str, value: object) -> None:
        self._ports.set(key, value)

    def unset(self, key: str) -> None:
        self._ports.unset(key)


def wire(behaviour: PortsMixin, ports: Ports) -> None:
    """Connect a behaviour with py_trees' ports to the blackboard of the tree instead of the process's."""
    client = _Client(ports, {**behaviour.input_ports(), **behaviour.output_ports()})
    behaviour.attach_blackboard_client = lambda **_: client  # type: ignore[method-assign,assignment]  # only here
    try:
        behaviour.setup_ports()
    finally:
        del behaviour.attach_blackboard_client
