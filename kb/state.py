"""The facts of one moment, and the statuses that follow from them. A copy is a situation.

`State.apply` takes an event and only assigns, so that it can be repeated after an interrupt. After
a fact changes, only the nodes that depend on it are inferred again, from the lowest level up:
constraint, configuration, component, design, function, action.
"""

import math
from array import array
from base64 import b64decode, b64encode
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from kb.debounce import NEVER, Debounced, judge, policy_status, silence
from kb.elements import Parameters
from kb.events import Event, StatusChange
from kb.exceptions import InvalidValue
from kb.network import LEVELS, Network, Node, Ref, is_debounced
from kb.records import Memory
from kb.status import (
    Status,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

_ATTRIBUTE: Final = LEVELS["attribute"]
_CHOSEN: Final = ("configuration", "component", "function design")
FLAGS: Final = ("stale", "failed", "active", "selected", "requested", "asserted_required")
"""The facts that are sets of nodes."""
_VALUES: Final = ("value", "time", "asserted", "votes")


class Reason(NamedTuple):
    """The reason that was given with a fact, and the time until which the fact holds [s]."""

    text: str = ""
    until: float | None = None

    def __str__(self) -> str:
        """Return the words that follow a statement: the end in time, and the reason in brackets."""
        words = f" ({self.text})" if self.text else ""
        if self.until is None:
            return words
        return f" until {f'{self.until:.3f}'.rstrip('0').rstrip('.')} s{words}"


NO_REASON: Final = Reason()


class History:
    """The newest measurements of one attribute, in order of time, 24 bytes each.

    Time, value and number of the event are added in one step, so that a measurement is there as a
    whole or not at all. At most twice as many are held as the memory asks for.
    """

    def __init__(self, memory: Memory, packed: bytes = b"", begins: float = -math.inf) -> None:
        self._memory = memory
        self._rows = array("d", packed)
        self.begins = begins  # all measurements from this time on are held [s]

    def __len__(self) -> int:
        return len(self._rows) // 3

    def add(self, time: float, value: float, number: int) -> None:
        """Add a measurement, unless the one of this event was added already."""
        rows = self._rows
        if rows and rows[-1] >= number:
            return
        rows.extend((time, value, number))
        if len(rows) >= 6 * self._memory.measurements or rows[0] < time - 2 * self._memory.span:
            self._forget(time)

    def _forget(self, now: float) -> None:
        oldest = self._place(now - self._memory.span)
        excess = min(max(len(self) - self._memory.measurements, oldest), len(self) - 1)
        if excess > 0:
            self.begins = max(self.begins, self._rows[3 * excess])
            self._rows = self._rows[3 * excess :]

    def at(self, time: float) -> float | None:
        """Return the value that was the latest at a time [s]; None before the first."""
        place = self._place(time)
        if not place and time < self.begins:
            raise InvalidValue(
                f"what was measured by {time!r} s is forgotten; memory begins at {self.begins!r} s"
            )
        return self._rows[3 * place - 2] if place else None

    def samples(self, most: int | None = None) -> tuple[tuple[float, float], ...]:
        """Return all measurements, or the newest `most` of them, as (time [s], value)."""
        rows = self._rows if most is None else self._rows[-3 * most :]
        return tuple(zip(rows[::3], rows[1::3], strict=True))

    def packed(self, most: int) -> tuple[bytes, float]:
        """Return the newest measurements as bytes, and from when on all are there [s]."""
        begins = self.begins if len(self) <= most else self._rows[-3 * most]
        return self._rows[-3 * most :].tobytes(), begins

    def _place(self, time: float) -> int:
        return bisect_right(range(len(self)), time, key=lambda place: self._rows[3 * place])


class State:
    """Facts, and the statuses inferred from them.

    Attributes:
        value: the latest measurement of each attribute that has one.
        time: when it was measured [s]; missing for what is only supposed.
        stale: attributes whose latest measurement is too old.
        failed, active: components that were reported so.
        selected: designs and configurations that are chosen.
        requested: actions with an open request.
        asserted: statuses that stand in place of inferred ones.
        asserted_required: nodes stated to be required, whatever is inferred.
        debounced: what is remembered of each debounced constraint.
        votes: the newest measurements that count, of each attribute with debounced constraints:
            (number of the event, value).
        parameters: those last set on each component, by its name.
        histories: the measurements of each attribute; shared with all copies.
        status: the status of every node but attributes.
        adaptable: functions and components that need a choice, or may get a better one.
    """

    def __init__(self, network: Network, memory: Memory | None = None) -> None:
        self.network = network
        self.memory = memory or Memory()
        self.value: dict[Node, float] = {}
        self.time: dict[Node, float] = {}
        self.stale: set[Node] = set()
        self.failed: set[Node] = set()
        self.active: set[Node] = set()
        self.selected: set[Node] = set()
        self.requested: set[Node] = set()
        self.asserted: dict[Node, Status] = {}
        self.asserted_required: set[Node] = set()
        self.debounced: dict[Node, Debounced] = {}
        self.votes: dict[Node, tuple[tuple[int, float], ...]] = {}
        self.reasons: dict[tuple[str, Node], Reason] = {}
        self.parameters: dict[str, Parameters] = {}
        self.histories: dict[Node, History] = {}
        self.status: dict[Node, Status] = {}
        self.adaptable: set[Node] = set()
        self._required: set[Node] = set()  # functions
        self._obsolete: set[Node] = set()
        self._inactive_required: set[Node] = set()
        self._outdated: list[set[Node]] = [set() for _ in range(_ATTRIBUTE)]
        self._unmarked: set[Node] = set()  # whether they are obsolete is to be found out again
        self._before: dict[Node, Status] = {}  # of the event that is being applied
        self.touch(network.present())
        self.infer()
        self._before.clear()

    def copy(self) -> "State":
        """Return a copy to suppose other facts in."""
        other = State.__new__(State)
        for name, content in vars(self).items():
            is_copied = isinstance(content, dict | set) and name != "histories"
            vars(other)[name] = copy(content) if is_copied else content
        other._outdated = [set() for _ in range(_ATTRIBUTE)]
        return other

    # ---------------------------------------------------------------- asked

    def is_required(self, node: Node) -> bool:
        """Return whether an action, function or component is needed for what is requested."""
        if node in self.asserted_required:
            return True
        if node.kind == "action":
            return node in self.requested
        if node.kind == "function":
            return any(map(self.is_required, node.used_by))
        return node.kind == "component" and not self.selected.isdisjoint(node.used_by)

    def users(self, node: Node) -> list[Node]:
        """Return the required actions of a function, or the selected designs of a component."""
        if node.kind == "function":
            return [action for action in node.used_by if self.is_required(action)]
        return [design for design in node.used_by if design in self.selected]

    def inactive_required(self) -> list[Node]:
        """Return the required components that are not active, in order of declaration."""
        return in_order(self._inactive_required)

    def verdict(self, node: Node) -> Status | None:
        """Return the status of a debounced constraint by its measurements; None for another one."""
        debounced = self.debounced.get(node)
        return None if debounced is None else debounced.status

    def reason(self, fact: str, node: Node) -> Reason:
        """Return the reason that was given with a fact, such as "failed" or "selected"."""
        return self.reasons.get((fact, node), NO_REASON)

    def obsolete(self) -> list[Node]:
        """Return what is active or selected for no required function, in order of declaration."""
        return in_order(self._obsolete)

    def serves(self, component: Node) -> bool:
        """Return whether a design of a required function, selected or not, has this component."""
        return any(design.used_by[0] in self._required for design in component.used_by)

    # ---------------------------------------------------------------- events

    def apply(self, event: Event) -> None:
        """Change the facts as an event says, and infer what follows; it can be repeated."""
        method = getattr(self, f"_apply_{event.verb}", None)
        if method is not None:
            method(event, *event.arguments)
            self.infer()

    def changed_nodes(self) -> list[Node]:
        """Return the nodes whose status changed since `forget_changes`, the lowest level first."""
        changed = [
            node
            for node, before in self._before.items()
            if self.status.get(node, before) is not before
        ]
        return sorted(changed, key=lambda node: (node.level, node.index))

    def changes(self) -> tuple[StatusChange, ...]:
        """Return how the statuses of `changed_nodes` changed."""
        return tuple(
            StatusChange(node.kind, node.name, self._before[node], self.status[node])
            for node in self.changed_nodes()
        )

    def forget_changes(self) -> None:
        """Begin to collect changes anew."""
        self._before = {}

    def _apply_measure(self, event: Event, name: str, value: float) -> None:
        self.set_measurement(self.network.attributes[name], value, event.time, event.number)

    def set_measurement(self, node: Node, value: float, time: float, number: int) -> None:
        """Make a measurement the latest one, and touch the constraints whose status may differ."""
        before = self.value.get(node)
        thresholds = self.network.thresholds(node)
        if before is None or node in self.stale:
            self.touch(node.constraints)
        elif value != before:
            self.touch(thresholds.crossed(before, value))
        history = self.histories.get(node)
        if history is None:
            history = self.histories[node] = History(self.memory)
        self.value[node] = value
        self.time[node] = time
        self.stale.discard(node)
        if thresholds.debounced:
            self._vote(node, value, number, time)
        history.add(time, value, number)

    def remember(self, node: Node, value: float, time: float, number: int) -> None:
        """Add an earlier measurement to the history only."""
        self.histories.setdefault(node, History(self.memory)).add(time, value, number)

    def _vote(self, node: Node, value: float, number: int, now: float) -> None:
        votes = self.votes.get(node, ())
        if not votes or votes[-1][0] < number:
            votes = (*votes, (number, value))[-node.attribute.agreement[1] :]
        self.votes[node] = votes
        for constraint in self.network.thresholds(node).debounced:
            self.judge(constraint, now)

    def judged(self, constraint: Node, now: float) -> tuple[Debounced, float]:
        """Return what a debounced constraint is by its votes, and when to judge it again [s]."""
        values = tuple(value for _, value in self.votes.get(constraint.requires[0], ()))
        before = self.debounced.get(constraint, Debounced())
        return judge(constraint, before, values, now) if values else (before, NEVER)

    def judge(self, constraint: Node, now: float) -> float:
        """Judge a debounced constraint; return when to judge again if nothing is measured [s]."""
        after, again = self.judged(constraint, now)
        if constraint.requires[0] in self.votes and after is not self.debounced.get(constraint):
            self.touch([constraint])
            self.debounced[constraint] = after
        return again

    def _apply_stale(self, event: Event, name: str) -> None:
        node = self.network.attributes[name]
        self.touch(node.constraints)
        self.stale.add(node)
        self.votes.pop(node, None)
        for constraint in self.network.thresholds(node).debounced:
            self.debounced[constraint] = silence(node.attribute.when_stale, event.time)

    def _apply_dwell(self, event: Event, ref: Ref) -> None:
        node = self.network.referred(ref)
        self.judge(node, event.time)

    def _apply_component_failed(self, event: Event, name: str, reason: str) -> None:
        self._set_flag("failed", self.network.components[name], True, reason)

    def _apply_component_recovered(self, event: Event, name: str) -> None:
        node = self.network.components[name]
        if self.asserted.get(node) is Status.FAILURE:
            self._assert(node, None)
        self._set_flag("failed", node, False)

    def _apply_component_active(self, event: Event, name: str, active: bool, reason: str) -> None:
        node = self.network.components[name]
        self._set_flag("active", node, active, "" if active else reason)

    def _apply_component_configured(
        self, event: Event, name: str, parameters: Mapping[str, Any]
    ) -> None:
        self.parameters[name] = MappingProxyType(dict(parameters))

    def _apply_assert_status(
        self, event: Event, ref: Ref, status: str, reason: str, until: float | None
    ) -> None:
        self._assert(self.network.referred(ref), Status(status), reason, until)

    def _apply_retract_status(self, event: Event, ref: Ref) -> None:
        self._assert(self.network.referred(ref), None)

    def _apply_lapse(self, event: Event, ref: Ref, status: str) -> None:
        self._assert(self.network.referred(ref), None)

    def _assert(
        self, node: Node, status: Status | None, reason: str = "", until: float | None = None
    ) -> None:
        self.touch([node])
        if status is None:
            self.asserted.pop(node, None)
        else:
            self.asserted[node] = status
        self.give_reason("asserted", node, reason, until)

    def _apply_assert_required(self, event: Event, ref: Ref, required: bool | None) -> None:
        self._set_flag("asserted_required", self.network.referred(ref), bool(required))

    def _apply_assert_selected(
        self, event: Event, ref: Ref, selected: bool | None, reason: str
    ) -> None:
        node = self.network.referred(ref)
        self._set_flag("selected", node, bool(selected), reason if selected else "")
        owner = node.used_by[0]
        is_without = self.selected.isdisjoint(owner.requires)
        self.give_reason("unselected", owner, reason if is_without else "")

    def _apply_request_action(self, event: Event, name: str, preference: object) -> None:
        self._set_flag("requested", self.network.actions[name], True)

    def _apply_cancel_action(self, event: Event, name: str, result: str, reason: str) -> None:
        self._set_flag("requested", self.network.actions[name], False)

    def _apply_select(
        self,
        event: Event,
        designs: Mapping[str, str],
        configurations: Mapping[str, str],
        reason: str,
    ) -> None:
        network = self.network
        chosen = [network.designs[name] for name in designs.values()]
        chosen += [network.configurations[name] for name in configurations.values()]
        flipped = [network.kinds[kind][name] for kind, name, _ in event.effects]
        for node, (_, _, is_selected) in zip(flipped, event.effects, strict=True):
            self.touch([node])
            (self.selected.add if is_selected else self.selected.discard)(node)
        for node in (*flipped, *chosen):
            self.give_reason("selected", node, reason if node in self.selected else "")
            self.give_reason("unselected", node.used_by[0])

    def _apply_note_no_choice(self, event: Event, reason: str) -> None:
        """Give the reason to all that is required and cannot be chosen for."""
        concerned: set[Node] = set()
        if reason:
            functions = [one for one in self.network.functions.values() if self.is_required(one)]
            concerned.update(functions)
            for function in functions:
                for design in function.requires:
                    concerned.update(design.requires)
        for node in (*self.network.functions.values(), *self.network.components.values()):
            self.give_reason("selected", node, reason if node in concerned else "")

    def _set_flag(self, fact: str, node: Node, is_so: bool, reason: str = "") -> None:
        self.touch([node])
        nodes: set[Node] = vars(self)[fact]
        (nodes.add if is_so else nodes.discard)(node)
        self.give_reason(fact, node, reason)

    def give_reason(
        self, fact: str, node: Node, text: str = "", until: float | None = None
    ) -> None:
        """Keep the reason of a fact; an empty one takes it back."""
        if text or until is not None:
            self.reasons[fact, node] = Reason(text, until)
        else:
            self.reasons.pop((fact, node), None)

    def hold(self, constraint: Node, status: Status) -> None:
        """Give a constraint a status that its measurements do not say, as a forecast does."""
        self.touch([constraint])
        self.debounced[constraint] = Debounced(status)

    def release(self, constraint: Node) -> None:
        """Let a constraint follow from its measurements again."""
        self.touch([constraint])
        self.debounced.pop(constraint, None)

    # ---------------------------------------------------------------- inference

    def touch(self, nodes: Iterable[Node]) -> None:
        """Note that nodes have to be inferred again, because facts about them change."""
        outdated = self._outdated
        for node in nodes:
            if node.kind == "attribute":
                outdated[0].update(node.constraints)
                continue
            outdated[node.level].add(node)
            if node.kind == "action":
                outdated[node.level - 1].update(node.requires)
            elif node.kind == "function design":
                outdated[LEVELS["component"]].update(node.requires)
                outdated[LEVELS["function"]].update(node.used_by)
            elif node.kind == "configuration":
                outdated[LEVELS["component"]].update(node.used_by)

    def infer(self) -> None:
        """Infer what is outdated. A node stays outdated until its status is stored."""
        for level in self._outdated:
            while level:
                node = next(iter(level))
                new = self._infer(node)
                before = self.status.get(node)
                if new is not before:
                    self._before.setdefault(node, before or unset_status(node))
                    for user in node.used_by:
                        self._outdated[user.level].add(user)
                    if node.kind in ("function", "component"):
                        mark = (
                            self.adaptable.add
                            if is_adaptable(node, new)
                            else self.adaptable.discard
                        )
                        mark(node)
                    self.status[node] = new
                self._note_requirement(node)
                level.discard(node)
        self._mark_obsolete()

    def _note_requirement(self, node: Node) -> None:
        """Note whether a node is required, and what may be obsolete by that or is no longer."""
        if node.kind == "function":
            is_required = self.is_required(node)
            if is_required is not (node in self._required):
                self._unmarked.update(_serving(node))
                (self._required.add if is_required else self._required.discard)(node)
        elif node.kind == "component":
            is_lacking = node not in self.active and self.is_required(node)
            note = self._inactive_required.add if is_lacking else self._inactive_required.discard
            note(node)
        if node.kind in _CHOSEN:
            self._unmarked.add(node)

    def _mark_obsolete(self) -> None:
        while self._unmarked:
            node = next(iter(self._unmarked))
            if node.kind == "component":
                is_obsolete = node in self.active and not self.serves(node)
            elif node not in self.selected:
                is_obsolete = False
            elif node.kind == "function design":
                is_obsolete = node.used_by[0] not in self._required
            else:
                is_obsolete = not self.serves(node.used_by[0])
            (self._obsolete.add if is_obsolete else self._obsolete.discard)(node)
            self._unmarked.discard(node)

    def _infer(self, node: Node) -> Status:
        if node in self.asserted:
            return self.asserted[node]
        if node.kind == "constraint":
            return self._compare(node, node.requires[0])
        constraints = [self.status[constraint] for constraint in node.constraints]
        if node.kind == "configuration":
            return configuration_status(constraints)
        required_statuses = [self.status[part] for part in node.requires]
        if node.kind == "function design":
            return design_status(constraints, required_statuses, node in self.selected)
        required = self.is_required(node)
        if node.kind == "action":
            return action_status(constraints, required_statuses, required)
        chosen = [self.status[part] for part in node.requires if part in self.selected]
        if node.kind == "function":
            return function_status(required_statuses, chosen, required)
        is_failed, is_active = node in self.failed, node in self.active
        return component_status(
            is_failed, constraints, required_statuses, chosen, required, is_active
        )

    def _compare(self, node: Node, attribute: Node) -> Status:
        if attribute in self.stale:
            return policy_status(attribute.attribute.when_stale)
        debounced = self.debounced.get(node)
        if debounced is not None:
            return debounced.status
        constraint = node.constraint
        return constraint_status(self.value.get(attribute), constraint.operator, constraint.value)

    def renew(self, removed: Iterable[Node], changed: Iterable[Node], now: float) -> None:
        """Follow a model that has changed; it can be repeated.

        Args:
            removed: nodes that are no longer in the model.
            changed: attributes and constraints that are new, or are declared otherwise now.
            now: the time of the change [s].
        """
        for node in removed:
            self._forget(node)
        for node in changed:
            for constraint in node.constraints if node.kind == "attribute" else [node]:
                self._restart(constraint, now)
        self.touch(self.network.present())
        self.infer()
        self.adaptable = {
            node
            for node in (*self.network.functions.values(), *self.network.components.values())
            if is_adaptable(node, self.status[node])
        }

    def follow_model(self, revision: int) -> None:
        """Forget what is no longer in the network, and infer all again, unless it is of this revision."""
        if revision == self.network.revision:
            return
        present = set(self.network.present())
        for node in self.network.nodes:
            if node not in present:
                self._forget(node)
        self.touch(present)
        self.infer()

    def to_json(self, keep: int) -> dict[str, Any]:
        """Return the facts as values that JSON can hold, with the newest measurements."""
        present = set(self.network.present())
        facts: dict[str, list[Any]] = {}
        for name in FLAGS:
            nodes: set[Node] = vars(self)[name]
            facts[name] = [node.ref for node in in_order(nodes & present)]
        for name in _VALUES:
            values: dict[Node, Any] = vars(self)[name]
            facts[name] = [[node.ref, value] for node, value in values.items() if node in present]
        return {
            **facts,
            "debounced": [
                [node.ref, [_plain(getattr(one, field.name)) for field in fields(one)]]
                for node, one in self.debounced.items()
                if node in present
            ],
            "reasons": [
                [fact, node.ref, *reason]
                for (fact, node), reason in self.reasons.items()
                if node in present
            ],
            "parameters": {name: dict(values) for name, values in self.parameters.items()},
            "histories": [
                [node.name, b64encode(packed).decode(), begins if begins > -math.inf else None]
                for node, history in self.histories.items()
                if node in present
                for packed, begins in [history.packed(keep)]
            ],
        }

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and deep-copy a state by its facts; the statuses are inferred again."""
        return _restored, (self.network.model, self.memory, self.to_json(self.memory.measurements))

    def from_json(self, written: Mapping[str, Any]) -> None:
        """Restore what `to_json` returned."""
        find = self.network.referred
        for name in FLAGS:
            vars(self)[name].update(find(tuple(ref)) for ref in written[name])
        for name in _VALUES:
            for ref, value in written[name]:
                if name == "asserted":
                    value = Status(value)
                elif name == "votes":
                    value = tuple((number, vote) for number, vote in value)
                vars(self)[name][find(tuple(ref))] = value
        for ref, (status, since, is_silent, candidate, candidate_since) in written["debounced"]:
            self.debounced[find(tuple(ref))] = Debounced(
                Status(status),
                _time(since),
                is_silent,
                None if candidate is None else Status(candidate),
                _time(candidate_since),
            )
        for fact, ref, text, until in written["reasons"]:
            self.reasons[fact, find(tuple(ref))] = Reason(text, until)
        for name, values in written["parameters"].items():
            self.parameters[name] = MappingProxyType(values)
        for name, packed, begins in written["histories"]:
            begins = -math.inf if begins is None else begins
            history = History(self.memory, b64decode(packed), begins)
            self.histories[self.network.attributes[name]] = history
        self.touch(self.network.present())
        self.infer()

    def _restart(self, constraint: Node, now: float) -> None:
        """Judge a constraint as if all that is known of its attribute were the latest value."""
        attribute = constraint.requires[0]
        self.stale.discard(attribute)
        self.votes.pop(attribute, None)
        self.debounced.pop(constraint, None)
        if not is_debounced(constraint):
            return
        value = self.value.get(attribute)
        self.debounced[constraint] = Debounced()
        if value is not None:
            self.votes[attribute] = ((0, value),)
            self.judge(constraint, now)

    def _forget(self, node: Node) -> None:
        for name, content in vars(self).items():
            if isinstance(content, set):
                content.discard(node)
            elif isinstance(content, dict) and name != "status":  # which a view may still ask for
                content.pop(node, None)
        for fact, of in [key for key in self.reasons if key[1] is node]:
            del self.reasons[fact, of]
        for level in self._outdated:
            level.discard(node)
        if node.kind == "component":
            self.parameters.pop(node.name, None)


def _serving(function: Node) -> set[Node]:
    """Return the designs of a function, their components, and the configurations of these."""
    designs = function.requires
    components = [component for design in designs for component in design.requires]
    configurations = [part for component in components for part in component.requires]
    return {*designs, *components, *configurations}


def _restored(model: Any, memory: Memory, written: Mapping[str, Any]) -> State:  # noqa: ANN401  # a `Model`
    state = State(Network(model), memory)
    state.from_json(written)
    return state


def _plain(value: Any) -> Any:  # noqa: ANN401  # a field of what is debounced
    return None if value == -math.inf else value


def _time(written: float | None) -> float:
    return -math.inf if written is None else written


def unset_status(node: Node) -> Status:
    """Return the status of an element while nothing is known about it."""
    return Status.NOT_EVALUATED if node.kind == "constraint" else Status.FEASIBLE


def is_adaptable(node: Node, status: Status) -> bool:
    """Return whether a function or component of this status needs a choice, or a better one."""
    if status is Status.SOLVED:
        return bool(node.element.always_improve)
    return status in (Status.UNSOLVED, Status.CONFIGURATION_ERROR)


def in_order(nodes: Iterable[Node]) -> list[Node]:
    """Return nodes in the order of declaration."""
    return sorted(nodes, key=lambda node: node.index)
