"""Blackboards, whose entries the nodes of a tree read and write, and ports, through which they do so.

The XML element of a node fills each port with a literal or with a key of the blackboard. Whole numbers are int, doubles
float, texts str; a value that the program or a port declares as bool stays a bool.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final, get_args, get_origin

from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import convert_str_to_type, is_instance_of_type

from rosa_bt.exceptions import RosaBtError, hint

Clock = Callable[[], float]
"""Gives the time [s]."""


class PortError(RosaBtError, ValueError):
    """A port is not declared, has no value, or a value of another type."""


class ScriptError(RosaBtError, ValueError):
    """A script cannot be read, or fails when it runs."""


class _Empty:
    """The value of an entry that is still empty."""

    def __repr__(self) -> str:
        return "what has no value"


EMPTY: Final = _Empty()
_EXACT: Final = 2**53  # from here on, a double cannot hold every whole number
_NUMBER: Final = re.compile(
    r"\s*[-+]?(?:0x[0-9a-f]+|inf|nan|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", re.IGNORECASE | re.ASCII
)


def is_number(value: object) -> bool:
    return isinstance(value, int | float)


def double(value: Any) -> float:  # noqa: ANN401  # a number of any kind
    if isinstance(value, int) and abs(value) >= _EXACT:
        raise ScriptError(f"{value} is too large for a double to hold exactly")
    return float(value)


def whole(value: Any) -> int:  # noqa: ANN401  # a number of any kind
    if isinstance(value, float) and not value.is_integer():
        raise ScriptError(f"{value:g} is not whole, and a whole number is needed")
    if abs(value) >= 2**63:
        raise ScriptError(f"{value:g} is out of the range of whole numbers, which have 64 bits")
    return int(value)


def truth(value: object) -> bool:
    """Return the truth of a value: a double is true unless 0, a whole number is 1 or 0; all else raises."""
    if isinstance(value, float) or value in (0, 1):
        return bool(value)
    raise ScriptError(f"{value!r} is neither true nor false; compare it with something")


def number_in(text: str, board: "Blackboard") -> float:
    """Return the number that a text means: a number, `true`, `false` or the name of an enum."""
    named = {**board.enums, "true": 1.0, "false": 0.0}
    return float(named[text]) if text in named else begun(text)


def begun(text: str) -> float:
    """Return the number at the beginning of a text, as the C library (`strtod`) reads it."""
    found = _NUMBER.match(text)
    if found is None:
        raise ScriptError(f"{text!r} is no number")
    return float(int(found[0], 16)) if "x" in found[0].lower() else float(found[0])


def as_text(value: object) -> str:
    """Return a value as a text, as the operator `..` of scripts does: a double with six decimals."""
    return (
        f"{value:.6f}"
        if isinstance(value, float)
        else str(int(value) if isinstance(value, bool) else value)
    )


def fit(entry: "Entry", value: Any) -> Any:  # noqa: ANN401  # a value of any kind
    """Return a value converted to the kind of value that an entry holds.

    Raises:
        ScriptError: the value cannot be converted.
    """
    held = entry.value
    if is_number(held) and is_number(
        value
    ):  # an entry that holds a bool takes other whole numbers, too
        is_bool = isinstance(held, bool) and value in (0, 1)
        return cast(value, bool if is_bool else float if isinstance(held, float) else int)
    if (
        held is EMPTY
        or type(held) is type(value)
        or (isinstance(held, str) and isinstance(value, str))
    ):
        return value
    raise ScriptError(f"{value!r} does not fit an entry that holds {held!r}")


OUTCOMES: Final = {one.name: one for one in Status if one is not Status.INVALID} | {
    "SKIPPED": Status.INVALID
}
"""The outcomes that a port can name, such as `else` of Precondition."""
SCALARS: Final = (bool, int, float, str)


@dataclass(slots=True)
class Entry:
    """What a blackboard holds under one key: a value, its declared type (None: any), and how often it was written.

    An entry exists as soon as a port names its key; it is empty until it is written.
    """

    value: Any = EMPTY
    declared: Any = None
    version: int = 0
    takes_any: bool = False
    """Whether a port of a Python leaf that states no type names it: it takes whatever is written."""
    is_emptied: bool = False
    """Whether SetBlackboard emptied it by writing a text, as it does if no type is declared."""

    def put(self, value: object) -> None:
        self.value = value
        self.version += 1

    def read(self, text: str) -> Any:  # noqa: ANN401  # of the type that is declared
        """Return a text of a script converted to the declared type; unchanged if none is declared."""
        if self.declared is Status:
            raise ScriptError(f"a script cannot write {text!r} to an entry for an outcome")
        return converted(text, self.declared)

    def take(self, value: Any, *, is_port: bool = False) -> None:  # noqa: ANN401  # whatever is written
        """Write a value from the program or a port, converted to the declared type; the first value declares it.

        Raises:
            PortError: the value is not of the declared type, and cannot be converted.
        """
        declared = self.declared
        try:
            if declared is None:
                self.declared = type(value) if isinstance(value, SCALARS) else None
            elif isinstance(value, str) and declared is not str:
                value = converted(value, declared)
            elif declared in SCALARS and (declared is not str or is_port):
                if type(value) is not declared and (declared is str or not is_number(value)):
                    raise ScriptError(f"it is declared as {declared.__name__}")
                value = cast(value, declared)
        except (ValueError, TypeError) as error:
            raise PortError(f"an entry cannot take {value!r}: {error}") from None
        self.put(value)


class Blackboard(MutableMapping[str, Any]):
    """The blackboard of one SubTree; other trees share entries with it through remapped keys only.

    A key is looked up in this order: `@key` in the blackboard of the main tree; among the constants of the SubTree
    element; under its remapped name in the blackboard of the parent tree; with autoremapping under its own name there,
    unless it begins with an underscore; in this blackboard. As a mapping, it does not contain empty entries.
    """

    def __init__(
        self,
        clock: Clock,
        parent: "Blackboard | None" = None,
        remapping: Mapping[str, str] | None = None,
        constants: Mapping[str, str] | None = None,
        *,
        autoremap: bool = False,
        enums: Mapping[str, int] | None = None,
    ) -> None:
        self.parent: Final = parent
        self.root: Final[Blackboard] = self if parent is None else parent.root
        self.read_clock = clock
        self.enums: Final[Mapping[str, int]] = (
            parent.enums if parent is not None else dict(enums or {})
        )
        self._remapping = dict(remapping or {})
        self._autoremap = autoremap
        self._entries: dict[str, Entry] = {}
        self._constants = frozenset(constants or {})
        for key, text in (constants or {}).items():
            self[key] = _constant(text)

    def clock(self) -> float:
        """Return the time by the clock of the whole tree [s]."""
        return self.root.read_clock()

    def follow(self, clock: Clock) -> None:
        """Take another clock for the whole tree."""
        self.root.read_clock = clock

    def place(self, key: str) -> tuple[dict[str, Entry], str]:
        """Return where a key is kept: the entries of a blackboard, and the name of the key in it."""
        if key.startswith("@"):
            return self.root.place(key[1:])
        if self.parent is None or key in self._constants:
            return self._entries, key
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
        """Return the entry of a key; if it does not exist, make it, with the type that a port declares."""
        entries, name = self.place(key)
        if name not in entries:
            entries[name] = Entry(declared=declared)
            if self._remapping.get(key, "").startswith(
                "@"
            ):  # BehaviorTree.CPP shows it under both names
                entries[f"@{name}"] = entries[name]
        return entries[name]

    def unset(self, key: str) -> None:
        """Remove a key from this blackboard; as in BehaviorTree.CPP, a remapped key is not removed."""
        self._entries.pop(key, None)

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401  # whatever a behaviour has written
        entry = self.entry(key)
        if entry is None or entry.value is EMPTY:
            raise KeyError(key)
        return entry.value

    def __setitem__(self, key: str, value: Any) -> None:  # noqa: ANN401  # whatever a behaviour writes
        entry = self.entry(key)
        if entry is not None:
            entry.take(value)
        else:  # a text from the program declares no type
            made = self.make(key, type(value) if isinstance(value, bool | int | float) else None)
            made.put(value)

    def __delitem__(self, key: str) -> None:
        entries, name = self.place(key)
        del entries[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that have a value in this blackboard, without those of the parent tree."""
        return (key for key, entry in self._entries.items() if entry.value is not EMPTY)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _constant(text: str) -> int | float | str:
    """Return the value of a literal of a SubTree element: a whole number, a double, or else a text."""
    if re.fullmatch(r"-?[\d.]+(e[-+]?\d+)?", text, re.IGNORECASE | re.ASCII):
        for kind in (int, float):
            with suppress(ValueError):
                return kind(text)
    return text


