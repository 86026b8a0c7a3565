"""What nodes read and write: the blackboard of a tree, and ports, with values of the types that a node declares."""

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final, get_origin

from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import convert_str_to_type, is_instance_of_type

from rosa_bt.exceptions import RosaBtError, hint

Clock = Callable[[], float]
"""Gives the time [s]."""
Declared = Mapping[str, PortInformation]
"""Which ports a node has."""


class PortError(RosaBtError, ValueError):
    """A port is not declared, lacks a value, or has one of another type."""


def key_of(written: str, port: str) -> str | None:
    """Return the key that a port's text points at: `{key}`, or `{=}` for the port's own name; None for a literal."""
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    inner = written[1:-1].strip()
    return port if inner == "=" else inner


class Blackboard(MutableMapping[str, Any]):
    """What the nodes of one SubTree can see; shared with nobody else but through remapped keys.

    A key is looked for, in this order: `@key` in the blackboard of the main tree; among the constants that the SubTree
    was given; under the name that it was remapped to, in the blackboard around; with autoremapping, under its own name
    there, unless it begins with an underscore; here.
    """

    def __init__(
        self,
        clock: Clock,
        parent: "Blackboard | None" = None,
        remapping: Mapping[str, str] | None = None,
        constants: Mapping[str, str] | None = None,
        *,
        autoremap: bool = False,
    ) -> None:
        self.clock: Final = clock
        self.parent: Final = parent
        self._remapping = dict(remapping or {})
        self._constants = frozenset(constants or ())
        self._autoremap = autoremap
        self._values: dict[str, Any] = dict(constants or {})

    def place(self, key: str) -> tuple[dict[str, Any], str]:
        """Return where a key is kept: the values of one of the blackboards, and the key's name there."""
        if key.startswith("@"):
            root = self
            while root.parent is not None:
                root = root.parent
            return root.place(key[1:])
        if self.parent is None or key in self._constants:
            return self._values, key
        if key in self._remapping:
            return self.parent.place(self._remapping[key])
        if self._autoremap and not key.startswith("_"):
            return self.parent.place(key)
        return self._values, key

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401  # whatever a behaviour has written
        values, name = self.place(key)
        return values[name]

    def __setitem__(self, key: str, value: Any) -> None:  # noqa: ANN401  # whatever a behaviour writes
        values, name = self.place(key)
        values[name] = value

    def __delitem__(self, key: str) -> None:
        values, name = self.place(key)
        del values[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that are kept here; those of the blackboard around are its own."""
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


class Ports:
    """The ports that a node declares, as the attributes of its element fill them.

    Raises:
        PortError: an attribute is no port of it, or a literal is of another type.
    """

    def __init__(self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard) -> None:
        self.blackboard: Final = blackboard
        self.clock: Final = blackboard.clock
        self._declared = declared
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
        """Raise unless every port that needs a value, except some, is given one or has a default."""
        for name, port in self._declared.items():
            given = name in self._keys or name in self._literals or port.has_default
            if port.required and not given and name not in but:
                raise PortError(f"the port {name!r} is missing; write {name}=... in the element")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now, other than its default."""
        return name in self._literals or (name in self._keys and self._keys[name] in self.blackboard)

    def get(self, name: str) -> Any:  # noqa: ANN401  # of the type that the port declares
        """Return the value that a port has now, or its default."""
        if name in self._literals:
            return self._literals[name]
        key = self._keys.get(name)
        if key is not None and key in self.blackboard:
            return self._converted(name, self.blackboard[key])
        if self._declared[name].has_default:
            return self._declared[name].default_value
        missing = f"there is no {key!r} on the blackboard (yet)" if key else "the element gives it none"
        raise PortError(f"the port {name!r} has no value: {missing}")

    def set(self, name: str, value: object) -> None:
        """Write what a port puts out; a port without a key puts it nowhere."""
        if name in self._keys:
            self.blackboard[self._keys[name]] = value

    def key(self, name: str) -> str | None:
        """Return the key that a port points at; None for a literal or nothing."""
        return self._keys.get(name)

    def is_literal(self, name: str) -> bool:
        """Tell whether a port is given a value in the element itself."""
        return name in self._literals

    def connect(self, behaviour: PortsMixin) -> None:
        """Connect a behaviour with py_trees' ports to the blackboard of the tree instead of the process's."""
        declared = {**behaviour.input_ports(), **behaviour.output_ports()}
        client = SimpleNamespace(  # stands in for py_trees' client, whose storage is one for the whole process
            register_key=lambda **_: None,
            is_registered=declared.__contains__,
            absolute_name=lambda key: self.key(key) or key,
            exists=self.exists,
            get=self.get,
            set=self.set,
        )
        behaviour.attach_blackboard_client = lambda **_: client  # type: ignore[method-assign,assignment]  # only here
        try:
            behaviour.setup_ports()
        finally:
            del behaviour.attach_blackboard_client

    def _converted(self, name: str, value: object) -> Any:  # noqa: ANN401  # of the type that the port declares
        wanted = self._declared[name].data_type
        if wanted in (Any, object, Port):
            return value
        if wanted is float and isinstance(value, int):
            return float(value)
        if wanted is int and isinstance(value, float) and value.is_integer():
            return int(value)
        try:
            if isinstance(value, str) and wanted is not str:
                is_right, converted = convert_str_to_type(value, wanted)
            else:
                is_right, converted = is_instance_of_type(value, wanted), value
        except NotImplementedError:
            is_right, converted = isinstance(value, get_origin(wanted)), value
        except (ValueError, TypeError):
            is_right = False
        if not is_right:
            raise PortError(
                f"the port {name!r} takes a value of type {getattr(wanted, '__name__', wanted)}, not {value!r}"
            )
        return converted


@dataclass(frozen=True)
class Port:
    """One port, for behaviours that do not use py_trees' ports: handed to a parameter that is given a `{key}`."""

    ports: Ports
    name: str

    def get(self) -> Any:  # noqa: ANN401  # whatever is on the blackboard
        return self.ports.get(self.name)

    def set(self, value: object) -> None:
        self.ports.set(self.name, value)
