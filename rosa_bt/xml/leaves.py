"""The leaves that BehaviorTree.CPP brings along."""

from collections.abc import Sequence
from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.blackboard import EMPTY, Declared, Entry, Ports, as_text, truth
from rosa_bt.xml.nodes import NodeError, Slot
from rosa_bt.xml.scripts import parse_script


class XmlLeaf(Behaviour):
    """A leaf of BehaviorTree.CPP: made of what other nodes are made of, but has no children."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar = (0, 0)

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name)
        self.ports = ports


class Script(XmlLeaf):
    """SUCCESS when the script has been run."""

    PORTS: ClassVar = {"code": PortInformation(str)}

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name, slots, ports)
        code = ports.get("code")
        self.script = parse_script(code) if code else lambda board: EMPTY

    def update(self) -> Status:
        self.script(self.ports.blackboard)
        return Status.SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return Status.SUCCESS if truth(self.script(self.ports.blackboard)) else Status.FAILURE


class SetBlackboard(XmlLeaf):
    """Writes a text, read as the type that the entry declares, or copies what another key holds.

    As in BehaviorTree.CPP, a text over an entry of no declared type leaves it empty, and over that it is an error.
    """

    PORTS: ClassVar = {"value": PortInformation(object), "output_key": PortInformation(object)}

    def update(self) -> Status:
        board, key, source = self.ports.blackboard, as_text(self.ports.get("output_key")), self.ports.key("value")
        given = Entry(str(self.ports.get("value")), str) if source is None else board.entry(source)
        if given is None or given.value is EMPTY:
            board.make(key)
            return Status.FAILURE
        entry = board.entry(key)
        if entry is None:
            board.make(key, given.declared).put(given.value)
        elif isinstance(given.value, str) and entry.declared is None:
            if entry.is_emptied or entry.value is EMPTY:
                raise NodeError(f"{key!r} has no declared type, so it cannot be said what {given.value!r} is")
            entry.is_emptied = True
            entry.put(EMPTY)
        elif isinstance(given.value, str):
            entry.take(given.value)
        elif entry.declared in (None, given.declared, type(given.value)):
            entry.put(given.value)
        else:
            raise NodeError(f"{key!r} is declared as {entry.declared}, so {given.value!r} cannot be copied there")
        return Status.SUCCESS


class UnsetBlackboard(XmlLeaf):
    """Takes a key from the blackboard of its own tree."""

    PORTS: ClassVar = {"key": PortInformation(str)}

    def update(self) -> Status:
        self.ports.blackboard.unset(self.ports.get("key"))
        return Status.SUCCESS


class WasEntryUpdated(XmlLeaf):
    """SUCCESS if an entry was written since this was ticked last, FAILURE if not, or never."""

    PORTS: ClassVar = {"entry": PortInformation(object)}

    def update(self) -> Status:
        return Status.SUCCESS if self.ports.is_updated("entry") else Status.FAILURE


class Sleep(XmlLeaf):
    """RUNNING until the time is over, then SUCCESS."""

    PORTS: ClassVar = {"msec": PortInformation(int)}

    def initialise(self) -> None:
        self._since = self.ports.clock()

    def update(self) -> Status:
        is_over = self.ports.clock() - self._since >= self.ports.get("msec") / 1000 - 1e-9
        return Status.SUCCESS if is_over else Status.RUNNING


_KINDS: Final[list[type[XmlLeaf]]] = [Script, ScriptCondition, SetBlackboard, Sleep, UnsetBlackboard, WasEntryUpdated]
_CONSTANT: Final = {"AlwaysSuccess": Status.SUCCESS, "AlwaysFailure": Status.FAILURE}
LEAVES: Final[dict[str, type[XmlLeaf]]] = {
    **{tag: type(tag, (XmlLeaf,), {"update": lambda self, always=always: always}) for tag, always in _CONSTANT.items()},
    **{kind.__name__: kind for kind in _KINDS},
}
