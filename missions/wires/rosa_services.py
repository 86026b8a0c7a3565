"""ROSA's own services: what the original's node `rosa_kb` answers, so that trees and planners elsewhere ask us."""

import logging
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partialmethod
from typing import Any, Final

from kb import KnowledgeBase, KnowledgeBaseError, ReconfigurationPlan
from kb.records import Process
from missions.wires.node import Message, Node, RosError
from missions.wires.ros import LOG as LOG_TYPE
from missions.wires.ros import WARN

LOG: Final = "/rosa/log"
_log = logging.getLogger(__name__)
BY_TYPE: Final = (
    (bool, 1, "bool_value"),
    (int, 2, "integer_value"),
    (float, 3, "double_value"),
    (str, 4, "string_value"),
)
"""Types of a parameter in rcl_interfaces/ParameterValue; an array of one has the type 5 more."""

_SERVICES: Final = {
    "action/request": "ActionQuery",
    "action/insert": "ActionQuery",
    "action/exists": "ActionQuery",
    "action/selectable": "ActionQueryArray",
    "function/adaptable": "AdaptableFunctions",
    "function/insert": "FunctionQuery",
    "component/adaptable": "AdaptableComponents",
    "component/insert": "ComponentQuery",
    "component/active/set": "ComponentQuery",
    "component/active/get": "ComponentQuery",
    "component_parameters/get": "GetComponentParameters",
    "function_designs/selectable": "SelectableFunctionDesigns",
    "function_designs/priority": "GetFunctionDesignPriority",
    "component_configuration/selectable": "SelectableComponentConfigurations",
    "component_configuration/priority": "GetComponentConfigurationPriority",
    "select_configuration": "SelectedConfigurations",
    "reconfiguration_plan/get": "ReconfigurationPlanQuery",
    "reconfiguration_plan/get_latest": "ReconfigurationPlanQuery",
    "reconfiguration_plan/result/set": "ReconfigurationPlanQuery",
    "component_process/insert": "ComponentProcessQuery",
    "component_process/end/set": "ComponentProcessQuery",
    "component_process/get_active": "ComponentProcessQueryArray",
    "function_design/insert": "FunctionDesignQuery",
    "functional_requirement/insert": "FunctionalRequirementQuery",
    "query": "Query",
}
"""The original's table: what is served under `/rosa_kb/`, and of which type; the method has the service's name."""


