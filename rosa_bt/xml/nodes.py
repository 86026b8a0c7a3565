"""The base classes of BehaviorTree.CPP's nodes, the slot that holds a child, and the leaves.

A behaviour of py_trees has one status. BehaviorTree.CPP needs more: a child that has finished stays
finished until its parent resets it, a skipped node is idle, and only a RUNNING node is halted. A
`Slot` keeps this status for each child, so that the children can be plain behaviours of py_trees.
SKIPPED and IDLE are INVALID here, since py_trees has no other status for them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite
from py_trees.decorators import Decorator
from py_trees.ports import PortInformation

from rosa_bt.behaviours import RosaAction, Ticking
from rosa_bt.exceptions import RosaBtError
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS
from rosa_bt.xml.blackboard import Blackboard, Declared, Entry, Ports
from rosa_bt.xml.scripts import parse_script
from rosa_bt.xml.values import EMPTY, as_text, truth

SKIPPED = INVALID
DONE = (SUCCESS, FAILURE)
MAX_NODES = 10_000
"""Most nodes in one tree with all its subtrees, and so also most children of a node."""
ROUNDING_S = 1e-9


class NodeError(RosaBtError, RuntimeError):
    """A node cannot do what it is given; BehaviorTree.CPP throws a LogicError in this case."""


INSTEAD = {"_failureIf": FAILURE, "_successIf": SUCCESS, "_skipIf": SKIPPED}
"""Pre-conditions that are asked before a node starts, with its outcome if they hold."""
RULES = (*INSTEAD, "_while", "_onHalted", "_onFailure", "_onSuccess", "_post")


class Rules:
    """Pre- and post-conditions of a node, by attribute, e.g.

    `_skipIf`, and the blackboard that they use.
    """

    def __init__(self, blackboard: Blackboard, written: Mapping[str, str]) -> None:
        self.blackboard = blackboard
        self.scripts = {name: parse_script(text) for name, text in written.items()}

    def holds(self, name: str, otherwise: bool) -> bool:
        """Return whether a condition holds; `otherwise` if the node has no such condition."""
        return truth(self.scripts[name](self.blackboard)) if name in self.scripts else otherwise

    def outcome(self, status: Status) -> Status | None:
        """Return the outcome that a pre-condition sets for a node of this status.

        None if the node is to be ticked.
        """
        for name, verdict in INSTEAD.items() if status is SKIPPED else ():
            if self.holds(name, False):
                return verdict
        return None if status in DONE or self.holds("_while", True) else SKIPPED

    def follow(self, *names: str) -> None:
        for name in names:
            if name in self.scripts:
                self.scripts[name](self.blackboard)


@dataclass(eq=False)
class Slot:
    """The place of a child in its parent, with the status that BehaviorTree.CPP gives the child."""

    node: Behaviour
    is_condition: bool = False
    """Whether it is a leaf that is ticked again after it has finished; other leaves stay finished
    until a reset."""
    source: tuple[str, Mapping[str, str]] | None = None
    """Tag and attributes of its element; None for a behaviour that was inserted later."""
    rules: Rules | None = None
    status: Status = field(default=INVALID, init=False)
    """Kept until the parent resets it; INVALID means idle."""

    def tick(self) -> Ticking:
        """Tick the child and return its outcome; INVALID if it was skipped."""
        node = self.node
        verdict = self.rules.outcome(self.status) if self.rules else None
        if verdict is not None:
            self.reset()
            node.status = self.status = verdict
            yield node
        elif isinstance(node, XmlNode):
            if self.status is SKIPPED:
                node.initialise()
            if node.runs:
                self.status = RUNNING
            yield from node.tick()
            verdict = node.status
            if verdict is not SKIPPED:  # a skipped node keeps its status until it is reset
                self.status = verdict
        else:
            if self.is_condition or self.status not in DONE:
                yield from node.tick()
                self.status = node.status
            verdict = self.status
        if self.rules and verdict in DONE:
            self.rules.follow("_onSuccess" if verdict is SUCCESS else "_onFailure", "_post")
        return verdict

    def reset(self) -> None:
        """Make the child idle; halt it if it is RUNNING."""
        if self.status is RUNNING:
            if self.node.status is RUNNING or isinstance(self.node, XmlNode):
                self.node.stop(INVALID)
            if self.rules:
                self.rules.follow("_onHalted")
        self.status = SKIPPED

    def wipe(self) -> None:
        """Clear the behaviour's own status after a reset.

        Until the next tick, pictures show the last outcome.
        """
        if self.status is SKIPPED and self.node.status in DONE:
            self.node.status = INVALID


def port(data_type: Any, default: object = None, *, required: bool = True) -> PortInformation:  # noqa: ANN401  # a type of values
    return PortInformation(data_type, required, "", default)


NODES: dict[str, type["Named"]] = {}
"""The nodes of BehaviorTree.CPP and Nav2 by their tags, but for SubTree."""


class Named(Behaviour):
    """A node of a file; each subclass is the node of its name, unless it is said to be none."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar[tuple[int, int]] = (0, 0)
    """Least and greatest number of children."""
    ports: Ports

    def __init_subclass__(cls, *, is_node: bool = True, **ports: PortInformation) -> None:
        if ports:
            cls.PORTS = ports
        if is_node:
            NODES[cls.__name__] = cls

    def __init__(self, name: str, slots: Sequence[Slot]) -> None:
        super().__init__(name)

    def prepare(self, ports: Ports) -> None:
        """Take the ports; raise if a literal is wrong. Called when the node is made."""
        self.ports = ports


