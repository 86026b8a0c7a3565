"""Blackboards, the values on them, and the ports through which nodes read and write them.

The XML element of a node fills each port with a literal or with a key of the blackboard. Whole
numbers are int, doubles float, texts str; a value that the program or a port declares as bool stays
a bool. None is no value.
"""

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, get_args, get_origin

from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import convert_str_to_type, is_instance_of_type

from rosa_bt.decorators import Clock
from rosa_bt.exceptions import RosaBtError, hint

Value = Any
"""A text, a number, whatever the program wrote, or None."""

_WHOLE = re.compile(r"-?\d+", re.ASCII)
_NUMBER = re.compile(
    r"\s*[-+]?(?:inf|nan|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", re.IGNORECASE | re.ASCII
)
_ANY = (None, Any, object)


class NodeError(RosaBtError, ValueError):
    """A port, a script or a node cannot do what it is given; BehaviorTree.CPP throws then."""


def is_number(value: object) -> bool:
    return isinstance(value, int | float)


def double(value: Value) -> float:
    if not is_number(value):
        raise NodeError(f"{value!r} is no number")
    return float(value)


def whole(value: Value) -> int:
    if not is_number(value) or value % 1 != 0 or abs(value) >= 2**63:
        raise NodeError(f"{value!r} is not whole, or has more than 64 bits")
    return int(value)


def truth(value: Value) -> bool:
    """Return the truth of a value: a double is true unless 0, a whole number is 1 or 0."""
    if isinstance(value, float) or value in (0, 1):
        return bool(value)
    raise NodeError(f"{value!r} is neither true nor false; compare it with something")


def as_text(value: Value) -> str:
    """Return a value as text, as `..` in scripts does: a double with six decimals."""
    if isinstance(value, float):
        return f"{value:.6f}"
    return str(int(value) if isinstance(value, bool) else value)


CASTS: Mapping[Any, Callable[[Value], Value]] = {
    **{bool: truth, int: whole, float: double, str: as_text}
}


def begun(text: str) -> float:
    """Return the number at the beginning of a text, as the C library (`strtod`) reads it."""
    match = _NUMBER.match(text)
    if match is None:
        raise NodeError(f"{text!r} is no number")
    return float(match[0])


def convert(value: Value, wanted: Any) -> Value:  # noqa: ANN401  # a type of values
    """Return a value as a type; None and object are any.

    Raises:
        NodeError: the value has no meaning as that type.
    """
    if wanted in _ANY:
        return value
    try:
        if isinstance(value, str):
            return _read(value, wanted)
        if is_number(value) and wanted in CASTS:
            return CASTS[wanted](value)
        if is_instance_of_type(value, wanted):
            return value
    except (ValueError, TypeError, NotImplementedError):
        pass
    raise NodeError(f"{value!r} is no {type_name(wanted)}")


def _read(text: str, wanted: Any) -> Value:  # noqa: ANN401  # a type of values
    """Return a text as a type: numbers by their beginning, lists as `1;2;3`, or `json:...`."""
    if wanted is str:
        return text
    if text.startswith("json:"):
        return convert(json.loads(text[5:]), wanted)
    if wanted is Status and text == "SKIPPED":
        return Status.INVALID
    if wanted is float:
        return begun(text)
    if wanted is int:
        number = int(_WHOLE.match(text)[0])  # type: ignore[index]  # if there is none, a TypeError
        return convert(number if abs(number) < 2**31 else None, wanted)
    if get_origin(wanted) is list:
        parts = text.removesuffix(";").split(";") if text else []
        return [convert(part, get_args(wanted)[0]) for part in parts]
    is_right, value = convert_str_to_type(text, wanted)
    return value if is_right else convert(None, wanted)


def type_name(wanted: Any) -> str:  # noqa: ANN401  # a type of values
    return getattr(wanted, "__name__", str(wanted))


@dataclass(slots=True)
class Entry:
    """A value under a key, its declared type, and how often it was written.

    An entry exists as soon as a port names its key; it is empty until it is written.
    """

    value: Value = None
    declared: Any = None
    """None until a port or a number declares it; object if it takes whatever is written, as a port
    of a Python leaf that states no type wants it."""
    version: int = 0
    is_emptied: bool = False
    """Whether SetBlackboard emptied it by writing a text, as it does if no type is declared."""

    def put(self, value: Value) -> None:
        self.value = value
        self.version += 1

    def take(self, value: Value) -> None:
        """Write a value from the program or a port, as the declared type."""
        if self.declared is None and type(value) in (bool, int, float):
            self.declared = type(value)
        self.put(convert(value, self.declared))


