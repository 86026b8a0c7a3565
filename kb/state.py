"""The facts of one moment, and the statuses that follow from them. A copy is a situation.

`State.apply` takes an event and only assigns, so that it can be repeated after an interrupt. After
a fact changes, only the nodes that depend on it are inferred again, from the lowest level up:
constraint, configuration, component, design, function, action.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from typing import Any, Final, NamedTuple

from kb.debounce import NEVER, Debounced, debounce, policy_status, voted_status
from kb.elements import Attribute, Changeable, ComponentKind, Constraint, Parameters
from kb.events import Event
from kb.network import Network, Node
from kb.records import ReconfigurationPlan
from kb.status import (
    OPERATORS,
    Status,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

KEPT: Final = 10_000
"""How many measurements of each attribute are kept: the newest ones."""


_UNSTORED: Final = ("network", "keep", "_outdated")
_SHARED: Final = ("histories", "changed_by")  # by all copies, which do not change them


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
        silent_until: the last event before the measurements that count in debouncing, by attribute.
        reasons: those given with facts, by fact and node.
        parameters: those last set on each component.
        histories: the newest measurements of each attribute, with the number of the event; shared
            with all copies.
        status: the status of every node but attributes.
        changed_by: the number of the last event that changed the status of a node.
        feasibility_changed_by: the last event that made an action feasible or unfeasible.
        before: the statuses that have changed in the event that is applied, as they were before.
        adaptable: functions and components that need a choice, or may get a better one.
        next_due: no sooner than this time changes something by itself [s].
    """

    def __init__(self, network: Network, keep: int = KEPT) -> None:
        self.network = network
        self.keep = keep
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
        self.silent_until: dict[Node, int] = {}
        self.reasons: dict[tuple[str, Node], Reason] = {}
        self.parameters: dict[Node, Parameters] = {}
        self.histories: dict[Node, deque[tuple[float, float, int]]] = {}
        self.status: dict[Node, Status] = {}
        self.changed_by: dict[Node, int] = {}
        self.feasibility_changed_by: int | None = None
        self.before: dict[Node, Status] = {}
        self.adaptable: set[Node] = set()
        self.next_due = NEVER
        self._due: dict[tuple[str, Node], float] = {}
        self._obsolete: set[Node] = set()
        self._inactive_required: set[Node] = set()
        self._outdated: dict[str, set[Node]] = {kind: set() for kind in network.kinds}
        self.touch(network.present())
        self.infer()
        self.before = {}

    def copy(self) -> "State":
        """Return a copy to suppose other facts in."""
        other = State.__new__(State)
        for name, content in vars(self).items():
            is_copied = isinstance(content, dict | set) and name not in _SHARED
            vars(other)[name] = content.copy() if is_copied else content
        other._outdated = {kind: set() for kind in self._outdated}
        return other

    def facts(self) -> dict[str, Any]:
        """Return everything by name, as a store keeps it."""
        return {name: value for name, value in vars(self).items() if name not in _UNSTORED}

    def restore(self, facts: Mapping[str, Any]) -> None:
        """Restore what `facts` returned."""
        vars(self).update(facts)
        for node, measurements in self.histories.items():
            self.histories[node] = deque(measurements, self._room(node))

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

    def serves(self, component: Node) -> bool:
        """Return whether a design of a required function, selected or not, has this component."""
        return any(self.is_required(design.used_by[0]) for design in component.used_by)

    def users(self, node: Node) -> list[Node]:
        """Return the required actions of a function, or the selected designs of a component."""
        if node.kind == "function":
            return [action for action in node.used_by if self.is_required(action)]
        return [design for design in node.used_by if design in self.selected]

    def obsolete(self) -> list[Node]:
        """Return what is active or selected for no required function, in order of declaration."""
        return in_order(self._obsolete)

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

    # ---------------------------------------------------------------- choosing

    def decide(self, chosen: Sequence[Node]) -> tuple[list[Node], ReconfigurationPlan | None]:
        """Decide what a choice changes; what is obsolete is given up. Nothing changes yet.

        Returns the designs and configurations that are selected and were not, or the other way
        round, and the steps that carry it out; None if there is nothing to do.
        """
        flips = []
        for node in chosen:
            is_of_use = self._is_of_use(node)
            for part in node.used_by[0].requires:
                if (part in self.selected) is not (part is node and is_of_use):
                    flips.append(part)
        unneeded = self.obsolete()
        flips += [node for node in unneeded if node.kind != "component" and node not in flips]
        selected = self.selected.symmetric_difference(flips)
        designs = [node for node in flips if node.kind == "function design"]

        def is_used(design: Node) -> bool:
            return design in selected and self.is_required(design.used_by[0])

        owners = {node.used_by[0] for node in chosen}
        stopped = []
        for design in designs:
            if design in self.selected and design.used_by[0] in owners:
                stopped += [part for part in design.requires if not any(map(is_used, part.used_by))]
        stopped += [node for node in unneeded if node.kind == "component"]
        waiting = {*designs, *(user for node in self._inactive_required for user in node.used_by)}
        started = [
            part for design in in_order(filter(is_used, waiting)) for part in design.requires
        ]
        switched = dict.fromkeys(node for node in started if node not in self.active)
        released = dict.fromkeys(node for node in stopped if node in self.active)
        configured = [node for node in flips if node in selected and node.kind == "configuration"]
        plain = [
            node for node in (*switched, *released) if node.element.kind is ComponentKind.PLAIN
        ]
        nodes = switched, released, configured, plain
        activate, deactivate, parameters, names = (
            tuple(node.name for node in each) for each in nodes
        )
        if not (activate or deactivate or parameters):
            return flips, None
        return flips, ReconfigurationPlan(activate, deactivate, parameters, plain=names)

    def after(self, flips: Iterable[Node]) -> "State":
        """Return a copy in which these are selected if they were not, or the other way round."""
        state = self.copy()
        state.touch(flips)
        state.selected.symmetric_difference_update(flips)
        state.infer()
        return state

    # ---------------------------------------------------------------- events

    def apply(self, event: Event) -> None:
        """Change the facts as an event says, and infer what follows; it can be repeated."""
        network = self.network
        match event.verb, event.arguments:
            case "measure", (name, value):
                node = network.attributes[name]
                self.set_measurement(node, value, event.time, event.number)
            case "stale", (name,):
                node = network.attributes[name]
                self.touch(node.constraints)
                self.stale.add(node)
                self.silent_until[node] = event.number
                for constraint in node.debounced:
                    status = policy_status(node.attribute.when_stale)
                    self.debounced[constraint] = Debounced(status, event.time, is_silent=True)
                self._schedule_attribute(node, event.time)
            case "dwell", (ref,):
                self._judge(network.referred(ref), event.time)
            case "component_failed", (name, reason):
                self.set_flag("failed", network.components[name], True, reason)
            case "component_recovered", (name,):
                self.set_flag("failed", network.components[name], False)
            case "component_active", (name, active, reason):
                self.set_flag("active", network.components[name], active, "" if active else reason)
            case "assert_status", (ref, status, reason, until):
                self.assert_status(network.referred(ref), Status(status), reason, until)
            case "retract_status" | "lapse", (ref, *_):
                self.assert_status(network.referred(ref), None)
            case "assert_required", (ref, required):
                self.set_flag("asserted_required", network.referred(ref), bool(required))
            case "assert_selected", (ref, selected, reason):
                node = network.referred(ref)
                self.set_flag("selected", node, bool(selected), reason if selected else "")
            case "request_action", (name, _):
                self.set_flag("requested", network.actions[name], True)
            case "cancel_action", (name, *_):
                self.set_flag("requested", network.actions[name], False)
            case "select", (designs, configurations, reason):
                nodes = [network.designs[name] for name in designs.values()]
                nodes += [network.configurations[name] for name in configurations.values()]
                for kind, name, is_selected in event.effects:
                    node = network.kinds[kind][name]
                    self.set_flag("selected", node, is_selected)
                    nodes.append(node)
                for node in nodes:
                    self.give_reason("selected", node, reason if node in self.selected else "")
        self.infer()

    def set_measurement(self, node: Node, value: float, time: float, number: int) -> None:
        """Make a measurement the latest one, and touch the constraints whose status may differ."""
        before = self.value.get(node)
        if before is None or node in self.stale:
            self.touch(node.constraints)
        elif value != before:
            for constraint in node.constraints:
                holds = OPERATORS[constraint.element.operator]
                threshold = constraint.element.value
                if holds(value, threshold) is not holds(before, threshold):
                    self._outdated["constraint"].add(constraint)
        self.value[node] = value
        self.time[node] = time
        self.stale.discard(node)
        self.remember(node, value, time, number)
        if node.debounced or node.element.max_age != math.inf:
            self._schedule_attribute(node, time)

    def remember(self, node: Node, value: float, time: float, number: int) -> None:
        """Add a measurement to the history only."""
        history = self.histories.get(node)
        if history is None:
            history = self.histories[node] = deque(maxlen=self._room(node))
        if not history or history[-1][2] < number:
            history.append((time, value, number))

    def _room(self, node: Node) -> int:
        """Return how many measurements to hold: all that vote on a change, however few are kept."""
        return max(self.keep, node.attribute.agreement[1])

    def assert_status(
        self, node: Node, status: Status | None, reason: str = "", until: float | None = None
    ) -> None:
        """Enter a status that stands in place of the inferred one; None takes it back."""
        self.touch([node])
        if status is None:
            self.asserted.pop(node, None)
        else:
            self.asserted[node] = status
        self.give_reason("asserted", node, reason, until)
        self._schedule("lapse", node, until)

    def set_flag(self, fact: str, node: Node, is_so: bool, reason: str = "") -> None:
        """Enter a fact that is a set of nodes, such as "failed" or "selected"."""
        _put(vars(self)[fact], node, is_so)
        if fact == "failed" and not is_so and self.asserted.get(node) is Status.FAILURE:
            self.assert_status(node, None)
        if fact == "selected" and node.kind == "configuration":  # its own status is the same
            self.touch(node.used_by)
            _put(self._obsolete, node, is_so and not self._is_of_use(node))
        else:
            self.touch([node])
        self.give_reason(fact, node, reason)

    def give_reason(
        self, fact: str, node: Node, text: str = "", until: float | None = None
    ) -> None:
        """Keep the reason of a fact; an empty one takes it back."""
        if text or until is not None:
            self.reasons[fact, node] = Reason(text, until)
        else:
            self.reasons.pop((fact, node), None)

    def suppose_measurement(self, node: Node, value: float | None) -> None:
        """Enter a value without a time of measurement, in a copy; None is "not measured"."""
        self.touch([node])
        self.time.pop(node, None)
        self.stale.discard(node)
        self.value.pop(node, None)
        if value is not None:
            self.value[node] = value
        for constraint in node.constraints:
            before = self.debounced.pop(constraint, Debounced()).status
            if constraint in node.debounced:
                status = Status.NOT_EVALUATED
                if value is not None:  # as once it has been measured for long enough
                    status = voted_status(constraint.constraint, [value], 1, before) or before
                self.debounced[constraint] = Debounced(status)

    def hold(self, constraint: Node, status: Status) -> None:
        """Give a constraint a status that its measurements do not say, as a forecast does."""
        self.touch([constraint])
        self.debounced[constraint] = Debounced(status)

    # ---------------------------------------------------------------- time

    def due(self, now: float) -> tuple[float, str, Node] | None:
        """Return what time has caused first until now [s]: when, the verb, and of what."""
        dues = [(time, node.index, what, node) for (what, node), time in self._due.items()]
        self.next_due, _, what, node = min(dues, default=(NEVER, 0, "", None))
        return None if node is None or now < self.next_due else (self.next_due, what, node)

    def _schedule(self, what: str, node: Node, time: float | None) -> None:
        """Note when time changes something of a node next [s]; None is never."""
        if time is None or time == NEVER:
            self._due.pop((what, node), None)
        else:
            self._due[what, node] = time
            self.next_due = min(self.next_due, time)

    def _schedule_attribute(self, node: Node, now: float) -> None:
        """Judge the debounced constraints on an attribute, and note when time changes them next."""
        measured = None if node in self.stale else self.time.get(node)
        age = node.element.max_age
        due = None if measured is None else math.nextafter(measured + age, math.inf)
        self._schedule("stale", node, due)
        for constraint in node.debounced:
            self._judge(constraint, now)

    def judged(self, constraint: Node, now: float) -> tuple[Debounced, float]:
        """Return what a debounced constraint is by its votes, and when to judge it again [s]."""
        attribute = constraint.requires[0]
        newest = islice(reversed(self.histories.get(attribute, ())), attribute.element.agreement[1])
        first = self.silent_until.get(attribute, -math.inf)
        votes = [value for _, value, number in newest if number > first]
        return debounce(constraint, self.debounced.get(constraint) or Debounced(), votes, now)

    def _judge(self, constraint: Node, now: float) -> None:
        """Judge a debounced constraint by its votes, and note when to judge it again."""
        after, again = self.judged(constraint, now)
        self.touch([constraint])
        self.debounced[constraint] = after
        self._schedule("dwell", constraint, again)

    # ---------------------------------------------------------------- inference

    def touch(self, nodes: Iterable[Node]) -> None:
        """Note that nodes have to be inferred again, because facts about them change."""
        outdated = self._outdated
        for node in nodes:
            if node.kind == "attribute":
                outdated["constraint"].update(node.constraints)
                continue
            outdated[node.kind].add(node)
            if node.kind in ("action", "function"):
                self.touch(node.requires)
            if node.kind == "function":  # what is obsolete may differ
                for design in node.requires:
                    for component in design.requires:
                        outdated["configuration"].update(component.requires)
            elif node.kind == "function design":
                outdated["component"].update(node.requires)
                outdated["function"].update(node.used_by)
            elif node.kind == "configuration":
                outdated["component"].update(node.used_by)

    def infer(self) -> None:
        """Infer what is outdated. A node stays outdated until all that follows is stored."""
        for level in self._outdated.values():
            while level:
                node = next(iter(level))
                new = self._infer(node)
                old = self.status.get(node)
                if new is not old:
                    if old is not None:
                        self.before.setdefault(node, old)
                    for user in node.used_by:
                        self._outdated[user.kind].add(user)
                    self.status[node] = new
                if node.kind in ("function", "component"):
                    _put(self.adaptable, node, _is_adaptable(node, new))
                is_chosen = node in self.active or node in self.selected
                _put(self._obsolete, node, is_chosen and not self._is_of_use(node))
                is_idle = node.kind == "component" and node not in self.active
                _put(self._inactive_required, node, is_idle and self.is_required(node))
                level.discard(node)

    def _is_of_use(self, node: Node) -> bool:
        """Return whether a component, or a part for its owner, can serve what is required."""
        owner = node if node.kind == "component" else node.used_by[0]
        return self.is_required(owner) if owner.kind == "function" else self.serves(owner)

    def _infer(self, node: Node) -> Status:
        if node in self.asserted:
            return self.asserted[node]
        if node.kind == "constraint":
            return self.compare(node)
        statuses = self.status
        constraints = [statuses[constraint] for constraint in node.constraints]
        if node.kind == "configuration":
            return configuration_status(constraints)
        parts = [statuses[part] for part in node.requires]
        if node.kind == "function design":
            return design_status(constraints, parts, node in self.selected)
        is_required = self.is_required(node)
        if node.kind == "action":
            return action_status(constraints, parts, is_required)
        chosen = [statuses[part] for part in node.requires if part in self.selected]
        if node.kind == "function":
            return function_status(parts, chosen, is_required)
        is_failed = node in self.failed
        is_active = node in self.active
        return component_status(is_failed, constraints, parts, chosen, is_required, is_active)

    def compare(self, node: Node) -> Status:
        """Return the status of a constraint by its measurements."""
        attribute = node.requires[0]
        if attribute in self.stale:
            return policy_status(attribute.attribute.when_stale)
        debounced = self.debounced.get(node)
        if debounced is not None:
            return debounced.status
        constraint = node.element
        return constraint_status(self.value.get(attribute), constraint.operator, constraint.value)

    # ---------------------------------------------------------------- the model

    def moved(self, network: Network, changed: Iterable[Changeable], now: float) -> "State":
        """Return these facts on the network of a model that has changed since.

        Args:
            network: the new one.
            changed: the elements that are new, or are declared otherwise now.
            now: the time of the change [s].
        """
        nodes = {node.element: node for node in network.present()}
        state = self.copy()
        state.network = network
        for name, content in self.facts().items():
            if isinstance(content, set):
                vars(state)[name] = {_moved(key, nodes) for key in content}
            elif isinstance(content, dict):
                vars(state)[name] = {_moved(key, nodes): value for key, value in content.items()}
        for element in changed:
            if isinstance(element, Attribute | Constraint):
                state.restart(nodes[element], now)
        state.touch(network.present())
        state.infer()
        return state

    def restart(self, node: Node, now: float) -> None:
        """Judge constraints by what is known of their attribute, whatever they were before."""
        is_attribute = node.kind == "attribute"
        attribute = node if is_attribute else node.requires[0]
        self.stale.discard(attribute)
        self.silent_until.pop(attribute, None)
        for constraint in attribute.constraints if is_attribute else [node]:
            self.debounced.pop(constraint, None)
        self._schedule_attribute(attribute, now)


def _moved(key: Any, nodes: Mapping[Any, Node]) -> Any:  # noqa: ANN401  # a node, alone or in a pair
    """Return a key of facts in another network."""
    if isinstance(key, Node):
        return nodes[key.element]
    word, node = key
    return word, nodes[node.element]


def _put(nodes: set[Node], node: Node, is_in: bool) -> None:
    (nodes.add if is_in else nodes.discard)(node)


def _is_adaptable(node: Node, status: Status) -> bool:
    """Return whether a function or component of this status needs a choice, or a better one."""
    if status is Status.SOLVED:
        return bool(node.element.always_improve)
    return status in (Status.UNSOLVED, Status.CONFIGURATION_ERROR)


def in_order(nodes: Iterable[Node]) -> list[Node]:
    """Return nodes in the order of declaration."""
    return sorted(nodes, key=attrgetter("index"))