class XmlNode(Named, is_node=False):
    """A node with children: made of a name and the places of its children."""

    CHILDREN = (1, MAX_NODES)
    FORGETS: ClassVar[tuple[str, ...]] = ()
    """Names of attributes that return to the value in the class when the node ends or is halted."""
    runs = True
    """Whether a tick makes it RUNNING first, so that it has to be reset even if it was skipped."""
    keeps_finished: ClassVar = True
    """Whether a finished child stays finished after the tick; in a decorator it becomes idle."""

    def __init__(self, name: str, slots: Sequence[Slot]) -> None:
        nodes = [slot.node for slot in slots]
        self._slots = list(slots)
        if isinstance(self, Decorator):
            Decorator.__init__(self, name, nodes[0])
        elif isinstance(self, Composite):
            Composite.__init__(self, name, nodes)

    @property
    def slots(self) -> list[Slot]:
        """The slots of the children; a child that was inserted later has no rules."""
        if [slot.node for slot in self._slots] != self.children:
            by_node = {slot.node: slot for slot in self._slots}
            self._slots = [
                by_node.get(child) or Slot(child, is_plain(child)) for child in self.children
            ]
        return self._slots

    def decide(self) -> Ticking:
        """Do the work of one tick."""
        raise NotImplementedError

    def forget(self) -> None:
        for name in self.FORGETS:
            vars(self).pop(name, None)

    def tick(self) -> Iterator[Behaviour]:
        for slot in self.slots:
            slot.wipe()
        self.status = RUNNING
        verdict = yield from self.decide()
        if not self.keeps_finished and self.slots[0].status in DONE:
            self.slots[0].reset()
        self.status = verdict
        yield self

    def update(self) -> Status:
        return self.status

    def stop(self, new_status: Status = INVALID) -> None:
        """Halt: stop the children that are RUNNING, and forget the state of the node."""
        self.status = self.end(new_status)
        self.iterator = self.tick()

    def end(self, verdict: Status, *kept: Slot) -> Status:
        """Forget the state, make every child idle or halt it, and return the outcome."""
        self.forget()
        self.reset_children(*kept)
        return verdict

    def reset_children(self, *kept: Slot) -> None:
        for slot in self.slots:
            if slot not in kept:
                slot.reset()