class RosaServices:
    """Serves ROSA's table of services under `/rosa_kb/` with a knowledge base; requests go through its gate.

    What has a text from the original's own types keeps its name; times are ISO 8601, of the knowledge base's clock.

    Args:
        kb: which is asked and told.
        node: that serves.
    """

    def __init__(self, kb: KnowledgeBase, node: Node) -> None:
        self._kb, self._node = kb, node
        unknown = []
        for name, kind in _SERVICES.items():
            package = "ros_typedb_msgs" if kind == "Query" else "rosa_msgs"
            answer = getattr(self, f"_{name.replace('/', '_')}")
            try:
                node.serve(f"/rosa_kb/{name}", f"{package}/srv/{kind}", self._answering(name, answer))
            except RosError:  # this node does not have its type
                unknown.append(name)
        if unknown:
            _log.warning("of /rosa_kb/ is not served, as their types are not there: %s", ", ".join(unknown))

    def _answering(self, name: str, answer: Callable[[Message], Message]) -> Callable[[Message], Message]:
        """Have each answer say `success`; why something is refused, for which it has no field, is logged."""

        def answered(request: Message) -> Message:
            try:
                return {**answer(request), "success": True}
            except (KnowledgeBaseError, RosError) as error:
                told = log_message(self._kb.now, WARN, f"/rosa_kb/{name} is refused: {error}")
                self._node.publish(LOG, LOG_TYPE, told)
                return {"success": False}

        return answered

    def _action_request(self, one: Message) -> Message:
        """Request an action, or cancel it where `is_required` is false, as the original's tree does."""
        name = _name(one, "action")
        if not one["action"].get("is_required"):
            self._kb.cancel_action(name)
        elif not (reply := self._kb.request_action(name, preference=str(one.get("preference") or "") or None)):
            raise RosError(reply.reason)
        return {"action": self._action(name)}

    def _action_exists(self, one: Message) -> Message:
        name = _name(one, "action")
        if name not in self._kb.actions:
            raise RosError(f"there is no action {name!r}; there are {', '.join(self._kb.actions)}")
        return {"action": self._action(name)}

    def _action_selectable(self, one: Message) -> Message:
        asked = _names(one, "actions")
        names = self._kb.selectable_actions()
        return {"actions": [self._action(name) for name in names if name in asked or not asked]}

    def _function_adaptable(self, _: Message) -> Message:
        return {"functions": list(map(self._function, self._kb.adaptable_functions()))}

    def _component_adaptable(self, one: Message) -> Message:
        names = self._kb.adaptable_components(tuple(map(str, one.get("selected_fds") or ())))
        return {"components": list(map(self._component, names))}

    def _function_designs_selectable(self, one: Message) -> Message:
        return {"fds": list(map(self._design, self._kb.selectable_designs(_name(one, "function"))))}

    def _function_designs_priority(self, one: Message) -> Message:
        return {"fds": list(map(self._design, _names(one, "fds")))}

    def _component_configuration_selectable(self, one: Message) -> Message:
        names = self._kb.selectable_configurations(_name(one, "component"))
        return {"c_configs": list(map(self._configuration, names))}

    def _component_configuration_priority(self, one: Message) -> Message:
        return {"c_configs": list(map(self._configuration, _names(one, "c_configs")))}

    def _select_configuration(self, one: Message) -> Message:
        designs, configurations = _names(one, "selected_fds"), _names(one, "selected_component_configs")
        self._kb.select(
            designs={self._kb.designs[name].function: name for name in designs},
            configurations={self._kb.configurations[name].component: name for name in configurations},
        )
        return {}

    def _reconfiguration_plan_get(self, one: Message) -> Message:
        return {"reconfig_plan": self._plan(self._meant_plan(one))}

    def _reconfiguration_plan_get_latest(self, _: Message) -> Message:
        latest = self._kb.latest_plan
        if latest is None:
            raise RosError("there is no reconfiguration plan yet")
        return {"reconfig_plan": self._plan(latest)}

    def _reconfiguration_plan_result_set(self, one: Message) -> Message:
        self._kb.finish_plan(self._meant_plan(one), str(one["reconfig_plan"].get("result")))
        return self._reconfiguration_plan_get(one)

    def _meant_plan(self, one: Message) -> ReconfigurationPlan:
        start = str(_part(one, "reconfig_plan").get("start_time"))
        found = [plan for plan in self._kb.plans if iso(plan.start) == start]
        if not found:
            latest = ", ".join(iso(plan.start) for plan in self._kb.plans[-3:]) or "none"
            raise RosError(f"no reconfiguration plan has start_time {start!r}; the latest: {latest}")
        return found[-1]

    def _component_active_get(self, one: Message) -> Message:
        return {"component": self._component(_name(one, "component"))}

    def _component_active_set(self, one: Message) -> Message:
        self._kb.component_active(_name(one, "component"), bool(one["component"].get("is_active")))
        return self._component_active_get(one)

    def _component_parameters_get(self, one: Message) -> Message:
        view = self._kb.configurations[_name(one, "c_config")]
        return {"component": self._component(view.component), "parameters": parameter_messages(view.parameters)}

    def _component_process_insert(self, one: Message) -> Message:
        given = _part(one, "component_process")
        process = self._kb.component_started(_name(given, "component"), given.get("pid", 0))
        return {"component_process": self._process(process)}

    def _component_process_end_set(self, one: Message) -> Message:
        given = _part(one, "component_process")
        self._kb.component_ended(_name(given, "component"), given.get("pid") or None)
        return {"component_process": given}

    def _component_process_get_active(self, _: Message) -> Message:
        return {"component_process": [self._process(one) for one in self._kb.processes if one.end is None]}

    def _insert(self, kind: str, one: Message) -> Message:
        name, model = _name(one, kind), self._kb.model
        if name not in getattr(self._kb, f"{kind}s"):
            getattr(model, kind)(name)
        return {kind: getattr(self, f"_{kind}")(name)}

    _action_insert = partialmethod(_insert, "action")
    _function_insert = partialmethod(_insert, "function")
    _component_insert = partialmethod(_insert, "component")

    def _function_design_insert(self, one: Message) -> Message:
        given = _part(one, "function_design")
        function, name = self._kb.model.functions[_name(given, "function")], _name(one, "function_design")
        components = [self._kb.model.components[c] for c in _names(given, "required_components")]
        if name not in self._kb.designs:
            function.design(name, components, priority=given.get("priority", 1.0))
        return {"function_design": self._design(name)}

    def _functional_requirement_insert(self, one: Message) -> Message:
        given, model = _part(one, "functional_requirement"), self._kb.model
        action = model.actions[_name(given, "action")]
        names = dict.fromkeys([*self._kb.actions[action.name].functions, *_names(given, "required_functions")])
        model.change(action, functions=[model.functions[name] for name in names])
        return {"functional_requirement": given}

    def _query(self, one: Message) -> Message:
        asked = str(one.get("query", ""))[:60]
        raise RosError(f"TypeQL is not answered here, as {asked!r}; ask by the other services, or by kb.query")

    def _action(self, name: str) -> Message:
        view = self._kb.actions[name]
        return {"name": name, "status": str(view.status), "is_required": view.is_required}

    def _function(self, name: str) -> Message:
        return {"name": name, "status": str(self._kb.functions[name].status)}

    def _component(self, name: str) -> Message:
        view = self._kb.components[name]
        told: Message = {"name": name, "status": str(view.status)}
        told |= {"package": view.package, "executable": view.executable}
        told |= {"node_type": str(view.kind), "is_active": view.is_active, "always_improve": view.always_improve}
        return {**told, "parameters": parameter_messages(view.parameters_in_force)}

    def _design(self, name: str) -> Message:
        view = self._kb.designs[name]
        told = {"name": name, "status": str(view.status), "priority": float(view.priority or 0.0)}
        return {
            **told,
            "function": self._function(view.function),
            "required_components": list(map(self._component, view.components)),
        }

    def _configuration(self, name: str) -> Message:
        view = self._kb.configurations[name]
        told = {"name": name, "status": str(view.status), "priority": float(view.priority or 0.0)}
        return {**told, "component": self._component(view.component)}

    def _plan(self, plan: ReconfigurationPlan) -> Message:
        return {
            **{"start_time": iso(plan.start), "end_time": "" if plan.end is None else iso(plan.end)},
            "result": plan.result or "",
            "components_activate": list(map(self._component, plan.activate)),
            "components_deactivate": list(map(self._component, plan.deactivate)),
            "component_configurations": list(map(self._configuration, plan.parameters)),
        }

    def _process(self, one: Process) -> Message:
        times = {"start_time": iso(one.start), "end_time": "" if one.end is None else iso(one.end)}
        return {"pid": one.pid, **times, "component": self._component(one.component)}


