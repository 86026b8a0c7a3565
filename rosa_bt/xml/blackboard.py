"""Blackboards, and the ports through which the nodes of a tree read and write them.

The XML element of a node fills each port with a literal or with a key of the blackboard.
"""

from collections.abc import Callable, Container, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, get_origin

from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import is_instance_of_type

from rosa_bt.exceptions import RosaBtError, hint
from rosa_bt.xml.values import (
    CASTS,
    EMPTY,
    Value,
    converted,
    is_number,
    literal,
    type_name,
)

Clock = Callable[[], float]
"""Gives the time [s]."""


class PortError(RosaBtError, ValueError):
    """A port is not declared, has no value, or a value of another type."""


@dataclass(slots=True)
class Entry:
    """A value under a key, its declared type (None: any), and how often it was written.

    An entry exists as soon as a port names its key; it is empty until it is written.
    """

    value: Value = EMPTY
    declared: Any = None
    version: int = 0
    takes_any: bool = False
    """Whether a port of a Python leaf that states no type names it: it takes whatever is
    written."""
    is_emptied: bool = False
    """Whether SetBlackboard emptied it by writing a text, as it does if no type is declared."""

    def put(self, value: Value) -> None:
        self.value = value
        self.version += 1

    def take(self, value: Value) -> None:
        """Write a value from the program or a port, as the declared type.

        The first value declares it.

        Raises:
            PortError: the value is not of the declared type, and cannot be converted.
        """
        declared = self.declared
        try:
            if declared is None:
                self.declared = type(value) if type(value) in CASTS else None
            elif isinstance(value, str):
                value = converted(value, declared)
            elif declared in CASTS and declared is not str:
                value = CASTS[declared](value)
        except (ValueError, TypeError) as error:
            raise PortError(f"an entry cannot take {value!r}: {error}") from None
        self.put(value)


