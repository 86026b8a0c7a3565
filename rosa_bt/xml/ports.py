"""Ports: what a node declares, filled with what its element says: literals, or keys of the blackboard."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Final, get_origin

from py_trees.ports import PortInformation, PortsMixin
from py_trees.ports_utils import is_instance_of_type

from rosa_bt.exceptions import hint
from rosa_bt.xml.blackboard import SCALARS, Blackboard, Outcome, PortError, cast, converted, is_number

Declared = Mapping[str, PortInformation]
"""Which ports a node has."""


def key_of(written: str, port: str) -> str | None:
    """Return the key that a port's text points at: `{key}`, or `{=}` for the port's own name; None for a literal."""
    written = written.strip()
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    return port if written[1:-1] == "=" else written[1:-1]


class Ports:
    """The ports that a node declares, as the attributes of its element fill them.

    Raises:
        PortError: an attribute is no port of it, a literal is of another type, or a key was declared of another type.
    """

    def __init__(self, declared: Declared, written: Mapping[str, str], blackboard: Blackboard) -> None:
        self.blackboard: Final = blackboard
        self.clock: Final = blackboard.clock
        self._declared = declared
        self._keys: dict[str, str] = {}
        self._literals: dict[str, Any] = {}
        self._seen = 0
        for name, text in written.items():
            if name not in declared:
                raise PortError(f"it has no port {name!r}; {hint(name, declared, 'ports')}")
            key = key_of(text, name)
            if key is None:
                is_late = declared[name].data_type is Outcome
                self._literals[name] = text if is_late else self._converted(name, text)
            else:
                self._keys[name] = key
                self._declare(name, key)

    def _declare(self, name: str, key: str) -> None:
        wanted = self._declared[name].data_type
        wanted = None if wanted in (Any, object) else wanted
        entry = self.blackboard.entry(key)
        if entry is None:
            self.blackboard.make(key, wanted)
        elif None not in (wanted, entry.declared) and wanted != entry.declared and entry.declared is not str:
            before, now = (getattr(one, "__name__", str(one)) for one in (entry.declared, wanted))
            raise PortError(f"{{{key}}} is declared as {before} already, and {name!r} declares it as {now}")

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
        """Return the value that a port has now, or its default if the element does not say it."""
        if name in self._literals:
            value = self._literals[name]
            return self._converted(name, value) if self._declared[name].data_type is Outcome else value
        key = self._keys.get(name)
        if key is not None and key in self.blackboard:
            return self._converted(name, self.blackboard[key])
        if key is None and self._declared[name].has_default:
            return self._declared[name].default_value
        missing = f"there is no {key!r} on the blackboard (yet)" if key else "the element gives it none"
        raise PortError(f"the port {name!r} has no value: {missing}")

    def set(self, name: str, value: object) -> None:
        """Write what a port puts out; a port without a key puts it nowhere."""
        key = self._keys.get(name)
        entry = None if key is None else self.blackboard.entry(key)
        if entry is not None:
            entry.take(value, is_port=True)
        elif key is not None:
            self.blackboard[key] = value

    def key(self, name: str) -> str | None:
        """Return the key that a port points at; None for a literal or nothing."""
        return self._keys.get(name)

    def is_literal(self, name: str) -> bool:
        """Tell whether a port is given a value in the element itself."""
        return name in self._literals

    def is_updated(self, name: str) -> bool:
        """Tell whether the entry that a port names, as `{key}` or `key`, was written since this was asked last."""
        entry = self.blackboard.entry(self.key(name) or str(self.get(name)))
        seen, self._seen = self._seen, self._seen if entry is None else entry.version
        return self._seen != seen

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
        if wanted in (Any, object):
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
