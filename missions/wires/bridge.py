"""Connects a robot in ROS 2 with its knowledge base: topics measure attributes, nodes are components.

settings = BridgeSettings(attributes={"battery_level": "/battery_state.percentage"})
bridge = Bridge(kb, Rosbridge("ws://127.0.0.1:9090"), settings)
manager = ConfigurationManager(kb, bridge.managed)

It also serves ROSA's own services, as the original's node `rosa_kb` does, so trees and planners elsewhere can ask us.
"""

import logging
import tomllib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

from kb import (
    ComponentKind,
    Event,
    EventKind,
    KnowledgeBase,
    KnowledgeBaseError,
    ReconfigurationPlan,
)
from kb.elements import Parameters
from kb.records import Process
from missions.engine.mission import MissionError, Percepts
from missions.wires import ros
from missions.wires.node import Answer, Message, Node, Refusals, RosError

_log = logging.getLogger(__name__)
_WORDS: Final = {
    EventKind.MONITORING_DATA: "insert_monitoring_data",
    EventKind.ACTION_UPDATE: "action_update",
    EventKind.RECONFIGURATION_PLAN: "insert_reconfiguration_plan",
}
"""The words by which the original ROSA's planner and executor recognise events."""
_UNCONFIGURED, _INACTIVE, _ACTIVE = 1, 2, 3
"""States of lifecycle_msgs/State."""
_CONFIGURE, _ACTIVATE, _DEACTIVATE = 1, 3, 4
"""Transitions of lifecycle_msgs/Transition."""
Calls = Generator[Future[Message], Message, None]
LOG: Final = "/rosa/log"
_KINDS: Final = {"fds": "design", "c_configs": "configuration"}
"""The kind of the elements in a field whose name does not say it."""
_BY_TYPE: Final = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
"""Codes and names of types in rcl_interfaces/ParameterValue; the code of an array is 5 more."""
_OF_COMPONENT: Final = ("package", "executable", "is_active", "always_improve")


@dataclass(frozen=True)
class BridgeSettings:
    """Which topics and nodes of a robot are which attributes and components; `bridge.toml` has the same fields.

    Attributes:
        url: of the robot's rosbridge, e.g. "ws://127.0.0.1:9090".
        diagnostics: the topic of diagnostic_msgs/DiagnosticArray; empty for none.
        attributes: for each name the field that measures it, "/topic.field" (more dots lead to deeper fields and array
            elements), and after a space the type, e.g. "/battery_state.percentage sensor_msgs/msg/BatteryState".
        components: for each name its node, e.g. "/camera"; a lifecycle component that is not named here is the node
            with its own name.
    """

    url: str = "ws://127.0.0.1:9090"
    diagnostics: str = "/diagnostics"
    attributes: Mapping[str, str] = field(default_factory=dict)
    components: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> "BridgeSettings":
        """Read `bridge.toml`.

        Raises:
            MissionError: it cannot be read, or a field is unknown or of the wrong type.
        """
        try:
            read = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise MissionError(
                f"cannot read {path}: {getattr(error, 'strerror', None) or error}"
            ) from None
        known = {one.name: one for one in fields(cls)}
        for name, value in read.items():
            if name not in known:
                raise MissionError(
                    f"{path} has an unknown field {name!r}; known are {', '.join(known)}"
                )
            wanted = dict if name in ("attributes", "components") else str
            texts = value.values() if isinstance(value, dict) else (value,)
            if not isinstance(value, wanted) or not all(isinstance(one, str) for one in texts):
                raise MissionError(
                    f"{name} in {path} must be {'a table of texts' if wanted is dict else 'a text'}"
                )
        return cls(**read)