class Blackboard(MutableMapping[str, Any]):
    """The blackboard of one SubTree; other trees share entries with it through remapped keys only.

    A key is looked up in this order: `@key` in the blackboard of the main tree; among the constants
    of the SubTree element; under its remapped name in the blackboard of the parent tree; with
    autoremapping under its own name there, unless it begins with an underscore; in this blackboard.
    As a mapping, it does not contain empty entries.

    Args:
        clock: of the main tree.
        parent: the blackboard of the tree around this one.
        ports: the attributes of the SubTree element: keys and constants.
        autoremap: whether all keys are remapped to their own names.
        enums: the names that scripts can use, of the main tree.
    """

    def __init__(
        self,
        clock: Clock,
        parent: "Blackboard | None" = None,
        ports: Mapping[str, str] | None = None,
        *,
        autoremap: bool = False,
        enums: Mapping[str, int] | None = None,
    ) -> None:
        self.parent = parent
        self.root: Blackboard = self if parent is None else parent.root
        self.has_own_clock = False
        self.read_clock = clock
        self.enums: Mapping[str, int] = enums or {}
        self._remapping: dict[str, str] = {}
        self._autoremap = autoremap
        self._entries: dict[str, Entry] = {}
        for name, text in (ports or {}).items():
            key = key_of(text, name)
            if key is None:
                value = literal(text)
                self._entries[name] = Entry(
                    value, None if isinstance(value, str) else type(value), 1
                )
            else:
                self._remapping[name] = key
        self._constants = frozenset(self._entries)

    def clock(self) -> float:
        """Return the time by the clock of the whole tree [s]."""
        return self.root.read_clock()

    def follow(self, clock: Clock) -> None:
        """Take another clock, unless the tree was given one of its own."""
        if not self.has_own_clock:
            self.read_clock = clock

    def place(self, key: str) -> tuple[dict[str, Entry], str]:
        """Return where a key is kept: the entries of a blackboard, and its name there."""
        if key.startswith("@"):
            return self.root.place(key[1:])
        if self.parent is not None and key not in self._constants:
            if key in self._remapping:
                return self.parent.place(self._remapping[key])
            if self._autoremap and not key.startswith("_"):
                return self.parent.place(key)
        return self._entries, key

    def entry(self, key: str) -> Entry | None:
        """Return the entry of a key, which may be empty; None if it does not exist."""
        entries, name = self.place(key)
        return entries.get(name)

    def make(self, key: str, declared: object = None) -> Entry:
        """Return the entry of a key.

        If it does not exist, make it, with the type that a port declares.
        """
        entries, name = self.place(key)
        if name not in entries:
            entries[name] = Entry(declared=declared)
            if self._remapping.get(key, "").startswith("@"):  # it is shown under both names
                entries[f"@{name}"] = entries[name]
        return entries[name]

    def unset(self, key: str) -> None:
        """Remove a key from this blackboard.

        As in BehaviorTree.CPP, a remapped key is not removed.
        """
        self._entries.pop(key, None)

    def __getitem__(self, key: str) -> Value:
        entry = self.entry(key)
        if entry is None or entry.value is EMPTY:
            raise KeyError(key)
        return entry.value

    def __setitem__(self, key: str, value: Value) -> None:
        entry = self.entry(key)
        if entry is not None:
            entry.take(value)
        else:  # a text from the program declares no type
            self.make(key, type(value) if is_number(value) else None).put(value)

    def __delitem__(self, key: str) -> None:
        entries, name = self.place(key)
        del entries[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that have a value in this blackboard itself."""
        return (key for key, entry in self._entries.items() if entry.value is not EMPTY)

    def __len__(self) -> int:
        return sum(1 for _ in self)


Declared = Mapping[str, PortInformation]
"""The ports of a node, by name."""


def key_of(written: str, port: str) -> str | None:
    """Return the key in the text of a port: of `{key}`, or for `{=}` the name of the port.

    None for a literal.
    """
    written = written.strip()
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    return port if written == "{=}" else written[1:-1]


def ports_of(made: object) -> tuple[Declared, Declared]:
    """Return all py_trees ports of a behaviour or of a class, and its output ports."""
    if isinstance(made, PortsMixin) or (isinstance(made, type) and issubclass(made, PortsMixin)):
        return {**made.input_ports(), **made.output_ports()}, made.output_ports()
    return {}, {}


class Ports:
    """The ports of a node, filled by the attributes of its element.

    Attributes:
        keys: the blackboard keys of ports that have one, by name of the port.
        literals: the values of ports that have a literal, by name of the port.

    Raises:
        PortError: an attribute is not a port of the node, a literal has a wrong type, or a key has
            another type.
    """

    def __init__(
        self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard
    ) -> None:
        self.blackboard = blackboard
        self._declared = declared
        self.keys: dict[str, str] = {}
        self.literals: dict[str, Value] = {}
        self._seen = 0
        for name, text in written.items():
            if name not in declared:
                raise PortError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            wanted = self._type(name)
            key = key_of(text, name)
            if key is None:  # a wrong outcome raises only in the tick
                self.literals[name] = text if wanted is Status else self._converted(name, text)
                continue
            self.keys[name] = key
            before = blackboard.make(key, wanted).declared
            if wanted is not None and before not in (None, wanted, str):
                raise PortError(
                    f"{{{key}}} is declared as {type_name(before)} already, "
                    f"and {name!r} declares it as {type_name(wanted)}"
                )

    def _type(self, name: str) -> Any:  # noqa: ANN401  # as it is declared; None for any
        wanted = self._declared[name].data_type
        return None if wanted in (Any, object) else wanted

    def check_required(self, but: Container[str] = ()) -> None:
        """Raise if a required port, except those in `but`, has neither a value nor a default."""
        for name, port in self._declared.items():
            is_set = name in self.keys or name in self.literals or name in but
            if port.required and not (is_set or port.has_default):
                raise PortError(f"the port {name!r} is missing; write {name}=... in the element")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now; its default does not count."""
        return name in self.literals or self.keys.get(name, "") in self.blackboard

    def get(self, name: str) -> Value:
        """Return the value of a port now; its default if the element does not set it."""
        key = self.keys.get(name)
        if name in self.literals:
            return self._converted(name, self.literals[name])
        if key is None and self._declared[name].has_default:
            return self._declared[name].default_value
        if key is None or key not in self.blackboard:
            missing = f"there is no {key!r} on the blackboard (yet)" if key else "it is not written"
            raise PortError(f"the port {name!r} has no value: {missing}")
        return self._converted(name, self.blackboard[key])

    def set(self, name: str, value: Value) -> None:
        """Write the value of an output port to its key; without a key, do nothing."""
        if name in self.keys:
            self.blackboard.make(self.keys[name], self._type(name)).take(value)

    def is_updated(self, name: str) -> bool:
        """Tell whether the entry that a port names was written since the last call."""
        entry = self.blackboard.entry(self.keys.get(name) or str(self.get(name)))
        before = self._seen
        if entry is not None:
            self._seen = entry.version
        return self._seen != before

    def connect(self, behaviour: PortsMixin) -> None:
        """Connect the py_trees ports of a behaviour to this blackboard."""
        client = (
            SimpleNamespace(  # replaces the client of py_trees, which stores for the whole process
                register_key=lambda **_: None,
                is_registered=ports_of(behaviour)[0].__contains__,
                absolute_name=lambda key: self.keys.get(key) or key,
                exists=self.exists,
                get=self.get,
                set=self.set,
            )
        )
        behaviour.attach_blackboard_client = lambda **_: client  # type: ignore[method-assign,assignment]  # only here
        try:
            behaviour.setup_ports()
        finally:
            del behaviour.attach_blackboard_client

    def _converted(self, name: str, value: Value) -> Value:
        """Return a value as the type that the port declares."""
        wanted = self._type(name)
        if wanted is None:
            return value
        try:
            if isinstance(value, str):
                return converted(value, wanted)
            if is_number(value) and wanted in CASTS:
                return CASTS[wanted](value)
            if is_instance_of_type(value, wanted):
                return value
        except NotImplementedError:
            if isinstance(value, get_origin(wanted)):
                return value
        except (ValueError, TypeError):
            pass
        problem = f"takes a value of type {type_name(wanted)}, not {value!r}"
        raise PortError(f"the port {name!r} {problem}")
