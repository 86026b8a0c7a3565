"""The leaves that BehaviorTree.CPP brings along."""

from collections.abc import Sequence
from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.xml.nodes import Slot
from rosa_bt.xml.ports import Declared, Ports
from rosa_bt.xml.scripts import parse_script, truth


class XmlLeaf(Behaviour):
    """A leaf of BehaviorTree.CPP: made of what other nodes are made of, but has no children."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar = (0, 0)

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name)
        self.ports = ports

    def key(self, port: str) -> str:
        """Return the key that a port means, written as `{key}` or as `key`."""
        return self.ports.key(port) or str(self.ports.get(port))


class AlwaysSuccess(XmlLeaf):
    """SUCCESS."""

    def update(self) -> Status:
        return Status.SUCCESS


class AlwaysFailure(XmlLeaf):
    """FAILURE."""

    def update(self) -> Status:
        return Status.FAILURE


class Script(XmlLeaf):
    """SUCCESS when the script has been run."""

    PORTS: ClassVar = {"code": PortInformation(str)}

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name, slots, ports)
        self.script = parse_script(ports.get("code"))

    def update(self) -> Status:
        self.script(self.ports.blackboard)
        return Status.SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return Status.SUCCESS if truth(self.script(self.ports.blackboard)) else Status.FAILURE


class SetBlackboard(XmlLeaf):
    """Writes a value, or copies that of another key."""

    PORTS: ClassVar = {"value": PortInformation(object), "output_key": PortInformation(object)}

    def update(self) -> Status:
        self.ports.blackboard[self.key("output_key")] = self.ports.get("value")
        return Status.SUCCESS


class UnsetBlackboard(XmlLeaf):
    """Takes a key from the blackboard."""

    PORTS: ClassVar = {"key": PortInformation(object)}

    def update(self) -> Status:
        self.ports.blackboard.pop(self.key("key"), None)
        return Status.SUCCESS


class Sleep(XmlLeaf):
    """RUNNING until the time is over, then SUCCESS."""

    PORTS: ClassVar = {"msec": PortInformation(int)}

    def initialise(self) -> None:
        self._since = self.ports.clock()

    def update(self) -> Status:
        is_over = self.ports.clock() - self._since >= self.ports.get("msec") / 1000 - 1e-9
        return Status.SUCCESS if is_over else Status.RUNNING


_KINDS: Final = (AlwaysFailure, AlwaysSuccess, Script, ScriptCondition, SetBlackboard, Sleep, UnsetBlackboard)
LEAVES: Final[dict[str, type[XmlLeaf]]] = {kind.__name__: kind for kind in _KINDS}
"""By tag."""