class Bridge:
    """Connects a knowledge base and a robot, in both directions, until `close`.

    Measurements are told to the knowledge base in the thread of the connection. Events are published on
    `/rosa_kb/events`, decisions with their reasons on `/rosa/log`, and ROSA's services are served. While there is no
    connection, the attributes that are measured over it are stale.

    Args:
        percepts: get the diagnostics too, for the conditions of a mission.

    Attributes:
        managed: the robot's nodes, as the managed system of a `ConfigurationManager`.
        heard: how many messages were used.
        refused: how many were not used, by what was wrong.
        is_connected: whether the robot is connected; while it is not, do not update the manager.

    Raises:
        MissionError, kb.UnknownName: the settings name a place that is malformed, or an element that is unknown.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        node: Node,
        settings: BridgeSettings | None = None,
        percepts: Percepts | None = None,
    ) -> None:
        self.heard, self.refused, self.is_connected = 0, Refusals(), False
        self._kb, self._node, chosen = kb, node, settings or BridgeSettings()
        self.managed = RosComponents(kb, node, chosen.components)
        self._percepts = percepts
        self._measured = list(chosen.attributes)
        for name, place in chosen.attributes.items():
            _ = kb.attributes[name]
            topic, path, kind = _place(name, place)
            node.subscribe(topic, kind, partial(self._measure, name, path))
        if chosen.diagnostics:
            node.subscribe(chosen.diagnostics, ros.DIAGNOSTICS, self._receive)
        RosaServices(kb, node)
        self._stop = kb.subscribe(self._publish)
        node.watch(self._changed)

    def close(self) -> None:
        """Stop publishing, and close the node."""
        self._stop()
        self._node.close()

    def _measure(self, name: str, path: list[str], message: Message) -> None:
        value: object = message
        try:
            for part in path:
                value = value[int(part)] if isinstance(value, list) else value[part]  # type: ignore[index]  # what cannot be is refused
            self._kb.measure(name, value)  # type: ignore[arg-type]  # it is checked there
            self.heard += 1
        except (LookupError, TypeError, ValueError, KnowledgeBaseError) as error:
            self.refused.add(f"{name}: {type(error).__name__}: {error}")

    def _receive(self, message: Message) -> None:
        problems = self._kb.receive(message)
        self.heard += 1
        if self._percepts is not None:
            self._percepts.receive({"status": list(_statuses(message))})
        for problem in problems:
            self.refused.add(f"{problem.key}: {problem.reason}")  # one kind, whatever the value

    def _publish(self, event: Event) -> None:
        kind = _WORDS.get(event.kind)
        if kind is None:
            return
        self._node.publish("/rosa_kb/events", ros.STRING, {"data": kind})
        if event.kind is not EventKind.MONITORING_DATA or event.changes:
            changes = "".join(f"; {one.name} is {one.new}" for one in event.changes)
            self._node.publish(LOG, ros.LOG, ros.log_of(event, changes))

    def _changed(self, is_connected: bool, text: str) -> None:
        _log.log(logging.INFO if is_connected else logging.WARNING, "%s", text)
        self.is_connected = is_connected
        if is_connected:
            self.managed.ask()
            return
        self.managed.forget()
        for name in self._measured:
            if self._kb.attributes[name].value is not None:
                self._kb.tell(Event(0, self._kb.now, "stale", (name,)))


class RosComponents:
    """Lifecycle nodes as a managed system: change_state switches them, set_parameters_atomically sets parameters.

    Args:
        names: of the nodes, by component; a lifecycle component that is not named is the node with its own name.
    """

    def __init__(self, kb: KnowledgeBase, node: Node, names: Mapping[str, str]) -> None:
        self._node = node
        for name in names:
            _ = kb.components[name]
        own = {
            name: name for name, one in kb.components.items() if one.kind is ComponentKind.LIFECYCLE
        }
        self._names = {name: f"/{one.strip('/')}" for name, one in {**own, **names}.items()}
        self._states: dict[str, int] = {}
        for name, place in self._names.items():
            kind = "lifecycle_msgs/msg/TransitionEvent"
            node.subscribe(f"{place}/transition_event", kind, partial(self._changed, name))

    def _changed(self, component: str, message: Message) -> None:
        self._states[component] = int(message["goal_state"]["id"])

    def ask(self) -> None:
        for name in self._names:
            self._follow(self._look(name))

    def forget(self) -> None:
        """Forget the states of all nodes, as the connection is lost."""
        self._states.clear()

    def activate(self, component: str, /) -> "Future[None]":
        return self._follow(self._switch(component, _ACTIVE))

    def deactivate(self, component: str, /) -> "Future[None]":
        return self._follow(self._switch(component, _INACTIVE))

    def set_parameters(self, component: str, parameters: Parameters, /) -> "Future[None]":
        return self._follow(self._set(component, parameters))

    def is_active(self, component: str, /) -> bool | None:
        """Tell whether a node is active after its last known transition; None if none is known."""
        state = self._states.get(component)
        return None if state is None else state == _ACTIVE

    def _look(self, component: str) -> Calls:
        answer = yield self._node.call(
            f"{self._place(component)}/get_state", "lifecycle_msgs/srv/GetState", {}
        )
        self._states[component] = int(answer["current_state"]["id"])

    def _switch(self, component: str, goal: int) -> Calls:
        yield from self._look(component)
        if self._states[component] == _UNCONFIGURED:
            if goal == _INACTIVE:
                return
            yield from self._change(component, _CONFIGURE, _INACTIVE)
        if self._states[component] != goal:
            yield from self._change(component, _ACTIVATE if goal == _ACTIVE else _DEACTIVATE, goal)

    def _change(self, component: str, transition: int, goal: int) -> Calls:
        request = {"transition": {"id": transition, "label": ""}}
        place = self._place(component)
        answer = yield self._node.call(
            f"{place}/change_state", "lifecycle_msgs/srv/ChangeState", request
        )
        if not answer.get("success"):
            raise RosError(
                f"{place} refuses the transition {transition} from {self._states[component]}"
            )
        self._states[component] = goal

    def _set(self, component: str, parameters: Parameters) -> Calls:
        request = {"parameters": parameter_messages(parameters)}
        kind = "rcl_interfaces/srv/SetParametersAtomically"
        answer = yield self._node.call(
            f"{self._place(component)}/set_parameters_atomically", kind, request
        )
        result = answer.get("result") or {}
        if not result.get("successful"):
            reason = result.get("reason") or "without a reason"
            raise RosError(f"{self._place(component)} refuses the parameters: {reason}")

    def _place(self, component: str) -> str:
        if component not in self._names:
            known = ", ".join(self._names) or "none"
            raise RosError(
                f"there is no node for {component!r}, only for {known}: name its node under components"
            )
        return self._names[component]

    def _follow(self, calls: Calls) -> "Future[None]":
        """Make calls one after the other, each when the last is answered, without waiting; cancelling stops them."""
        done: Future[None] = Future()

        def go_on(answered: "Future[Message] | None" = None) -> None:
            if done.cancelled():
                return
            try:
                error = None if answered is None else answered.exception()
                if error is not None:
                    following = calls.throw(error)
                else:
                    following = calls.send(None if answered is None else answered.result())  # type: ignore[arg-type]  # the first is None
            except StopIteration:
                done.set_result(None)
            except Exception as failure:  # the operation ends with this error
                done.set_exception(failure)
            else:
                following.add_done_callback(go_on)

        go_on()
        return done


def _statuses(message: Message) -> Iterator[Message]:
    """Yield the statuses of a DiagnosticArray with their values as a dict; malformed ones are left out."""
    for status in message.get("status") or ():
        with suppress(TypeError, LookupError, AttributeError):
            values = {str(pair["key"]): str(pair["value"]) for pair in status["values"]}
            yield {"message": str(status["message"]), "values": values}


def _place(attribute: str, text: str) -> tuple[str, list[str], str]:
    """Return the topic, the path to the field, and the message type (may be empty), of a text in the settings."""
    where, _, kind = text.strip().partition(" ")
    topic, *path = where.split(".")
    if not topic.startswith("/") or not all(path) or not path:
        raise MissionError(
            f"{attribute} is measured by {text!r}; write /topic.field, e.g. /battery_state.percentage"
        )
    return topic, path, kind.strip()


# ------------------------------------------------------------ ROSA's own services


class RosaServices:
    """Serves ROSA's services under `/rosa_kb/` from a knowledge base, which refuses what is unfeasible.

    Services, types and fields have the original's names; times are ISO 8601, by the knowledge base's clock.
    """

    def __init__(self, kb: KnowledgeBase, node: Node) -> None:
        self._kb, self._node = kb, node
        unknown = []
        for name, kind, answer in self._table():
            package = "ros_typedb_msgs" if kind == "Query" else "rosa_msgs"
            try:
                node.serve(
                    f"/rosa_kb/{name}", f"{package}/srv/{kind}", partial(self._answer, name, answer)
                )
            except RosError:  # the node's library does not have this type
                unknown.append(name)
        if unknown:
            _log.warning(
                "these services of /rosa_kb/ are not served, as their types are not known: %s",
                ", ".join(unknown),
            )

    def _table(self) -> Iterator[tuple[str, str, Answer]]:
        """Yield each service: its name under `/rosa_kb/`, its type, and the function that answers a request."""
        kb, configurations = self._kb, self._kb.selectable_configurations
        for kind in ("action", "function", "component"):
            yield f"{kind}/insert", f"{kind.capitalize()}Query", partial(self._insert, kind)
        for what, kind, held, whole, ask in (
            ("function_designs", "FunctionDesign", "fds", "function", kb.selectable_designs),
            (
                "component_configuration",
                "ComponentConfiguration",
                "c_configs",
                "component",
                configurations,
            ),
        ):
            yield (
                f"{what}/selectable",
                f"Selectable{kind}s",
                partial(self._selectable, held, whole, ask),
            )
            yield f"{what}/priority", f"Get{kind}Priority", partial(self._named, held)
        yield from (
            ("action/request", "ActionQuery", self._request_action),
            (
                "action/exists",
                "ActionQuery",
                lambda one: {"action": self._thing("action", _name(one, "action"))},
            ),
            ("action/selectable", "ActionQueryArray", self._selectable_actions),
            (
                "function/adaptable",
                "AdaptableFunctions",
                lambda _: self._all("functions", kb.adaptable_functions()),
            ),
            ("component/adaptable", "AdaptableComponents", self._adaptable_components),
            ("component/active/set", "ComponentQuery", self._set_active),
            (
                "component/active/get",
                "ComponentQuery",
                lambda one: self._component(_name(one, "component")),
            ),
            ("component_parameters/get", "GetComponentParameters", self._parameters),
            ("select_configuration", "SelectedConfigurations", self._select),
            (
                "reconfiguration_plan/get",
                "ReconfigurationPlanQuery",
                lambda one: self._plan(self._meant_plan(one)),
            ),
            (
                "reconfiguration_plan/get_latest",
                "ReconfigurationPlanQuery",
                lambda _: self._plan(kb.latest_plan),
            ),
            ("reconfiguration_plan/result/set", "ReconfigurationPlanQuery", self._finish_plan),
            ("component_process/insert", "ComponentProcessQuery", self._process_started),
            ("component_process/end/set", "ComponentProcessQuery", self._process_ended),
            ("component_process/get_active", "ComponentProcessQueryArray", self._active_processes),
            ("function_design/insert", "FunctionDesignQuery", self._insert_design),
            (
                "functional_requirement/insert",
                "FunctionalRequirementQuery",
                self._insert_requirement,
            ),
            ("query", "Query", _refuse_query),
        )

    def _answer(self, name: str, answer: Answer, request: Message) -> Message:
        """Add `success` to an answer; the reason of a refusal goes to `/rosa/log`, as answers have no field for it."""
        try:
            return {**answer(request), "success": True}
        except (KnowledgeBaseError, RosError) as error:
            entry = ros.log(self._kb.now, ros.WARN, f"/rosa_kb/{name} is refused: {error}")
            self._node.publish(LOG, ros.LOG, entry)
            return {"success": False}

    # ---------------------------------------------------------------- what requests do

    def _request_action(self, one: Message) -> Message:
        """Request an action, or cancel it if `is_required` is false, as the original's tree does."""
        name = _name(one, "action")
        if not one["action"].get("is_required"):
            self._kb.cancel_action(name)
        elif not (
            reply := self._kb.request_action(
                name, preference=str(one.get("preference") or "") or None
            )
        ):
            raise RosError(reply.reason)
        return {"action": self._thing("action", name)}

    def _selectable_actions(self, one: Message) -> Message:
        asked = _names(one, "actions")
        return self._all(
            "actions",
            [name for name in self._kb.selectable_actions() if name in asked or not asked],
        )

    def _selectable(
        self, field: str, whole: str, ask: Callable[[str], Iterable[str]], one: Message
    ) -> Message:
        return self._all(field, ask(_name(one, whole)))

    def _named(self, field: str, one: Message) -> Message:
        return self._all(field, _names(one, field))

    def _adaptable_components(self, one: Message) -> Message:
        designs = tuple(map(str, one.get("selected_fds") or ()))
        return self._all("components", self._kb.adaptable_components(designs))

    def _select(self, one: Message) -> Message:
        designs, configurations = (
            _names(one, "selected_fds"),
            _names(one, "selected_component_configs"),
        )
        self._kb.select(
            designs={self._kb.designs[name].function: name for name in designs},
            configurations={
                self._kb.configurations[name].component: name for name in configurations
            },
        )
        return {}

    def _finish_plan(self, one: Message) -> Message:
        self._kb.finish_plan(self._meant_plan(one), str(one["reconfig_plan"].get("result")))
        return self._plan(self._meant_plan(one))

    def _meant_plan(self, one: Message) -> ReconfigurationPlan:
        start = str(_part(one, "reconfig_plan").get("start_time"))
        found = [plan for plan in self._kb.plans if _iso(plan.start) == start]
        if not found:
            latest = ", ".join(_iso(plan.start) for plan in self._kb.plans[-3:]) or "none"
            raise RosError(
                f"no reconfiguration plan has start_time {start!r}; the latest: {latest}"
            )
        return found[-1]

    def _set_active(self, one: Message) -> Message:
        self._kb.component_active(_name(one, "component"), bool(one["component"].get("is_active")))
        return self._component(_name(one, "component"))

    def _component(self, name: str) -> Message:
        return {"component": self._thing("component", name)}

    def _parameters(self, one: Message) -> Message:
        view = self._kb.configurations[_name(one, "c_config")]
        return {
            **self._component(view.component),
            "parameters": parameter_messages(view.parameters),
        }

    def _process_started(self, one: Message) -> Message:
        given = _part(one, "component_process")
        process = self._kb.component_started(_name(given, "component"), given.get("pid", 0))
        return {"component_process": self._process(process)}

    def _process_ended(self, one: Message) -> Message:
        given = _part(one, "component_process")
        self._kb.component_ended(_name(given, "component"), given.get("pid") or None)
        return {"component_process": given}

    def _active_processes(self, _: Message) -> Message:
        return {
            "component_process": [
                self._process(one) for one in self._kb.processes if one.end is None
            ]
        }

    def _insert(self, kind: str, one: Message) -> Message:
        name = _name(one, kind)
        if name not in getattr(self._kb, f"{kind}s"):
            getattr(self._kb.model, kind)(name)
        return {kind: self._thing(kind, name)}

    def _insert_design(self, one: Message) -> Message:
        given = _part(one, "function_design")
        function, name = (
            self._kb.model.functions[_name(given, "function")],
            _name(one, "function_design"),
        )
        components = [self._kb.model.components[c] for c in _names(given, "required_components")]
        if name not in self._kb.designs:
            function.design(name, components, priority=given.get("priority", 1.0))
        return {"function_design": self._thing("design", name)}

    def _insert_requirement(self, one: Message) -> Message:
        given, model = _part(one, "functional_requirement"), self._kb.model
        action = model.actions[_name(given, "action")]
        names = dict.fromkeys(
            [*self._kb.actions[action.name].functions, *_names(given, "required_functions")]
        )
        model.change(action, functions=[model.functions[name] for name in names])
        return {"functional_requirement": given}

    # ---------------------------------------------------------------- elements as messages of the original's types

    def _all(self, field: str, names: Iterable[str]) -> Message:
        """Return a field of an answer: these elements, as messages of the field's type."""
        return {field: self._things(_KINDS.get(field, field.removesuffix("s")), names)}

    def _things(self, kind: str, names: Iterable[str]) -> list[Message]:
        return [self._thing(kind, name) for name in names]

    def _thing(self, kind: str, name: str) -> Message:
        view = getattr(self._kb, f"{kind}s")[name]
        fields: Message = {"name": name, "status": str(view.status)}
        if kind == "action":
            fields["is_required"] = view.is_required
        elif kind == "component":
            fields |= {
                "node_type": str(view.kind),
                "parameters": parameter_messages(view.parameters_in_force),
            }
            fields |= {field: getattr(view, field) for field in _OF_COMPONENT}
        elif kind != "function":
            whole = "function" if kind == "design" else "component"
            fields |= {
                "priority": float(view.priority or 0.0),
                whole: self._thing(whole, getattr(view, whole)),
            }
        if kind == "design":
            fields["required_components"] = self._things("component", view.components)
        return fields

    def _plan(self, plan: ReconfigurationPlan | None) -> Message:
        if plan is None:
            raise RosError("there is no reconfiguration plan yet")
        message = {
            **_span(plan),
            "result": plan.result or "",
            "components_activate": self._things("component", plan.activate),
            "components_deactivate": self._things("component", plan.deactivate),
            "component_configurations": self._things("configuration", plan.parameters),
        }
        return {"reconfig_plan": message}

    def _process(self, one: Process) -> Message:
        return {"pid": one.pid, **_span(one), **self._component(one.component)}


