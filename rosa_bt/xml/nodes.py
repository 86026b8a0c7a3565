"""The nodes of BehaviorTree.CPP 4.10 and of Nav2 1.5.1, and the slot that holds a child.

A behaviour of py_trees has one status. BehaviorTree.CPP needs more: a child that has finished stays
finished until its parent resets it, a skipped node is idle, and only a RUNNING node is halted. A
`Slot` keeps this status for each child, so that the children can be plain behaviours of py_trees.
SKIPPED and IDLE are INVALID here, since py_trees has no other status for them.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from types import GenericAlias
from typing import ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite
from py_trees.ports import PortInformation

from rosa_bt.behaviours import RosaAction, Ticking
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS
from rosa_bt.xml.blackboard import (
    Declared,
    Entry,
    NodeError,
    Ports,
    Value,
    as_text,
    convert,
    truth,
)
from rosa_bt.xml.scripts import ParsedScript, is_equal, parse_script

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
    """Whether it is ticked again after it has finished; others stay finished until a reset."""
    source: tuple[str, Mapping[str, str]] | None = None
    """Tag and attributes of its element; None for a behaviour that was inserted later."""
    rules: Mapping[str, ParsedScript] = field(default_factory=dict)
    """Pre- and post-conditions, by attribute, e.g. `_skipIf`."""
    status: Status = INVALID
    """Kept until the parent resets it; INVALID means idle."""

    def tick(self) -> Ticking:
        """Tick the child and return its outcome; INVALID if it was skipped."""
        node = self.node
        verdict = self._instead() if self.rules else None
        if verdict is not None:
            self.reset()
            node.status = self.status = verdict
            yield node
        else:
            if isinstance(node, XmlNode):
                if self.status is SKIPPED:
                    node.initialise()
                if node.runs:
                    self.status = RUNNING
            if self.is_condition or self.status not in DONE:
                yield from node.tick()
            verdict = node.status
            if verdict is not SKIPPED:  # a skipped node keeps its status until it is reset
                self.status = verdict
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


NODES: dict[str, type["Named"]] = {}
"""The nodes of BehaviorTree.CPP and Nav2 by their tags, but for SubTree."""


def _port(declared: object) -> PortInformation:
    if declared is None or isinstance(declared, type):
        return PortInformation(declared)
    return PortInformation(type(declared), default_value=declared)


class Named(Behaviour):
    """A node of a file; each subclass is the node of its name, unless it is said to be none."""

    PORTS: ClassVar[Declared] = {}
    """The type of a port is None if it declares none for its entry."""
    arity: ClassVar[tuple[float, float]] = (0, 0)
    """Least and greatest number of children."""
    ports: Ports
    _since: float | None = None

    def __init_subclass__(cls, *, is_node: bool = True, **ports: object) -> None:
        """Declare ports: by a type, None for any, or by a default value of the type."""
        if ports:
            cls.PORTS = {name: _port(declared) for name, declared in ports.items()}
        if is_node:
            NODES[cls.__name__] = cls

    def prepare(self, ports: Ports) -> None:
        """Take the ports; raise if a literal is wrong. Called when the node is made."""
        self.ports = ports

    def now(self) -> float:
        """Return the time by the clock of the whole tree [s]."""
        return self.ports.blackboard.root.clock()

    def is_over(self) -> bool:
        """Start the time if it is not started; tell whether the first port [ms] has passed."""
        now = self.now()
        if self._since is None:
            self._since = now
        return bool(now - self._since >= self.ports.get(*self.PORTS) / 1000 - ROUNDING_S)


class XmlNode(Named, Composite, is_node=False):
    """A node with children: made of a name and the places of its children."""

    arity = (1, inf)
    runs = True
    """Whether a tick makes it RUNNING first, so that it has to be reset even if it was skipped."""

    def __init__(self, name: str, slots: list[Slot]) -> None:
        self._slots = {slot.node: slot for slot in slots}
        super().__init__(name, list(self._slots))

    @property
    def slots(self) -> list[Slot]:
        """The slots of the children; a child that was inserted later has no rules."""
        for child in self.children:
            if child not in self._slots:
                self._slots[child] = Slot(child, is_plain(child))
        return [self._slots[child] for child in self.children]

    @property
    def child(self) -> Slot:
        """The slot of the first child."""
        return self.slots[0]

    def decide(self) -> Ticking:
        """Do the work of one tick; by default, that of a node with one child."""
        verdict = yield from self.child.tick()
        if verdict in DONE:
            self.child.reset()
        return verdict

    def forget(self) -> None:
        """Return attributes that begin with an underscore to the values in the class."""
        for name in list(vars(self)):
            if name.startswith("_") and hasattr(type(self), name):
                delattr(self, name)

    def tick(self) -> Iterator[Behaviour]:
        for slot in self.slots:
            if slot.status is SKIPPED:  # until now, pictures show the last outcome
                slot.node.status = INVALID
        self.status = RUNNING
        self.status = yield from self.decide()
        yield self

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

    def tip(self) -> Behaviour | None:
        """Return the tip of the last child that has the same outcome."""
        for child in reversed(self.children):
            if child.status is self.status is not SKIPPED:
                return child.tip()
        return Behaviour.tip(self)


class OneChild(XmlNode, is_node=False):
    """A node with one child, which becomes idle when it has finished.

    By itself, a root for callers that know no slots.
    """

    arity = (1, 1)


def is_plain(leaf: Behaviour) -> bool:
    """Tell whether it is a node, or has neither `initialise` nor `terminate`, as conditions."""
    kind = type(leaf)
    hooks = (kind.initialise, kind.terminate)
    has_hooks = hooks != (Behaviour.initialise, Behaviour.terminate)
    is_other = has_hooks or leaf.children or isinstance(leaf, RosaAction)
    return isinstance(leaf, XmlNode) or not is_other


class AlwaysSuccess(Named):
    """Returns SUCCESS."""

    outcome = SUCCESS

    def update(self) -> Status:
        return self.outcome


class AlwaysFailure(AlwaysSuccess):
    """Returns FAILURE."""

    outcome = FAILURE


class Scripted(Named, is_node=False):
    """A node whose first port has a script."""

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        code, *_ = self.PORTS
        self.script = parse_script(ports.get(code), ports.blackboard)


class Script(Scripted, code=str):
    """Runs a script; then SUCCESS."""

    def update(self) -> Status:
        self.script()
        return SUCCESS


class ScriptCondition(Script):
    """SUCCESS if the script is true, FAILURE if it is false."""

    def update(self) -> Status:
        return SUCCESS if truth(self.script()) else FAILURE


class SetBlackboard(Named, value=None, output_key=None):
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


class UnsetBlackboard(Named, key=str):
    """Removes a key from the blackboard of its own tree."""

    def update(self) -> Status:
        del self.ports.blackboard[self.ports.get("key")]
        return SUCCESS


class WasEntryUpdated(Named, entry=None):
    """SUCCESS if an entry was written since the last tick of this leaf, else FAILURE."""

    def update(self) -> Status:
        return SUCCESS if self.ports.is_updated("entry") else FAILURE


class Sleep(Named, msec=int):
    """RUNNING for `msec` [ms], then SUCCESS."""

    def initialise(self) -> None:
        self._since = None

    def update(self) -> Status:
        return SUCCESS if self.is_over() else RUNNING


class Sequence(XmlNode):
    """Ticks one child after the other; `current_child` is the next one to tick, None the first.

    Attributes:
        goes_on: the outcome of a child after which the next child is ticked.
        is_reactive: tick the children from the first in each tick.
        is_async: be RUNNING for a tick after a child that ended in its first tick.
        keeps_place: keep `current_child` also when a child ends the node, and when the node is
            halted.
    """

    goes_on = SUCCESS
    is_reactive = False
    is_async = False
    keeps_place = False
    _skipped = 0

    def forget(self) -> None:
        super().forget()
        if not self.keeps_place:
            self.current_child = None

    def decide(self) -> Ticking:
        return (yield from self.tick_in_order(self.slots))

    def tick_in_order(self, slots: list[Slot]) -> Ticking:
        start = 0
        if self.is_reactive:
            self._skipped = 0
        elif self.current_child in self.children:
            start = self.children.index(self.current_child)
        for place, slot in enumerate(slots[start:], start):
            self.current_child = slot.node
            was_idle = slot.status is SKIPPED
            verdict = yield from slot.tick()
            if verdict is RUNNING:
                if self.waits_for(place):
                    return RUNNING
            elif verdict is SKIPPED:
                self._skipped += 1
                if self.is_reactive:
                    slot.reset()
            elif verdict is not self.goes_on:
                return self.end(verdict, *(slots[:place] if self.keeps_place else ()))
            elif self.is_async and was_idle and slot is not slots[-1]:
                self.current_child = slots[place + 1].node
                return RUNNING
        is_skipped = self._skipped == len(slots)
        self.current_child = None
        return self.end(SKIPPED if is_skipped else self.goes_on)

    def waits_for(self, place: int) -> bool:
        """Tell whether the tick ends at this child, which is RUNNING."""
        if self.is_reactive:
            self.reset_children(self.slots[place])
        return True


class AsyncSequence(Sequence):
    """Is RUNNING for a tick after each child."""

    is_async = True


class SequenceWithMemory(AsyncSequence):
    """Goes on where it was, also after a failure or a halt."""

    keeps_place = True


class Fallback(Sequence):
    """Goes on after a failure."""

    goes_on = FAILURE


class AsyncFallback(Fallback):
    """Is RUNNING for a tick after each child."""

    is_async = True


class ReactiveSequence(Sequence):
    """Ticks the children from the first in each tick.

    A running child resets and halts all others.
    """

    is_reactive = True


class ReactiveFallback(ReactiveSequence):
    """Goes on after a failure."""

    goes_on = FAILURE


class PipelineSequence(ReactiveSequence):
    """A sequence that ticks earlier children again, and goes on even if one is RUNNING then."""

    is_side_by_side = True
    _furthest = 0

    def waits_for(self, place: int) -> bool:
        is_late = place >= self._furthest
        self._furthest = max(place, self._furthest)
        return is_late


class Parallel(XmlNode, success_count=-1, failure_count=1):
    """Ends as soon as enough children have succeeded or failed.

    The others are halted, or no longer ticked.
    """

    is_side_by_side = True

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        for name in ports.literals:
            self._threshold(name)

    def decide(self) -> Ticking:
        thresholds = [self._threshold(name) for name in self.PORTS]
        skipped = 0
        for slot in self.slots:
            if slot.status not in DONE:
                skipped += (yield from slot.tick()) is SKIPPED
            ended = [slot.status for slot in self.slots if slot.status in DONE]
            verdict = self.judge(ended, skipped, *thresholds)
            if verdict is not None:
                return self.end(verdict)
        return SKIPPED if skipped == len(self.children) else RUNNING

    def judge(
        self, ended: list[Status], skipped: int, successes: int, failures: int
    ) -> Status | None:
        """Return the outcome after a child was ticked, None if it is open."""
        failed = ended.count(FAILURE)
        counted = skipped if self.ports.get("success_count") < 0 else 0
        if ended.count(SUCCESS) + counted >= successes:
            return SUCCESS
        is_over = len(self.children) - failed < successes or failed == failures
        return FAILURE if is_over else None

    def _threshold(self, name: str) -> int:
        """Return the number of children in a port.

        A negative number counts from the end: -1 means all children.
        """
        count = len(self.children)
        number: int = self.ports.get(name)
        if number > count:
            raise NodeError(f"{self.name!r} has {count} children; {name} cannot be more")
        return number if number >= 0 else max(count + number + 1, 0)


class ParallelAll(Parallel, max_failures=1):
    """Ends when all children have finished: FAILURE if `max_failures` of them failed."""

    def judge(self, ended: list[Status], skipped: int, failures: int) -> Status | None:  # type: ignore[override]  # as many as PORTS
        if not ended or skipped + len(ended) < len(self.children):
            return None
        return FAILURE if ended.count(FAILURE) >= failures else SUCCESS


class IfThenElse(XmlNode):
    """Ticks the first child as a condition.

    If it succeeds, the second child, and if it fails, the third.

    Once it has ended, only the chosen child is ticked; but with `asks_always`, it is ticked in each
    tick.
    """

    arity = (2, 3)
    asks_always = False
    _chosen = 0

    def decide(self) -> Ticking:
        slots = self.slots
        if self.asks_always or not self._chosen:
            verdict = yield from slots[0].tick()
            if verdict is RUNNING:
                return RUNNING
            if verdict is SKIPPED:
                raise NodeError(
                    f"the condition of {self.name!r} was skipped: what is to be chosen?"
                )
            chosen = 1 if verdict is SUCCESS else 2
            if self.asks_always:
                self.reset_children(slots[0], *slots[chosen : chosen + 1])
            if chosen == len(
                slots
            ):  # IfThenElse leaves the condition finished: it is not started again
                return self.end(FAILURE) if self.asks_always else FAILURE
            self._chosen = chosen
        verdict = yield from slots[self._chosen].tick()
        return verdict if verdict is RUNNING else self.end(verdict)


class WhileDoElse(IfThenElse):
    """Ticks the condition in each tick."""

    asks_always = True


class Switch(XmlNode, is_node=False):
    """Ticks the child whose case equals the variable, or else the last.

    There is a class for each number of cases.
    """

    runs = False

    def decide(self) -> Ticking:
        *cases, chosen = self.slots
        for number in range(len(cases), 0, -1):
            if self._matches(f"case_{number}"):
                chosen = cases[number - 1]
        self.reset_children(chosen)
        verdict = yield from chosen.tick()
        if verdict in DONE:
            self.reset_children()
        return verdict

    def _matches(self, case: str) -> bool:
        """Tell whether a case equals the variable, as a text or as the number it begins with."""
        enums = self.ports.blackboard.root.enums
        for kind in (str, int, float):
            with suppress(NodeError):
                sides = [self.ports.get(name) for name in ("variable", case)]
                left, right = [convert(str(enums.get(side, side)), kind) for side in sides]
                if left == right:
                    return True
        return False


for _count in range(3, 8):
    _cases = dict.fromkeys((f"case_{number}" for number in range(1, _count)), "\0")
    type(f"Switch{_count - 1}", (Switch,), {"arity": (_count, _count)}, variable="", **_cases)


class TryCatch(Sequence, catch_on_halt=False):
    """A sequence of all but the last child.

    If one fails, the last child is ticked to its end: then FAILURE.

    With `catch_on_halt`, the last child is also ticked once when the node is halted before a child
    has failed.
    """

    arity = (2, inf)
    _has_failed = False

    def decide(self) -> Ticking:
        *tried, last = self.slots
        if not self._has_failed:
            verdict = yield from self.tick_in_order(tried)
            if verdict is not FAILURE:
                return verdict
            self._has_failed = True
        verdict = yield from last.tick()
        return RUNNING if verdict is RUNNING else self.end(FAILURE)

    def stop(self, new_status: Status = SKIPPED) -> None:
        last = self.slots[-1]
        if self.ports.get("catch_on_halt") and not self._has_failed:
            self.reset_children(last)
            for _ in last.tick():
                pass
        super().stop(new_status)


class Translator(OneChild, is_node=False):
    """Returns another outcome for some outcomes of the child."""

    success = SUCCESS
    failure = FAILURE
    skipped = SKIPPED

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        outcomes = {SUCCESS: self.success, FAILURE: self.failure, SKIPPED: self.skipped}
        return outcomes.get(verdict, verdict)


class Inverter(Translator):
    """Returns SUCCESS for FAILURE, and FAILURE for SUCCESS."""

    success = FAILURE
    failure = SUCCESS


class ForceSuccess(Translator):
    """Returns SUCCESS for FAILURE."""

    failure = SUCCESS


class ForceFailure(Translator):
    """Returns FAILURE for SUCCESS."""

    success = FAILURE


class KeepRunningUntilFailure(Translator):
    """Returns RUNNING for all but FAILURE."""

    success = RUNNING
    skipped = RUNNING


class Repeat(OneChild, num_cycles=int):
    """Ticks the child a number of times (-1: for ever), in the same tick if it was RUNNING."""

    once_more = SUCCESS
    _count = 0

    def decide(self) -> Ticking:
        child = self.child
        times = self.ports.get(*self.PORTS)
        while times == -1 or self._count < times:
            was_idle = child.status is SKIPPED
            verdict = yield from child.tick()
            if verdict is RUNNING:
                return RUNNING
            child.reset()
            if verdict is SKIPPED:
                return SKIPPED
            if verdict is not self.once_more:
                return self.end(verdict)
            self._count += 1
            if was_idle and self._count != times:
                return RUNNING
        return self.end(self.once_more)


class RetryUntilSuccessful(Repeat, num_attempts=int):
    """Ticks the child again after a failure."""

    once_more = FAILURE


class Gate(OneChild, is_node=False):
    """Starts the child when the gate is open, and ticks it while it is RUNNING."""

    runs = False
    closed = SKIPPED
    _last: Status | None = None
    """The outcome of the child when it was ticked last."""

    def initialise(self) -> None:
        self.forget()

    def instead(self) -> Status | None:
        """Return the outcome if the child does not start now, None if it does: the first time."""
        return None if self._last is None else self.closed

    def decide(self) -> Ticking:
        verdict = None if self._last is RUNNING else self.instead()
        if verdict is None:
            self._last = yield from super().decide()
            verdict = self.finish(self._last)
        return verdict

    def finish(self, verdict: Status) -> Status:
        """Return the outcome after the child was ticked."""
        return verdict


class RunOnce(Gate, then_skip=True):
    """Ticks the child to its end, once.

    After that it is skipped, or with then_skip="false" returns that outcome.
    """

    def forget(self) -> None:
        """Remember that it has run."""

    def instead(self) -> Status | None:
        if self._last not in DONE:
            return None
        return SKIPPED if self.ports.get("then_skip") else self._last


class Precondition(Gate, Scripted, **{"if": str, "else": FAILURE}):
    """Ticks the child if the script `if` is true; else returns `else`.

    Once the child runs, `if` is not asked.
    """

    def forget(self) -> None:
        """Remember whether the child runs."""

    def instead(self) -> Status | None:
        verdict: Status = self.ports.get("else")  # a wrong outcome raises in the first tick
        return None if self._last is SKIPPED or truth(self.script()) else verdict


class SkipUnlessUpdated(Gate, entry=None):
    """Ticks the child to its end each time that an entry was written; otherwise it is skipped."""

    def instead(self) -> Status | None:
        return None if self.ports.is_updated("entry") else self.closed


class WaitValueUpdate(SkipUnlessUpdated):
    """Is RUNNING until the entry was written."""

    closed = RUNNING


class Loop(Gate, is_node=False):
    """Runs the child once for each element of a queue, one per tick.

    Returns `if_empty` in the tick after the last.
    """

    _left: list[object] | None = None

    def instead(self) -> Status | None:
        if self._left is None:
            queue = self.ports.get("queue")
            if isinstance(queue, str):
                queue = convert(queue, GenericAlias(list, self.PORTS["value"].data_type))
            self._left = list(queue)
        if self._left:
            self.ports.set("value", self._left.pop(0))
            return None
        outcome: Status = self.ports.get("if_empty")
        return outcome

    def finish(self, verdict: Status) -> Status:
        return FAILURE if verdict is FAILURE else RUNNING


class BlackboardCheck(
    OneChild, is_node=False, value_A=object, value_B=object, return_on_mismatch=FAILURE
):
    """(Version 3) Ticks the child while two values are equal, and halts it if they are not.

    A key without a value is equal to nothing.
    """

    kind: type

    def decide(self) -> Ticking:
        is_same = False
        with suppress(NodeError):
            values = [self.ports.get(name) for name in ("value_A", "value_B")]
            is_same = is_equal(*[convert(value, self.kind) for value in values])
        if is_same:
            return (yield from super().decide())
        return self.end(self.ports.get("return_on_mismatch"))


for _name, _zero in {"Int": 0, "Double": 0.0, "Bool": False, "String": ""}.items():
    type(f"Loop{_name}", (Loop,), {}, queue=None, value=_zero, if_empty=SUCCESS)
    type(f"BlackboardCheck{_name}", (BlackboardCheck,), {"kind": type(_zero)})
CHECKS = tuple(name for name in NODES if name.startswith("BlackboardCheck"))


class Timed(OneChild, is_node=False):
    """A decorator with a duration, its only port, which counts from the tick in which it starts."""

    def prepare(self, ports: Ports) -> None:
        super().prepare(ports)
        if any(ports.get(name) < 0 for name in ports.literals):
            raise NodeError("it takes no negative number")

    def decide(self) -> Ticking:
        verdict = yield from super().decide()
        if verdict in DONE:
            self.forget()
        return verdict


class Delay(Timed, delay_msec=int):
    """Is RUNNING for `delay_msec` [ms]; then ticks the child."""

    def decide(self) -> Ticking:
        return (yield from super().decide()) if self.is_over() else RUNNING


class Timeout(Timed, msec=int):
    """Halts the child, and fails, if it is RUNNING after `msec` [ms]; 0 is no limit."""

    _is_spent = False

    def decide(self) -> Ticking:
        is_late = self.is_over() and not self._is_spent and self.ports.get("msec") > 0
        self._is_spent |= is_late
        if is_late and self.child.status is RUNNING:
            return self.end(FAILURE)
        return (yield from super().decide())


class RateController(Gate, hz=10.0):
    """Ticks the child at the start, while it is RUNNING, and 1 / `hz` [s] after it succeeded."""

    runs = True
    closed = RUNNING
    _since: float = 0.0

    def instead(self) -> Status | None:
        elapsed = self.now() - self._since
        return None if elapsed * self.ports.get("hz") >= 1 - ROUNDING_S else super().instead()

    def finish(self, verdict: Status) -> Status:
        if verdict is SUCCESS:
            self._since = self.now()
        return verdict


class SingleTrigger(Gate):
    """Ticks the child to its end, once until this node is reset; FAILURE after that."""

    runs = True

    def instead(self) -> Status | None:
        return FAILURE if self._last in DONE else None


class GoalUpdatedController(Gate):
    """Ticks the child at the start, while it is RUNNING, and when `goal` or `goals` has changed."""

    PORTS: ClassVar = {name: PortInformation(None, required=False) for name in ("goal", "goals")}
    runs = True
    closed = RUNNING
    _before: object = None

    def decide(self) -> Ticking:
        board = self.ports.blackboard
        goals = [board.get(self.ports.keys.get(name, name)) for name in self.PORTS]
        if goals != self._before and self._last is not RUNNING:
            self.forget()
        self._before = goals
        return (yield from super().decide())


class RecoveryNode(XmlNode, number_of_retries=1):
    """Ticks the first child; when it fails, the second, then the first again, some times."""

    arity = (2, 2)
    _retries = 0
    _is_recovering = False

    def decide(self) -> Ticking:
        task, recovery = self.slots
        while True:
            if not self._is_recovering:
                verdict = yield from task.tick()
                if verdict is RUNNING:
                    return RUNNING
                if verdict is not FAILURE or self._retries == self.ports.get(*self.PORTS):
                    return self.end(verdict)
                task.reset()
                self._is_recovering = True
            verdict = yield from recovery.tick()
            if verdict is RUNNING:
                return RUNNING
            if verdict is not SUCCESS:
                return self.end(FAILURE)
            recovery.reset()
            self._is_recovering = False
            self._retries += 1


class RoundRobin(XmlNode, wrap_around=False):
    """Ticks the next child, until one succeeds or all failed.

    Without `wrap_around`, ends at the last.

    As in Nav2 1.5.1, the last child ends it as a failure without `wrap_around`, also by its
    success.
    """

    _next = 0
    _failed = 0

    def decide(self) -> Ticking:
        slots = self.slots
        skipped = 0
        while self._failed + skipped < len(slots):
            verdict = yield from slots[self._next].tick()
            if verdict is RUNNING:
                return RUNNING
            self._next = (self._next + 1) % len(slots)
            skipped += verdict is SKIPPED
            self._failed += verdict is FAILURE
            if self._next == 0 and not self.ports.get("wrap_around"):
                break
            if verdict is SUCCESS:
                self._failed = 0
                self.reset_children()
                return SUCCESS
        return self.end(SKIPPED if skipped == len(slots) else FAILURE)


class NonblockingSequence(XmlNode):
    """Ticks all children in each tick, until one fails or all have succeeded."""

    is_side_by_side = True
    runs = False

    def decide(self) -> Ticking:
        is_open = False
        for slot in self.slots:
            verdict = yield from slot.tick()
            if verdict is FAILURE:
                return self.end(FAILURE)
            if verdict is SKIPPED:
                raise NodeError(
                    f"{slot.node.name!r} was skipped; {self.name!r} cannot skip a child"
                )
            is_open |= verdict is RUNNING
        return RUNNING if is_open else self.end(SUCCESS)


class PersistentSequence(Sequence, current_child_idx=int):
    """A sequence that keeps its place on the blackboard, also when it is halted."""

    def decide(self) -> Ticking:
        self.current_child = self.children[self.ports.get(*self.PORTS)]
        verdict = yield from super().decide()
        child = self.current_child
        self.ports.set("current_child_idx", self.children.index(child) if child else 0)
        return SUCCESS if verdict is SKIPPED else verdict


class PauseResumeController(
    XmlNode,
    pause_service_name="",
    resume_service_name="",
):
    """Ticks the first child; while paused, the second.

    The third on a pause, the fourth on resuming.

    Nav2 pauses and resumes it by two services; here, `pause` and `resume` are called.
    """

    arity = (1, 4)
    _state = 0  # place of the child that is ticked: 0 resumed, 1 paused, 2 on pause, 3 on resume
    _next: int | None = None

    def initialise(self) -> None:
        self.forget()

    @property
    def is_paused(self) -> bool:
        return self._state == 1 and self._next is None

    def pause(self) -> bool:
        """Pause from the next tick on; False if it is paused."""
        if self.is_paused:
            return False
        self._next = 2
        return True

    def resume(self) -> bool:
        """Go on from the next tick on; False if it is not paused, also after `pause`."""
        is_accepted = self.is_paused
        if is_accepted:
            self._next = 3
        return is_accepted

    def decide(self) -> Ticking:
        if self._next is not None:
            self._state = self._next
            self._next = None
            self.reset_children()
        state = self._state
        verdict = RUNNING if state == 1 else SKIPPED
        if state < len(self.slots):
            verdict = yield from self.slots[state].tick()
        if verdict in (RUNNING, FAILURE):
            return verdict
        if state == 0:
            return SUCCESS  # as in Nav2, a finished child is not begun again by the next start
        self._state = 0 if state == 3 else 1
        return RUNNING
