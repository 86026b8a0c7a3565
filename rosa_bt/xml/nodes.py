"""What imported nodes have in common: a place that keeps the status until the parent resets it, and halting; leaves.

A py_trees behaviour knows one status. BehaviorTree.CPP asks more of it: a child that has finished stays finished until
its parent resets it, a node that was skipped is idle, and only what is RUNNING is halted. A `Slot` keeps that for a
child, so that the behaviours themselves stay plain py_trees ones. SKIPPED and IDLE are INVALID here: py_trees has no
other word.
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
"""Nodes in one tree with all its subtrees, at most; and so children of a node."""

Ticking = Generator[Behaviour, None, Status]
"""Yields what is visited on the way, as py_trees' `tick` does, and returns the outcome."""


class NodeError(RosaBtError, RuntimeError):
    """A node was given what it cannot follow; BehaviorTree.CPP throws a LogicError there."""


@dataclass(frozen=True)
class Rules:
    """Pre- and post-conditions of a node by attribute, e.g. `_skipIf`, and the blackboard that they speak of."""

    blackboard: Blackboard
    scripts: Mapping[str, ParsedScript]
    written: Mapping[str, str]

    INSTEAD: ClassVar = {"_failureIf": FAILURE, "_successIf": SUCCESS, "_skipIf": SKIPPED}
    NAMES: ClassVar = (*INSTEAD, "_while", "_onHalted", "_onFailure", "_onSuccess", "_post")

    def outcome(self, status: Status) -> Status | None:
        """Return what a pre-condition says instead of the node of that status; None if the node is to be ticked."""
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
    """The place of a child in its parent."""

    node: Behaviour
    is_condition: bool = False
    """A leaf that is asked again after it has finished; any other leaf stays finished until it is reset."""
    source: tuple[str, Mapping[str, str]] | None = None
    """The tag and the attributes with which it was written; None for a behaviour that came later."""
    rules: Rules | None = None
    status: Status = field(default=Status.INVALID, init=False)
    """INVALID is idle; kept until the parent resets it."""

    def tick(self) -> Ticking:
        """Tick the child; INVALID if it was skipped."""
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
            if verdict is not SKIPPED:  # one that was skipped stays as it is until it is reset
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
        """Make the child idle; halt it if it is running."""
        if self.status is RUNNING:
            if self.node.status is RUNNING or isinstance(self.node, XmlNode):
                self.node.stop(Status.INVALID)
            if self.rules:
                self.rules.follow("_onHalted")
        self.status = SKIPPED

    def wipe(self) -> None:
        """Take away what a child that was reset did before that: pictures show it until the next tick."""
        if self.status is SKIPPED and self.node.status in DONE:
            self.node.status = Status.INVALID


class XmlNode(Behaviour):
    """A node of BehaviorTree.CPP with children: made of a name, the places of its children and its ports."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar[tuple[int, int]] = (1, MAX_NODES)
    """How many it takes, at least and at most."""
    FORGETS: ClassVar[tuple[str, ...]] = ()
    """Names of attributes that begin anew, with the value in the class, when the node has ended or is halted."""
    runs = True
    """Whether a tick makes it RUNNING before it does anything else, so that it has to be reset if skipped."""
    keeps_finished: ClassVar = True
    """Whether a child that has finished stays so after the tick, or is idle again, as in a decorator."""

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        nodes = [slot.node for slot in slots]
        super().__init__(name, nodes[0] if isinstance(self, Decorator) else nodes)  # type: ignore[call-arg]  # of py_trees'
        self._slots, self._seen, self.ports = list(slots), nodes, ports
        self.prepare()

    @property
    def slots(self) -> list[Slot]:
        """The places of the children; one that came later has the rules of the one whose place it took, if any."""
        if self._seen != self.children:
            known = {slot.node: slot for slot in self._slots}
            is_same = len(self._slots) == len(self.children)
            left = [slot.rules if is_same and slot.node not in self.children else None for slot in self._slots]
            self._slots = [
                known.get(child) or Slot(child, is_plain(child), None, left[place] if is_same else None)
                for place, child in enumerate(self.children)
            ]
            self._seen = list(self.children)
        return self._slots

    def prepare(self) -> None:
        """Find wrong literals; called when it is made."""

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
        """Halt: the children that are running, and they only; then forget."""
        self.status = self.end(new_status)
        self.iterator = self.tick()

    def end(self, verdict: Status) -> Status:
        """Forget, make every child idle, halt those that are running, and return the outcome."""
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
        """Return the node that has decided last: below the last child that has the outcome of this one."""
        deciding = [child for child in self.children if child.status is self.status]
        return deciding[-1].tip() if deciding and self.status is not SKIPPED else Behaviour.tip(self)


class OneChild(XmlNode, Decorator):
    """A node with one child."""

    CHILDREN = (1, 1)
    keeps_finished = False

    @property
    def child(self) -> Slot:
        return self.slots[0]


class Branch(OneChild):
    """Its child, for somebody who is not of this kind: the caller of a whole tree, or a decorator of the user's."""

    def decide(self) -> Ticking:
        return (yield from self.child.tick())


def is_plain(leaf: Behaviour | type[Behaviour]) -> bool:
    """Tell whether a leaf keeps nothing from tick to tick: it neither begins nor ends, so it is a condition."""
    kind = leaf if isinstance(leaf, type) else type(leaf)
    begins_or_ends = (kind.initialise, kind.terminate) != (Behaviour.initialise, Behaviour.terminate)
    has_children = isinstance(leaf, Behaviour) and bool(leaf.children)
    return not (begins_or_ends or has_children or issubclass(kind, RosaAction))


class XmlLeaf(Behaviour):
    """A leaf of BehaviorTree.CPP: made of what other nodes are made of, but has no children."""

    PORTS: ClassVar[Declared] = {}
    CHILDREN: ClassVar = (0, 0)

    def __init__(self, name: str, slots: Sequence[Slot], ports: Ports) -> None:
        super().__init__(name)
        self.ports = ports
        self.prepare()

    def prepare(self) -> None:
        """Find wrong literals; called when it is made."""


class Script(XmlLeaf):
    """SUCCESS when the script has been run."""

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
    """Writes a text, read as the type that the entry declares, or copies what another key holds.

    As in BehaviorTree.CPP, a text over an entry of no declared type leaves it empty, and over that it is an error.
    """

    PORTS: ClassVar = {"value": PortInformation(object), "output_key": PortInformation(object)}

    def update(self) -> Status:
        board, key, source = self.ports.blackboard, as_text(self.ports.get("output_key")), self.ports.keys.get("value")
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