BOOLS: Final = {
    **dict.fromkeys(("1", "true", "TRUE", "True"), True),
    **dict.fromkeys(("0", "false", "FALSE", "False"), False),
}
_BEGINS: Final[Mapping[Any, str]] = {
    int: r"-?\d+",
    float: r"-?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|inf|nan)",
}
_WORDS: Final[Mapping[Any, Mapping[str, Any]]] = {bool: BOOLS, Status: OUTCOMES}


def converted(text: str, wanted: Any) -> Any:  # noqa: ANN401  # of the type that is wanted
    """Return a text converted to a type: numbers by their beginning, lists as `1;2;3`, structures as `json:...`.

    Raises:
        ValueError, TypeError: the text has no meaning as that type.
    """
    if wanted in (None, Any, object, str):
        return text
    value, is_right, called = None, False, getattr(wanted, "__name__", wanted)
    if text.startswith("json:"):
        value = json.loads(text[5:])
        is_right = is_instance_of_type(value, wanted)
    elif wanted in _WORDS:
        value, is_right = _WORDS[wanted].get(text), text in _WORDS[wanted]
    elif wanted in _BEGINS:
        called = "number" if wanted is float else "number of 32 bits"
        if found := re.match(_BEGINS[wanted], text, re.ASCII):
            value = wanted(found[0])
            is_right = wanted is float or -(2**31) <= value < 2**31
    elif get_origin(wanted) is list:
        return [
            converted(part, get_args(wanted)[0])
            for part in text.removesuffix(";").split(";")
            if text
        ]
    else:
        is_right, value = convert_str_to_type(text, wanted)
    if not is_right:
        raise ValueError(f"{text!r} is no {called}")
    return value