class Blackboard(MutableMapping[str, Any]):
    """The blackboard of one SubTree; other trees share entries with it through remapped keys only.

    A key is looked up in this order: `@key` in the blackboard of the main tree; among the constants
    of the SubTree element; under its remapped name in the blackboard of the parent tree; with
    autoremapping under its own name there, unless it begins with an underscore; in this blackboard.
    As a mapping, it does not contain empty entries.

    Args:
        parent: the blackboard of the tree around this one.
        ports: the attributes of the SubTree element: keys and constants.
        autoremap: whether all keys are remapped to their own names.

    Attributes:
        root: the blackboard of the main tree, which has the clock and the enums of all.
        clock: gives the time [s].
        has_own_clock: whether it keeps its clock when the tree is run.
        enums: the names that scripts can use.
    """

    clock: Clock = time.monotonic
    has_own_clock = False
    enums: Mapping[str, int] = {}

    def __init__(
        self,
        parent: "Blackboard | None" = None,
        ports: Mapping[str, str] | None = None,
        *,
        autoremap: bool = False,
    ) -> None:
        self.root: Blackboard = self if parent is None else parent.root
        self._parent = parent
        self._autoremap = autoremap
        self._entries: dict[str, Entry] = {}
        self._outer_keys: dict[str, str | None] = {}
        for name, text in (ports or {}).items():
            self._outer_keys[name] = key_of(text, name)
            if self._outer_keys[name] is None:
                value: int | float | str = text
                for kind in (float, int) if "_" not in text else ():
                    with suppress(ValueError):
                        value = kind(text)
                self[name] = value

    def place(self, key: str) -> tuple[dict[str, Entry], str]:
        """Return where a key is kept: the entries of a blackboard, and its name there."""
        if key.startswith("@"):
            return self.root.place(key[1:])
        same = key if self._autoremap and not key.startswith("_") else None
        outer = self._outer_keys.get(key, same)
        if outer is None or self._parent is None:
            return self._entries, key
        return self._parent.place(outer)

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
            if (self._outer_keys.get(key) or "").startswith("@"):  # it is shown under both names
                entries[f"@{name}"] = entries[name]
        return entries[name]

    def __getitem__(self, key: str) -> Value:
        entry = self.entry(key)
        if entry is None or entry.value is None:
            raise KeyError(key)
        return entry.value

    def __setitem__(self, key: str, value: Value) -> None:
        self.make(key).take(value)

    def __delitem__(self, key: str) -> None:
        """Remove a key, which may not exist; as in BehaviorTree.CPP, a remapped one stays."""
        self._entries.pop(key, None)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that have a value in this blackboard itself."""
        return (key for key, entry in self._entries.items() if entry.value is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


Declared = Mapping[str, PortInformation]
"""The ports of a node, by name."""


def key_of(written: str, port: str) -> str | None:
    """Return the key in the text of a port: of `{key}`, or for `{=}` the name of the port.

    None for a literal.
    """
    match = re.fullmatch(r"\s*{(.+)}\s*", written)
    if match is None:
        return None
    return port if match[1] == "=" else match[1]


class Ports:
    """The ports of a node, filled by the attributes of its element.

    It replaces the client of py_trees' blackboard, which stores for the whole process.

    Attributes:
        keys: the blackboard keys of ports that have one, by name of the port.
        literals: the texts of ports that have a literal, by name of the port.

    Raises:
        NodeError: an attribute is not a port of the node, a literal has a wrong type, or a key has
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
                raise NodeError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            key = key_of(text, name)
            if key is None:
                self.literals[name] = text
                self.get(name)
                continue
            self.keys[name] = key
            wanted = declared[name].data_type
            entry = blackboard.make(key, wanted)
            if wanted in _ANY:
                entry.declared = entry.declared or wanted
            elif entry.declared not in (*_ANY, wanted, str):
                before = f"{{{key}}} is declared as {type_name(entry.declared)} already"
                raise NodeError(f"{before}, and {name!r} declares it as {type_name(wanted)}")
        for name, port in declared.items():
            if port.required and not port.has_default and name not in written:
                where = f"write {name}=... in the element, or hand it to BehaviourRegistry"
                raise NodeError(f"it needs a value for {name!r} when it is made; {where}")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now; its default does not count."""
        return name in self.literals or self.keys.get(name, "") in self.blackboard

    def get(self, name: str) -> Value:
        """Return the value of a port now; its default if the element does not set it."""
        value = self.literals.get(name, self._declared[name].default_value)
        if name in self.keys:
            value = self.blackboard.get(self.keys[name])
        if value is None:
            written = self.keys.get(name, name)
            raise NodeError(f"the port {name!r} has no value: {written!r} is not written (yet)")
        try:
            return convert(value, self._declared[name].data_type)
        except NodeError as error:
            raise NodeError(f"the port {name!r}: {error}") from None

    def set(self, name: str, value: Value) -> None:
        """Write the value of an output port to its key; without a key, do nothing."""
        if name in self.keys:
            self.blackboard.make(self.keys[name], self._declared[name].data_type).take(value)

    def is_updated(self, name: str) -> bool:
        """Tell whether the entry that a port names was written since the last call."""
        entry = self.blackboard.entry(self.keys.get(name) or str(self.get(name)))
        before = self._seen
        if entry is not None:
            self._seen = entry.version
        return self._seen != before

    def register_key(self, **_: object) -> None:
        """Do nothing: the ports are known."""

    def is_registered(self, name: str) -> bool:
        return name in self._declared

    def absolute_name(self, key: str) -> str:
        return self.keys.get(key) or key

    def connect(self, behaviour: PortsMixin) -> None:
        """Connect the py_trees ports of a behaviour to this blackboard."""
        behaviour.attach_blackboard_client = lambda **_: self  # type: ignore[method-assign,assignment]  # only here
        behaviour.setup_ports()
        del behaviour.attach_blackboard_client
