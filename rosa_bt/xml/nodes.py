"""The base classes of BehaviorTree.CPP's nodes, the slot that holds a child, and the leaves.

A behaviour of py_trees has one status. BehaviorTree.CPP needs more: a child that has finished stays finished until its
parent resets it, a skipped node is idle, and only a RUNNING node is halted. A `Slot` keeps this status for each child,
so that the children can be plain behaviours of py_trees. SKIPPED and IDLE are INVALID here, since py_trees has no other
status for them.
"""

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite
from py_trees.decorators import Decorator
from py_trees.ports import PortInformation

from rosa_bt.behaviours import RosaAction
from rosa_bt.exceptions import RosaBtError
from rosa_bt.xml.blackboard import EMPTY, Blackboard, Declared, Entry, Ports, as_text, truth
from rosa_bt.xml.scripts import ParsedScript, parse_script

SUCCESS: Final = Status.SUCCESS
FAILURE: Final = Status.FAILURE
RUNNING: Final = Status.RUNNING
SKIPPED: Final = Status.INVALID
DONE: Final = (SUCCESS, FAILURE)
MAX_NODES: Final = 10_000
"""Most nodes in one tree with all its subtrees, and so also most children of a node."""

Ticking = Generator[Behaviour, None, Status]
"""Yields the nodes that are visited, as `tick` of py_trees does, and returns the outcome."""


class NodeError(RosaBtError, RuntimeError):
    """A node cannot do what it is given; BehaviorTree.CPP throws a LogicError in this case."""


@dataclass(frozen=True)
class Rules:
    """Pre- and post-conditions of a node, by attribute, e.g. `_skipIf`, and the blackboard that they use."""

    blackboard: Blackboard
    scripts: Mapping[str, ParsedScript]
    written: Mapping[str, str]

    INSTEAD: ClassVar = {"_failureIf": FAILURE, "_successIf": SUCCESS, "_skipIf": SKIPPED}
    NAMES: ClassVar = (*INSTEAD, "_while", "_onHalted", "_onFailure", "_onSuccess", "_post")

    def outcome(self, status: Status) -> Status | None:
        """Return the outcome that a pre-condition sets for a node of this status; None if the node is to be ticked."""
        for name, verdict in self.INSTEAD.items() if status is SKIPPED else ():
            if name in self.scripts and truth(self.scripts[name](self.blackboard)):
                return verdict
        if status in (SKIPPED, RUNNING) and "_while" in self.scripts:
            return None if truth(self.scripts["_while"](self.blackboard)) else SKIPPED
        return None

    def follow(self, *names: str) -> None:
        for name in names:
            if name in self.scripts:
                self.scripts[name](self.blackboard)


@dataclass(eq=False)
class Slot:
    """The place of a child in its parent, with the status that BehaviorTree.CPP gives the child."""

    node: Behaviour
    is_condition: bool = False
    """Whether it is a leaf that is ticked again after it has finished; other leaves stay finished until a reset."""
    source: tuple[str, Mapping[str, str]] | None = None
    """Tag and attributes of its element; None for a behaviour that was inserted later."""
    rules: Rules | None = None
    status: Status = field(default=Status.INVALID, init=False)
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
        elif self.is_condition or self.status not in DONE:
            yield from node.tick()
            verdict = self.status = node.status
        else:
            verdict = self.status
        if self.rules and verdict in DONE:
            self.rules.follow("_onSuccess" if verdict is SUCCESS else "_onFailure", "_post")
        return verdict

    def reset(self) -> None:
        """Make the child idle; halt it if it is RUNNING."""
        if self.status is RUNNING:
            if self.node.status is RUNNING or isinstance(self.node, XmlNode):
                self.node.stop(Status.INVALID)
            if self.rules:
                self.rules.follow("_onHalted")
        self.status = SKIPPED

    def wipe(self) -> None:
        """Clear the behaviour's own status after a reset; until the next tick, pictures show the last outcome."""
        if self.status is SKIPPED and self.node.status in DONE:
            self.node.status = Status.INVALID


