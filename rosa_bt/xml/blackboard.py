"""Blackboards, what the nodes of a tree read and write, entry by entry, and ports, through which they do so.

A port is filled with what the element of its node says: a literal, or a key of the blackboard. A whole number is an
int, a double a float, a text a str; what the program or a port made a bool stays one.
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
    """A port is not declared, lacks a value, or has one of another type."""


class ScriptError(RosaBtError, ValueError):
    """A script cannot be read, or fails when it is run."""


class _Empty:
    """The value of an entry that has none yet."""

    def __repr__(self) -> str:
        return "what has no value"


EMPTY: Final = _Empty()
_EXACT: Final = 2**53  # from here on, whole numbers are no doubles any more
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
    """Return what a value means where a condition is expected: a double not 0, a whole number 0 or 1, never a text."""
    if isinstance(value, float) or value in (0, 1):
        return bool(value)
    raise ScriptError(f"{value!r} is neither true nor false; compare it with something")


def number_in(text: str, board: "Blackboard") -> float:
    """Return the number that a text says, or `true`, `false` or an enum."""
    named = {**board.enums, "true": 1.0, "false": 0.0}
    return float(named[text]) if text in named else begun(text)


def begun(text: str) -> float:
    """Return the number that a text begins with, as the C library reads it."""
    found = _NUMBER.match(text)
    if found is None:
        raise ScriptError(f"{text!r} is no number")
    return float(int(found[0], 16)) if "x" in found[0].lower() else float(found[0])


def as_text(value: object) -> str:
    """Write a value as `..` does: a double with six digits."""
    return f"{value:.6f}" if isinstance(value, float) else str(int(value) if isinstance(value, bool) else value)


def fit(entry: "Entry", value: Any) -> Any:  # noqa: ANN401  # a value of any kind
    """Return a value as the entry takes it, of the kind that it holds.

    Raises:
        ScriptError: it cannot be of that kind.
    """
    held = entry.value
    if is_number(held) and is_number(value):  # an entry that holds a bool takes other whole numbers, too
        is_bool = isinstance(held, bool) and value in (0, 1)
        return cast(value, bool if is_bool else float if isinstance(held, float) else int)
    if held is EMPTY or type(held) is type(value) or (isinstance(held, str) and isinstance(value, str)):
        return value
    raise ScriptError(f"{value!r} does not fit an entry that holds {held!r}")


OUTCOMES: Final = {one.name: one for one in Status if one is not Status.INVALID} | {"SKIPPED": Status.INVALID}
"""What a node can be told to return instead of its child; read when it is needed."""
SCALARS: Final = (bool, int, float, str)


@dataclass(slots=True)
class Entry:
    """What a blackboard holds under one key: a value, the type that was declared for it, and how often it was written.

    An entry exists from when a port names it, and is empty until it is given a value.
    """

    value: Any = EMPTY
    declared: Any = None
    version: int = 0
    is_emptied: bool = False
    """Whether a text of SetBlackboard has emptied it, as it does with what has no declared type."""

    def put(self, value: object) -> None:
        self.value = value
        self.version += 1

    def read(self, text: str) -> Any:  # noqa: ANN401  # of the type that is declared
        """Return what a text of a script means as the type that is declared; a text if none is."""
        if self.declared is Status:
            raise ScriptError(f"a script writes no outcome, as {text!r} would be")
        return converted(text, self.declared)

    def take(self, value: Any, *, is_port: bool = False) -> None:  # noqa: ANN401  # whatever is written
        """Take what the program or a port writes, of the type that was declared; the first type is declared by it.

        Raises:
            PortError: it is not of that type, and cannot be.
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
    """What the nodes of one SubTree can see; shared with nobody else but through remapped keys.

    A key is looked for, in this order: `@key` in the blackboard of the main tree; among the constants that the SubTree
    was given; under the name that it was remapped to, in the blackboard around; with autoremapping, under its own name
    there, unless it begins with an underscore; here. An entry without a value counts as none.
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
        self.clock: Final = clock
        self.parent: Final = parent
        self.enums: Final[Mapping[str, int]] = parent.enums if parent is not None else dict(enums or {})
        self._remapping = dict(remapping or {})
        self._autoremap = autoremap
        self._entries: dict[str, Entry] = {}
        self._constants = frozenset(constants or {})
        for key, text in (constants or {}).items():
            self[key] = _constant(text)

    def place(self, key: str) -> tuple[dict[str, Entry], str]:
        """Return where a key is kept: the entries of one of the blackboards, and the key's name there."""
        if key.startswith("@"):
            root = self
            while root.parent is not None:
                root = root.parent
            return root.place(key[1:])
        if self.parent is None or key in self._constants:
            return self._entries, key
        if key in self._remapping:
            return self.parent.place(self._remapping[key])
        if self._autoremap and not key.startswith("_"):
            return self.parent.place(key)
        return self._entries, key

    def entry(self, key: str) -> Entry | None:
        """Return the entry of a key, which may be empty; None if there is none."""
        entries, name = self.place(key)
        return entries.get(name)

    def make(self, key: str, declared: object = None) -> Entry:
        """Return the entry of a key, made if there is none, of a type that a port declares."""
        entries, name = self.place(key)
        if name not in entries:
            entries[name] = Entry(declared=declared)
            if self._remapping.get(key, "").startswith("@"):  # the library shows it under both names
                entries[f"@{name}"] = entries[name]
        return entries[name]

    def unset(self, key: str) -> None:
        """Remove what lives here under a key; as in BehaviorTree.CPP, nothing that is remapped."""
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
        else:  # a text that the program sets may become anything
            made = self.make(key, type(value) if isinstance(value, bool | int | float) else None)
            made.put(value)

    def __delitem__(self, key: str) -> None:
        entries, name = self.place(key)
        del entries[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that have a value here; those of the blackboard around are its own."""
        return (key for key, entry in self._entries.items() if entry.value is not EMPTY)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _constant(text: str) -> int | float | str:
    """Return what a SubTree's literal is: a whole number, a double, else a text."""
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
    """Return what a text means as a type: numbers by their beginning, lists as `1;2;3`, structures as `json:...`.

    Raises:
        ValueError, TypeError: nothing.
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
        return [converted(part, get_args(wanted)[0]) for part in text.removesuffix(";").split(";") if text]
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
"""Which ports a node has."""


def key_of(written: str, port: str) -> str | None:
    """Return the key that a port's text points at: `{key}`, or `{=}` for the port's own name; None for a literal."""
    written = written.strip()
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    return port if written[1:-1] == "=" else written[1:-1]


def ports_of(made: object) -> tuple[Declared, Declared]:
    """Return the ports that py_trees knows of a behaviour, or of a class of them: all, and those that put out."""
    if isinstance(made, PortsMixin) or (isinstance(made, type) and issubclass(made, PortsMixin)):
        return {**made.input_ports(), **made.output_ports()}, made.output_ports()
    return {}, {}


class Ports:
    """The ports that a node declares, as the attributes of its element fill them.

    Attributes:
        keys: the key that a port points at, by name of the port.
        literals: the value that a port is given in the element itself, by name of the port.

    Raises:
        PortError: an attribute is no port of it, a literal is of another type, or a key was declared of another type.
    """

    def __init__(self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard) -> None:
        self.blackboard: Final = blackboard
        self.clock: Final = blackboard.clock
        self._declared = declared
        self.keys: Final[dict[str, str]] = {}
        self.literals: Final[dict[str, Any]] = {}
        self._seen = 0
        for name, text in written.items():
            if name not in declared:
                raise PortError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            key = key_of(text, name)
            if key is None:  # what is no outcome is an error of the tick
                self.literals[name] = text if self._type(name) is Status else self._converted(name, text)
            else:
                self.keys[name] = key
                before, now = blackboard.make(key, self._type(name)).declared, self._type(name)
                if None not in (before, now) and before not in (now, str):
                    before, now = (getattr(one, "__name__", str(one)) for one in (before, now))
                    raise PortError(f"{{{key}}} is declared as {before} already, and {name!r} declares it as {now}")

    def _type(self, name: str) -> Any:  # noqa: ANN401  # as it is declared; None for any
        wanted = self._declared[name].data_type
        return None if wanted in (Any, object) else wanted

    def check_required(self, but: frozenset[str] = frozenset()) -> None:
        """Raise unless every port that needs a value, except some, is given one or has a default."""
        for name, port in self._declared.items():
            given = name in self.keys or name in self.literals or port.has_default
            if port.required and not given and name not in but:
                raise PortError(f"the port {name!r} is missing; write {name}=... in the element")

    def exists(self, name: str) -> bool:
        """Tell whether a port has a value now, other than its default."""
        return name in self.literals or (name in self.keys and self.keys[name] in self.blackboard)

    def get(self, name: str) -> Any:  # noqa: ANN401  # of the type that the port declares
        """Return the value that a port has now, or its default if the element does not say it."""
        if name in self.literals:
            return self._converted(name, self.literals[name])
        key = self.keys.get(name)
        if key is not None and key in self.blackboard:
            return self._converted(name, self.blackboard[key])
        if key is None and self._declared[name].has_default:
            return self._declared[name].default_value
        missing = f"there is no {key!r} on the blackboard (yet)" if key else "the element gives it none"
        raise PortError(f"the port {name!r} has no value: {missing}")

    def set(self, name: str, value: object) -> None:
        """Write what a port puts out; a port without a key puts it nowhere."""
        if name in self.keys:
            self.blackboard.make(self.keys[name], self._type(name)).take(value, is_port=True)

    def is_updated(self, name: str) -> bool:
        """Tell whether the entry that a port names, as `{key}` or `key`, was written since this was asked last."""
        entry = self.blackboard.entry(self.keys.get(name) or str(self.get(name)))
        seen, self._seen = self._seen, self._seen if entry is None else entry.version
        return self._seen != seen

    def connect(self, behaviour: PortsMixin) -> None:
        """Connect a behaviour with py_trees' ports to the blackboard of the tree instead of the process's."""
        client = SimpleNamespace(  # stands in for py_trees' client, whose storage is one for the whole process
            register_key=lambda **_: None,
            is_registered=ports_of(behaviour)[0].__contains__,
            absolute_name=lambda key: self.keys.get(key) or key,
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
