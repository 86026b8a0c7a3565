"""The base classes of BehaviorTree.CPP's nodes, the slot that holds a child, and the leaves.

A behaviour of py_trees has one status. BehaviorTree.CPP needs more: a child that has finished stays
finished until its parent resets it, a skipped node is idle, and only a RUNNING node is halted. A
`Slot` keeps this status for each child, so that the children can be plain behaviours of py_trees.
SKIPPED and IDLE are INVALID here, since py_trees has no other status for them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite
from py_trees.decorators import Decorator
from py_trees.ports import PortInformation

from rosa_bt.behaviours import RosaAction, Ticking
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS
from rosa_bt.xml.blackboard import Declared, Entry, NodeError, Ports, Value, as_text, truth
from rosa_bt.xml.scripts import ParsedScript, parse_script

SKIPPED = INVALID
DONE = (SUCCESS, FAILURE)
ROUNDING_S = 1e-9
INSTEAD = {"_failureIf": FAILURE, "_successIf": SUCCESS, "_skipIf": SKIPPED}
"""Pre-conditions that are asked before a node starts, with its outcome if they hold."""
RULES = (*INSTEAD, "_while", "_onHalted", "_onFailure", "_onSuccess", "_post")


@dataclass(eq=False)
class Slot:
    """The place of a child in its parent, with the status that BehaviorTree.CPP gives the child."""

    node: Behaviour
    is_condition: bool = False
    """Whether it is a leaf that is ticked again after it has finished; other leaves stay finished
    until a reset."""
    source: tuple[str, Mapping[str, str]] | None = None
    """Tag and attributes of its element; None for a behaviour that was inserted later."""
    rules: Mapping[str, ParsedScript] = field(default_factory=dict)
    """Pre- and post-conditions, by attribute, e.g. `_skipIf`."""
    status: Status = field(default=INVALID, init=False)
    """Kept until the parent resets it; INVALID means idle."""

    def tick(self) -> Ticking:
        """Tick the child and return its outcome; INVALID if it was skipped."""
        node = self.node
        verdict = self._instead()
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
        if verdict in DONE:
            self._follow("_onSuccess" if verdict is SUCCESS else "_onFailure")
            self._follow("_post")
        return verdict

    def _instead(self) -> Status | None:
        """Return the outcome that a pre-condition sets; None if the node is to be ticked."""
        for rule, verdict in INSTEAD.items() if self.status is SKIPPED else ():
            if truth(self._follow(rule, False)):
                return verdict
        return None if self.status in DONE or truth(self._follow("_while", True)) else SKIPPED

    def _follow(self, rule: str, otherwise: Value = None) -> Value:
        """Run the script of a rule, if the node has it, and return its value."""
        return self.rules[rule]() if rule in self.rules else otherwise

    def reset(self) -> None:
        """Make the child idle; halt it if it is RUNNING."""
        if self.status is RUNNING:
            if self.node.status is RUNNING or isinstance(self.node, XmlNode):
                self.node.stop(INVALID)
            self._follow("_onHalted")
        self.status = SKIPPED


def port(data_type: Any, default: object = None, *, required: bool = True) -> PortInformation:  # noqa: ANN401  # a type of values
    return PortInformation(data_type, required, "", default)


NODES: dict[str, type["Named"]] = {}
"""The nodes of BehaviorTree.CPP and Nav2 by their tags, but for SubTree."""


class Named(Behaviour):
    """A node of a file; each subclass is the node of its name, unless it is said to be none."""

    PORTS: ClassVar[Declared] = {}
    """The type of a port is None if it declares none for its entry."""
    CHILDREN: ClassVar[tuple[float, float]] = (0, 0)
    """Least and greatest number of children."""
    ports: Ports

    def __init_subclass__(cls, *, is_node: bool = True, **ports: PortInformation) -> None:
        if ports:
            cls.PORTS = ports
        if is_node:
            NODES[cls.__name__] = cls

    def prepare(self, ports: Ports) -> None:
        """Take the ports; raise if a literal is wrong. Called when the node is made."""
        self.ports = ports


class XmlNode(Named, is_node=False):
    """A node with children: made of a name and the places of its children."""

    CHILDREN = (1, inf)
    FORGETS: ClassVar[tuple[str, ...]] = ()
    """Names of attributes that return to the value in the class when the node ends or is halted."""
    runs = True
    """Whether a tick makes it RUNNING first, so that it has to be reset even if it was skipped."""

    def __init__(self, name: str, slots: Sequence[Slot]) -> None:
        self._slots = {slot.node: slot for slot in slots}
        nodes = list(self._slots)
        super().__init__(name, nodes if isinstance(self, Composite) else nodes[0])  # type: ignore[call-arg]  # of the composite or decorator

    @property
    def slots(self) -> list[Slot]:
        """The slots of the children; a child that was inserted later has no rules."""
        for child in self.children:
            if child not in self._slots:
                self._slots[child] = Slot(child, is_plain(child))
        return [self._slots[child] for child in self.children]

    def decide(self) -> Ticking:
        """Do the work of one tick."""
        raise NotImplementedError

    def forget(self) -> None:
        for name in self.FORGETS:
            vars(self).pop(name, None)

    def tick(self) -> Iterator[Behaviour]:
        for slot in self.slots:
            if slot.status is SKIPPED:  # until now, pictures show the last outcome
                slot.node.status = INVALID
        self.status = RUNNING
        self.status = yield from self.decide()
        yield self

    def update(self) -> Status:
        return self.status

    def stop(self, new_status: Status = INVALID) -> None:
        """Halt: stop the children that are RUNNING, and forget the state of the node."""
        self.status = self.end(new_status)

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
        for child in reversed(self.children):
            if child.status is self.status is not SKIPPED:
                return child.tip()
        return Behaviour.tip(self)


class OneChild(XmlNode, Decorator, is_node=False):
    """A node with one child, which becomes idle when it has finished."""

    CHILDREN = (1, 1)

    @property
    def child(self) -> Slot:
        return self.slots[0]

    def decide(self) -> Ticking:
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.child.reset()
        return verdict


class Branch(OneChild, is_node=False):
    """Ticks its child; a root for callers that know no slots."""


def is_plain(leaf: Behaviour) -> bool:
    """Tell whether a leaf has neither `initialise` nor `terminate`, so it is a condition."""
    kind = type(leaf)
    hooks = (kind.initialise, kind.terminate)
    has_hooks = hooks != (Behaviour.initialise, Behaviour.terminate)
    return not (has_hooks or leaf.children or isinstance(leaf, RosaAction))


class AlwaysSuccess(Named):
    """Returns SUCCESS."""

    outcome = SUCCESS

    def update(self) -> Status:
        return self.outcome


class AlwaysFailure(AlwaysSuccess):
    """Returns FAILURE."""

    outcome = FAILURE


class Script(Named, code=port(str)):
    """Runs a script; then SUCCESS."""

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        self.script = parse_script(ports.get("code"), ports.blackboard)

    def update(self) -> Status:
        self.script()
        return SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return SUCCESS if truth(self.script()) else FAILURE


class SetBlackboard(Named, value=port(None), output_key=port(None)):
    """Writes a text, as the declared type of the entry, or copies the value of another key.

    As in BehaviorTree.CPP, if no type is declared, the first text empties the entry, and the second
    raises.
    """

    def update(self) -> Status:
        ports = self.ports
        board = ports.blackboard
        key = as_text(ports.get("output_key"))
        source = Entry(ports.literals.get("value"), str)
        if "value" in ports.keys:
            source = board.entry(ports.keys["value"]) or Entry()
        value = source.value
        is_new = board.entry(key) is None
        entry = board.make(key, None if value is None else source.declared)
        if value is None:
            return FAILURE
        if is_new:
            entry.put(value)
        elif entry.declared is None and isinstance(value, str):
            if entry.is_emptied or entry.value is None:
                raise NodeError(f"{key!r} has no declared type, so that of {value!r} is unknown")
            entry.is_emptied = True
            entry.put(None)
        elif entry.declared is str and not isinstance(value, str):
            raise NodeError(f"{key!r} is a text, so {value!r} cannot be copied there")
        else:
            entry.take(value)
        return SUCCESS


class UnsetBlackboard(Named, key=port(str)):
    """Removes a key from the blackboard of its own tree."""

    def update(self) -> Status:
        del self.ports.blackboard[self.ports.get("key")]
        return SUCCESS


class WasEntryUpdated(Named, entry=port(None)):
    """SUCCESS if an entry was written since the last tick of this leaf, else FAILURE."""

    def update(self) -> Status:
        return SUCCESS if self.ports.is_updated("entry") else FAILURE


class Sleep(Named, msec=port(int)):
    """RUNNING for `msec` [ms], then SUCCESS."""

    def initialise(self) -> None:
        self._since = self.ports.blackboard.root.clock()

    def update(self) -> Status:
        elapsed = self.ports.blackboard.root.clock() - self._since
        is_over = elapsed >= self.ports.get("msec") / 1000 - ROUNDING_S
        return SUCCESS if is_over else RUNNING