class Control(XmlNode, Composite, is_node=False):
    """A node with several children."""

    def tip(self) -> Behaviour | None:
        """Return the tip of the last child that has the same outcome."""
        deciding = [child for child in self.children if child.status is self.status]
        if deciding and self.status is not SKIPPED:
            return deciding[-1].tip()
        return Behaviour.tip(self)


class OneChild(XmlNode, Decorator, is_node=False):
    """A node with one child."""

    CHILDREN = (1, 1)
    keeps_finished = False

    @property
    def child(self) -> Slot:
        return self.slots[0]

    def decide(self) -> Ticking:
        return (yield from self.child.tick())


class Branch(OneChild, is_node=False):
    """Ticks its child; a root for callers that know no slots."""


def is_plain(leaf: Behaviour | type[Behaviour]) -> bool:
    """Tell whether a leaf has neither `initialise` nor `terminate`, so it is a condition."""
    kind = leaf if isinstance(leaf, type) else type(leaf)
    if kind.initialise is not Behaviour.initialise or kind.terminate is not Behaviour.terminate:
        return False
    return not (getattr(leaf, "children", ()) or issubclass(kind, RosaAction))


class AlwaysSuccess(Named):
    """Returns SUCCESS."""

    def update(self) -> Status:
        return SUCCESS


class AlwaysFailure(Named):
    """Returns FAILURE."""

    def update(self) -> Status:
        return FAILURE


class Script(Named, code=port(str)):
    """Runs a script; then SUCCESS."""

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        code = ports.get("code")
        self.script = parse_script(code) if code else lambda board: EMPTY

    def update(self) -> Status:
        self.script(self.ports.blackboard)
        return SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return SUCCESS if truth(self.script(self.ports.blackboard)) else FAILURE


class SetBlackboard(Named, value=port(object), output_key=port(object)):
    """Writes a text, as the declared type of the entry, or copies the value of another key.

    As in BehaviorTree.CPP, if no type is declared, the first text empties the entry, and the second
    raises.
    """

    def update(self) -> Status:
        ports = self.ports
        board = ports.blackboard
        key = as_text(ports.get("output_key"))
        source = Entry(str(ports.literals.get("value")), str)
        if "value" in ports.keys:
            source = board.entry(ports.keys["value"]) or Entry()
        value = source.value
        entry = board.entry(key)
        if value is EMPTY:
            board.make(key)
            return FAILURE
        if entry is None:
            board.make(key, source.declared).put(value)
        elif isinstance(value, str) and (entry.declared is not None or entry.takes_any):
            entry.take(value)
        elif isinstance(value, str):
            if entry.is_emptied or entry.value is EMPTY:
                raise NodeError(
                    f"{key!r} has no declared type, so the type of {value!r} is unknown"
                )
            entry.is_emptied = True
            entry.put(EMPTY)
        elif entry.takes_any or entry.declared in (None, source.declared, type(value)):
            entry.put(value)
        else:
            raise NodeError(f"{key!r} is {entry.declared}, so {value!r} cannot be copied there")
        return SUCCESS


class UnsetBlackboard(Named, key=port(str)):
    """Removes a key from the blackboard of its own tree."""

    def update(self) -> Status:
        self.ports.blackboard.unset(self.ports.get("key"))
        return SUCCESS


class WasEntryUpdated(Named, entry=port(object)):
    """SUCCESS if an entry was written since the last tick of this leaf, else FAILURE."""

    def update(self) -> Status:
        return SUCCESS if self.ports.is_updated("entry") else FAILURE


class Sleep(Named, msec=port(int)):
    """RUNNING for `msec` [ms], then SUCCESS."""

    def initialise(self) -> None:
        self._since = self.ports.blackboard.clock()

    def update(self) -> Status:
        elapsed = self.ports.blackboard.clock() - self._since
        is_over = elapsed >= self.ports.get("msec") / 1000 - ROUNDING_S
        return SUCCESS if is_over else RUNNING