def _refuse_query(one: Message) -> Message:
    asked = str(one.get("query", ""))[:60]
    raise RosError(
        f"TypeQL such as {asked!r} is not answered here; use the other services, or kb.query"
    )


def _span(one: ReconfigurationPlan | Process) -> Message:
    return {"start_time": _iso(one.start), "end_time": "" if one.end is None else _iso(one.end)}


def _iso(time_s: float) -> str:
    """Return a time [s since 1970] as ISO 8601, to the millisecond."""
    return (
        datetime.fromtimestamp(time_s, UTC).replace(tzinfo=None).isoformat(timespec="milliseconds")
    )


def parameter_messages(parameters: Mapping[str, Any]) -> list[Message]:
    """Return parameters as rcl_interfaces/Parameter."""
    return [{"name": name, "value": _value_message(value)} for name, value in parameters.items()]


def _value_message(value: Any) -> Message:  # noqa: ANN401  # of a parameter
    is_list = isinstance(value, list)
    kinds = type(
        (value or [0.0])[0] if is_list else value
    ).__mro__  # numpy's numbers are subclasses of these
    code, name = next(_BY_TYPE[kind] for kind in kinds if kind in _BY_TYPE)
    return (
        {"type": code + 5, f"{name}_array_value": value}
        if is_list
        else {"type": code, f"{name}_value": value}
    )


def _part(one: Message, key: str) -> Message:
    part = one.get(key)
    if not isinstance(part, dict):
        raise RosError(
            f"the request needs an object in the field {key!r}; its fields are {', '.join(one) or 'none'}"
        )
    return part


def _name(one: Message, key: str) -> str:
    name = _part(one, key).get("name")
    if not isinstance(name, str) or not name:
        raise RosError(f"{key} needs a text in the field 'name'")
    return name


def _names(one: Message, key: str) -> list[str]:
    return [_name({key: part}, key) for part in one.get(key) or ()]
