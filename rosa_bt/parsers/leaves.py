"""The leaves that BehaviorTree.CPP brings along."""

from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation

from rosa_bt.parsers.blackboard import Blackboard
from rosa_bt.parsers.ports import Declared, Ports
from rosa_bt.parsers.scripts import Script, truth
from rosa_bt.parsers.wrappers import Clock

__all__ = ["LEAVES", "Scripted", "Sleep", "XmlLeaf"]


class XmlLeaf(Behaviour):
    """A leaf of BehaviorTree.CPP.

    Args:
        name: what it is called.
        ports: what is said in its attributes.
        blackboard: of the SubTree that it is in.
    """

    PORTS: ClassVar[Declared] = {}

    def __init__(self, name: str, ports: Ports, blackboard: Blackboard) -> None:
        super().__init__(name)
        self.ports = ports
        self.blackboard = blackboard


class AlwaysSuccess(XmlLeaf):
    """SUCCESS."""

    def update(self) -> Status:
        return Status.SUCCESS


class AlwaysFailure(XmlLeaf):
    """FAILURE."""

    def update(self) -> Status:
        return Status.FAILURE


class Scripted(XmlLeaf):
    """A leaf that runs a script.

    Attributes:
        script: what it runs.
    """

    PORTS: ClassVar = {"code": PortInformation(str)}
    script: Script


class RunScript(Scripted):
    """SUCCESS when the script has been run."""

    def update(self) -> Status:
        self.script(self.blackboard)
        return Status.SUCCESS


class ScriptCondition(Scripted):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return Status.SUCCESS if truth(self.script(self.blackboard)) else Status.FAILURE


class SetBlackboard(XmlLeaf):
    """Writes a value, or copies that of another key."""

    PORTS: ClassVar = {"value": PortInformation(object), "output_key": PortInformation(object)}

    def update(self) -> Status:
        self.blackboard[_key(self.ports, "output_key")] = self.ports.get("value")
        return Status.SUCCESS


class UnsetBlackboard(XmlLeaf):
    """Takes a key from the blackboard."""

    PORTS: ClassVar = {"key": PortInformation(object)}

    def update(self) -> Status:
        self.blackboard.pop(_key(self.ports, "key"), None)
        return Status.SUCCESS


class Sleep(XmlLeaf):
    """RUNNING until the time is over, then SUCCESS.

    Attributes:
        clock: gives the time [s].
    """

    PORTS: ClassVar = {"msec": PortInformation(int)}
    clock: Clock

    def initialise(self) -> None:
        """Count the time from now."""
        self._since = self.clock()

    def update(self) -> Status:
        """Tell whether the time is over."""
        is_over = self.clock() - self._since >= self.ports.get("msec") / 1000 - 1e-9
        return Status.SUCCESS if is_over else Status.RUNNING


def _key(ports: Ports, port: str) -> str:
    """Return the key that a port means, written as `{key}` or as `key`."""
    return ports.key(port) or str(ports.get(port))


LEAVES: Final[dict[str, type[XmlLeaf]]] = {
    "AlwaysFailure": AlwaysFailure,
    "AlwaysSuccess": AlwaysSuccess,
    "Script": RunScript,
    "ScriptCondition": ScriptCondition,
    "SetBlackboard": SetBlackboard,
    "Sleep": Sleep,
    "UnsetBlackboard": UnsetBlackboard,
}