class XmlNode(Behaviour):
    """A node of BehaviorTree.CPP with children: made of a name, the places of its children and its ports."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar[tuple[int, int]] = (1, MAX_NODES)
    """Least and greatest number of children."""
    FORGETS: ClassVar[tuple[str, ...]] = ()
    """Names of attributes that return to the value in the class when the node ends or is halted."""
    runs = True
    """Whether a tick makes it RUNNING first, so that it has to be reset even if it was skipped."""
    keeps_finished: ClassVar = True
    """Whether a finished child stays finished after the tick; in a decorator it becomes idle."""

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        nodes = [slot.node for slot in slots]
        super().__init__(name, nodes[0] if isinstance(self, Decorator) else nodes)  # type: ignore[call-arg]  # of py_trees'
        self._slots, self._seen, self.ports = list(slots), nodes, ports
        self.prepare()

    @property
    def slots(self) -> list[Slot]:
        """The slots of the children; a child that replaced another one has the rules of that one."""
        if self._seen != self.children:
            known = {slot.node: slot for slot in self._slots}
            is_same = len(self._slots) == len(self.children)
            left = [
                slot.rules if is_same and slot.node not in self.children else None
                for slot in self._slots
            ]
            self._slots = [
                known.get(child)
                or Slot(child, is_plain(child), None, left[place] if is_same else None)
                for place, child in enumerate(self.children)
            ]
            self._seen = list(self.children)
        return self._slots

    def prepare(self) -> None:
        """Raise if a literal is wrong; called when the node is made."""

    def decide(self) -> Ticking:
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

    def stop(self, new_status: Status = Status.INVALID) -> None:
        """Halt: stop the children that are RUNNING, and forget the state of the node."""
        self.status = self.end(new_status)
        self.iterator = self.tick()

    def end(self, verdict: Status) -> Status:
        """Forget the state, make every child idle, halt those that are RUNNING, and return the outcome."""
        self.forget()
        self.reset_children()
        return verdict

    def reset_children(self, but: Slot | None = None) -> None:
        for slot in self.slots:
            if slot is not but:
                slot.reset()


class Control(XmlNode, Composite):
    """A node with several children."""

    def tip(self) -> Behaviour | None:
        """Return the node that decided the outcome: the tip of the last child that has the same outcome."""
        deciding = [child for child in self.children if child.status is self.status]
        return (
            deciding[-1].tip() if deciding and self.status is not SKIPPED else Behaviour.tip(self)
        )


class OneChild(XmlNode, Decorator):
    """A node with one child."""

    CHILDREN = (1, 1)
    keeps_finished = False

    @property
    def child(self) -> Slot:
        return self.slots[0]


class Branch(OneChild):
    """Ticks its child; a root for callers that know no slots: of a whole tree, or in a decorator of the user."""

    def decide(self) -> Ticking:
        return (yield from self.child.tick())


def is_plain(leaf: Behaviour | type[Behaviour]) -> bool:
    """Tell whether a leaf has neither `initialise` nor `terminate`: it keeps nothing, so it is a condition."""
    kind = leaf if isinstance(leaf, type) else type(leaf)
    begins_or_ends = (kind.initialise, kind.terminate) != (
        Behaviour.initialise,
        Behaviour.terminate,
    )
    has_children = isinstance(leaf, Behaviour) and bool(leaf.children)
    return not (begins_or_ends or has_children or issubclass(kind, RosaAction))


class XmlLeaf(Behaviour):
    """A leaf of BehaviorTree.CPP; its constructor has the arguments of other nodes, but `slots` is empty."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar = (0, 0)

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name)
        self.ports = ports
        self.prepare()

    def prepare(self) -> None:
        """Raise if a literal is wrong; called when the leaf is made."""


class Script(XmlLeaf):
    """Runs a script; then SUCCESS."""

    PORTS: ClassVar = {"code": PortInformation(str)}

    def prepare(self) -> None:
        code = self.ports.get("code")
        self.script = parse_script(code) if code else lambda board: EMPTY

    def update(self) -> Status:
        self.script(self.ports.blackboard)
        return Status.SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return Status.SUCCESS if truth(self.script(self.ports.blackboard)) else Status.FAILURE


class SetBlackboard(XmlLeaf):
    """Writes a text, converted to the declared type of the entry, or copies the value of another key.

    As in BehaviorTree.CPP, if no type is declared, the first text empties the entry, and the second raises.
    """

    PORTS: ClassVar = {"value": PortInformation(object), "output_key": PortInformation(object)}

    def update(self) -> Status:
        board, key, source = (
            self.ports.blackboard,
            as_text(self.ports.get("output_key")),
            self.ports.keys.get("value"),
        )
        given = Entry(str(self.ports.get("value")), str) if source is None else board.entry(source)
        if given is None or given.value is EMPTY:
            board.make(key)
            return Status.FAILURE
        entry = board.entry(key)
        if entry is None:
            board.make(key, given.declared).put(given.value)
        elif isinstance(given.value, str) and entry.declared is None and not entry.takes_any:
            if entry.is_emptied or entry.value is EMPTY:
                raise NodeError(
                    f"{key!r} has no declared type, so the type of {given.value!r} is unknown"
                )
            entry.is_emptied = True
            entry.put(EMPTY)
        elif isinstance(given.value, str):
            entry.take(given.value)
        elif entry.takes_any or entry.declared in (None, given.declared, type(given.value)):
            entry.put(given.value)
        else:
            raise NodeError(
                f"{key!r} is declared as {entry.declared}, so {given.value!r} cannot be copied there"
            )
        return Status.SUCCESS


class UnsetBlackboard(XmlLeaf):
    """Removes a key from the blackboard of its own tree."""

    PORTS: ClassVar = {"key": PortInformation(str)}

    def update(self) -> Status:
        self.ports.blackboard.unset(self.ports.get("key"))
        return Status.SUCCESS


class WasEntryUpdated(XmlLeaf):
    """SUCCESS if an entry was written since the last tick of this leaf, else FAILURE."""

    PORTS: ClassVar = {"entry": PortInformation(object)}

    def update(self) -> Status:
        return Status.SUCCESS if self.ports.is_updated("entry") else Status.FAILURE


class Sleep(XmlLeaf):
    """RUNNING for `msec` [ms], then SUCCESS."""

    PORTS: ClassVar = {"msec": PortInformation(int)}

    def initialise(self) -> None:
        self._since = self.ports.blackboard.clock()

    def update(self) -> Status:
        is_over = (
            self.ports.blackboard.clock() - self._since >= self.ports.get("msec") / 1000 - 1e-9
        )
        return Status.SUCCESS if is_over else Status.RUNNING


_KINDS: Final[list[type[XmlLeaf]]] = [
    Script,
    ScriptCondition,
    SetBlackboard,
    Sleep,
    UnsetBlackboard,
    WasEntryUpdated,
]
_CONSTANT: Final = {"AlwaysSuccess": Status.SUCCESS, "AlwaysFailure": Status.FAILURE}
LEAVES: Final[dict[str, type[XmlLeaf]]] = {
    **{
        tag: type(tag, (XmlLeaf,), {"update": lambda self, always=always: always})
        for tag, always in _CONSTANT.items()
    },
    **{kind.__name__: kind for kind in _KINDS},
}