def cast(value: Any, wanted: Any) -> Any:  # noqa: ANN401  # a number, as another kind
    if wanted is str:
        return as_text(value)
    return truth(value) if wanted is bool else double(value) if wanted is float else whole(value)


Declared = Mapping[str, PortInformation]
"""The ports of a node, by name."""


def key_of(written: str, port: str) -> str | None:
    """Return the key in the text of a port: of `{key}`, or for `{=}` the name of the port; None for a literal."""
    written = written.strip()
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    return port if written[1:-1] == "=" else written[1:-1]


def ports_of(made: object) -> tuple[Declared, Declared]:
    """Return the py_trees ports of a behaviour or of a class of behaviours: all ports, and the output ports."""
    if isinstance(made, PortsMixin) or (isinstance(made, type) and issubclass(made, PortsMixin)):
        return {**made.input_ports(), **made.output_ports()}, made.output_ports()
    return {}, {}


class Ports:
    """The ports of a node, filled by the attributes of its element.

    Attributes:
        keys: the blackboard keys of ports that have one, by name of the port.
        literals: the values of ports that have a literal, by name of the port.

    Raises:
        PortError: an attribute is not a port of the node, a literal has a wrong type, or a key has another type.
    """

    def __init__(
        self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard
    ) -> None:
        self.blackboard: Final = blackboard
        self._declared = declared
        self.keys: Final[dict[str, str]] = {}
        self.literals: Final[dict[str, Any]] = {}
        self._seen = 0
        for name, text in written.items():
            if name not in declared:
                raise PortError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            key = key_of(text, name)
            if key is None:  # a wrong outcome raises only in the tick
                self.literals[name] = (
                    text if self._type(name) is Status else self._converted(name, text)
                )
            else:
                self.keys[name] = key
                before, now = blackboard.make(key, self._type(name)).declared, self._type(name)
                if None not in (before, now) and before not in (now, str):
                    before, now = (getattr(one, "__name__", str(one)) for one in (before, now))
                    raise PortError(
                        f"{{{key}}} is declared as {before} already, and {name!r} declares it as {now}"
                    )

    def _type(self, name: str) -> Any:  # noqa: ANN401  # as it is declared; None for any
        wanted = self._declared[name].data_type
        return None if wanted in (Any, object) else wanted

    def check_required(self, but: frozenset[str] = frozenset()) -> None:
        """Raise if a required port, except those in `but`, has neither a value nor a default."""
        for name, port in self._declared.items():
            given = name in self.keys or name in self.literals or port.has_default
            if port.required and not given and name not in but:
                raise PortError(f"the port {name!r} is missing; write {name}=... in the element")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now; its default does not count."""
        return name in self.literals or (name in self.keys and self.keys[name] in self.blackboard)

    def get(self, name: str) -> Any:  # noqa: ANN401  # of the type that the port declares
        """Return the value of a port now; its default if the element does not set it."""
        if name in self.literals:
            return self._converted(name, self.literals[name])
        key = self.keys.get(name)
        if key is not None and key in self.blackboard:
            return self._converted(name, self.blackboard[key])
        if key is None and self._declared[name].has_default:
            return self._declared[name].default_value
        missing = (
            f"there is no {key!r} on the blackboard (yet)" if key else "the element gives it none"
        )
        raise PortError(f"the port {name!r} has no value: {missing}")

    def set(self, name: str, value: object) -> None:
        """Write the value of an output port to its key; without a key, do nothing."""
        if name in self.keys:
            self.blackboard.make(self.keys[name], self._type(name)).take(value, is_port=True)

    def is_updated(self, name: str) -> bool:
        """Tell whether the entry that a port names, as `{key}` or `key`, was written since the last call."""
        entry = self.blackboard.entry(self.keys.get(name) or str(self.get(name)))
        seen, self._seen = self._seen, self._seen if entry is None else entry.version
        return self._seen != seen

    def connect(self, behaviour: PortsMixin) -> None:
        """Connect the py_trees ports of a behaviour to this blackboard instead of that of the process."""
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

    def _converted(self, name: str, value: object) -> Any:  # noqa: ANN401  # of the type that the port declares
        wanted = self._type(name)
        if wanted is None:
            return value
        try:
            if isinstance(value, str):
                return converted(value, wanted)
            if is_number(value) and wanted in SCALARS:
                return cast(value, wanted)
            if is_instance_of_type(value, wanted):
                return value
        except NotImplementedError:
            if isinstance(value, get_origin(wanted)):
                return value
        except (ValueError, TypeError):
            pass
        called = getattr(wanted, "__name__", wanted)
        raise PortError(f"the port {name!r} takes a value of type {called}, not {value!r}")