def iso(time_s: float) -> str:
    """Return a time [s since 1970] as ISO 8601, to the millisecond."""
    return datetime.fromtimestamp(time_s, UTC).replace(tzinfo=None).isoformat(timespec="milliseconds")


def parameter_messages(parameters: Mapping[str, Any]) -> list[Message]:
    """Return parameters as rcl_interfaces/Parameter."""
    return [{"name": name, "value": _value_message(value)} for name, value in parameters.items()]


def _value_message(value: Any) -> Message:  # noqa: ANN401  # of a parameter
    one = value[0] if isinstance(value, list) and value else 0.0 if isinstance(value, list) else value
    code, field = next((code, field) for kind, code, field in BY_TYPE if isinstance(one, kind))
    if isinstance(value, list):
        return {"type": code + 5, f"{field.removesuffix('_value')}_array_value": value}
    return {"type": code, field: value}


def log_message(time_s: float, level: int, text: str) -> Message:
    whole, part = divmod(round(time_s * 1e9), 10**9)
    told = {"stamp": {"sec": whole, "nanosec": part}, "level": level, "name": "rosa_kb", "msg": text}
    return {**told, "file": "", "function": "", "line": 0}


def _part(one: Message, key: str) -> Message:
    part = one.get(key)
    if not isinstance(part, dict):
        raise RosError(f"the request has a field {key!r}, an object; given are {', '.join(one) or 'none'}")
    return part


def _name(one: Message, key: str) -> str:
    name = _part(one, key).get("name")
    if not isinstance(name, str) or not name:
        raise RosError(f"{key} has a field 'name', a text")
    return name


def _names(one: Message, key: str) -> list[str]:
    return [_name({key: part}, key) for part in one.get(key) or ()]
