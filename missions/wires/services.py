"""ROSA's own services, as the original's node `rosa_kb` serves them to trees and planners."""

import logging
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from kb import KnowledgeBase, ReconfigurationPlan
from kb.records import Process
from missions.wires import ros
from missions.wires.node import Answer, Message, Node, RosError

LOG: Final = "/rosa/log"
_BY_TYPE: Final = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
"""Codes and names of types in rcl_interfaces/ParameterValue; the code of an array is 5 more."""
_KINDS: Final = {
    "fds": "design",
    "c_configs": "configuration",
    "component_configurations": "configuration",
    "required_components": "component",
    "components_activate": "component",
    "components_deactivate": "component",
}
"""The kinds of elements in fields that are not named after them."""
_OF_COMPONENT: Final = ("package", "executable", "is_active", "always_improve")
_log = logging.getLogger(__name__)


class RosaServices:
    """Serves ROSA's services under `/rosa_kb/` from a knowledge base.

    Services, types and fields have the original's names; times are ISO 8601, by the knowledge
    base's clock. Its services that insert elements, or query in TypeQL, are not there.
    """

    def __init__(self, kb: KnowledgeBase, node: Node) -> None:
        self._kb = kb
        self._node = node
        try:
            for name, (kind, answer) in self._table().items():
                respond = partial(self._answer, name, answer)
                node.serve(f"/rosa_kb/{name}", f"rosa_msgs/srv/{kind}", respond)
        except RosError as error:  # rosa_msgs is not installed
            _log.warning("ROSA's services are not served: %s", error)

    def _table(self) -> dict[str, tuple[str, Answer]]:
        """Return the services: by name under `/rosa_kb/` the type, and what answers a request."""
        kb = self._kb
        elements = self._list
        plan = "ReconfigurationPlanQuery"
        process = "ComponentProcessQuery"
        return {
            "action/exists": ("ActionQuery", partial(self._get, "action")),
            "action/request": ("ActionQuery", self._request_action),
            "action/selectable": ("ActionQueryArray", self._selectable_actions),
            "function/adaptable": (
                "AdaptableFunctions",
                lambda _: elements("functions", kb.adaptable_functions()),
            ),
            "component/adaptable": (
                "AdaptableComponents",
                lambda request: elements(
                    "components", kb.adaptable_components(request["selected_fds"])
                ),
            ),
            "component/active/set": ("ComponentQuery", self._set_active),
            "component/active/get": ("ComponentQuery", partial(self._get, "component")),
            "component_parameters/get": ("GetComponentParameters", self._parameters),
            "function_designs/selectable": (
                "SelectableFunctionDesigns",
                lambda request: elements("fds", kb.selectable_designs(request["function"]["name"])),
            ),
            "function_designs/priority": (
                "GetFunctionDesignPriority",
                lambda request: elements("fds", _names(request["fds"])),
            ),
            "component_configuration/selectable": (
                "SelectableComponentConfigurations",
                lambda request: elements(
                    "c_configs", kb.selectable_configurations(request["component"]["name"])
                ),
            ),
            "component_configuration/priority": (
                "GetComponentConfigurationPriority",
                lambda request: elements("c_configs", _names(request["c_configs"])),
            ),
            "select_configuration": ("SelectedConfigurations", self._select),
            "reconfiguration_plan/get": (
                plan,
                lambda request: self._plan(self._find_plan(request)),
            ),
            "reconfiguration_plan/get_latest": (plan, lambda _: self._plan(kb.latest_plan)),
            "reconfiguration_plan/result/set": (plan, self._finish_plan),
            "component_process/insert": (process, self._start_process),
            "component_process/end/set": (process, self._end_process),
            "component_process/get_active": (f"{process}Array", self._processes),
        }

    def _answer(self, name: str, answer: Answer, request: Message) -> Message:
        """Add `success` to an answer; answers have no field for a reason, so `/rosa/log` has it."""
        try:
            return {**answer(request), "success": True}
        except Exception as error:  # of the request, or our own, which must not end the node
            text = f"/rosa_kb/{name} is refused: {error}"
            self._node.publish(LOG, ros.LOG, ros.log(self._kb.now, ros.WARN, text))
            return {"success": False}

    # ---------------------------------------------------------------- what requests do

    def _request_action(self, request: Message) -> Message:
        """Request an action; cancel it if `is_required` is false, as ROSA's tree does."""
        name = request["action"]["name"]
        if request["action"].get("is_required"):
            reply = self._kb.request_action(name, preference=request.get("preference") or None)
            if not reply:
                raise RosError(reply.reason)
        else:
            self._kb.cancel_action(name)
        return self._get("action", request)

    def _selectable_actions(self, request: Message) -> Message:
        names = _names(request["actions"])
        selectable = self._kb.selectable_actions()
        return self._list("actions", [n for n in selectable if n in names or not names])

    def _select(self, request: Message) -> Message:
        designs = _names(request["selected_fds"])
        configurations = _names(request["selected_component_configs"])
        self._kb.select(
            designs={self._kb.designs[name].function: name for name in designs},
            configurations={
                self._kb.configurations[name].component: name for name in configurations
            },
        )
        return {}

    def _finish_plan(self, request: Message) -> Message:
        self._kb.finish_plan(self._find_plan(request), str(request["reconfig_plan"]["result"]))
        return self._plan(self._find_plan(request))

    def _find_plan(self, request: Message) -> ReconfigurationPlan:
        start = request["reconfig_plan"]["start_time"]
        for plan in reversed(self._kb.plans):
            if _iso(plan.start) == start:
                return plan
        raise RosError(f"no reconfiguration plan has start_time {start!r}")

    def _start_process(self, request: Message) -> Message:
        process = request["component_process"]
        started = self._kb.component_started(process["component"]["name"], process["pid"])
        return {"component_process": self._process(started)}

    def _end_process(self, request: Message) -> Message:
        process = request["component_process"]
        self._kb.component_ended(process["component"]["name"], process["pid"])
        return request

    def _processes(self, _: Message) -> Message:
        active = [process for process in self._kb.history.processes if process.end is None]
        return {"component_process": [self._process(process) for process in active]}

    def _set_active(self, request: Message) -> Message:
        component = request["component"]
        self._kb.component_active(component["name"], bool(component["is_active"]))
        return self._get("component", request)

    def _parameters(self, request: Message) -> Message:
        view = self._kb.configurations[request["c_config"]["name"]]
        component = self._element("component", view.component)
        return {"component": component, "parameters": parameter_messages(view.parameters)}

    def _get(self, kind: str, request: Message) -> Message:
        return {kind: self._element(kind, request[kind]["name"])}

    # ---------------------------------------------------------------- elements as messages

    def _list(self, field: str, names: Iterable[str]) -> Message:
        kind = _KINDS.get(field, field.rstrip("s"))
        return {field: [self._element(kind, name) for name in names]}

    def _element(self, kind: str, name: str) -> Message:
        view = getattr(self._kb, f"{kind}s")[name]
        fields: Message = {"name": name, "status": str(view.status)}
        if kind == "action":
            fields["is_required"] = view.is_required
        elif kind == "component":
            fields["node_type"] = str(view.kind)
            fields["parameters"] = parameter_messages(view.parameters_in_force)
            fields |= {field: getattr(view, field) for field in _OF_COMPONENT}
        elif kind != "function":
            owner = "function" if kind == "design" else "component"
            fields["priority"] = float(view.priority or 0.0)
            fields[owner] = self._element(owner, getattr(view, owner))
        if kind == "design":
            fields |= self._list("required_components", view.components)
        return fields

    def _plan(self, plan: ReconfigurationPlan | None) -> Message:
        if plan is None:
            raise RosError("there is no reconfiguration plan yet")
        message = {
            **_span(plan),
            "result": plan.result or "",
            **self._list("components_activate", plan.activate),
            **self._list("components_deactivate", plan.deactivate),
            **self._list("component_configurations", plan.parameters),
        }
        return {"reconfig_plan": message}

    def _process(self, process: Process) -> Message:
        component = self._element("component", process.component)
        return {"pid": process.pid, **_span(process), "component": component}


def _span(record: ReconfigurationPlan | Process) -> Message:
    end = "" if record.end is None else _iso(record.end)
    return {"start_time": _iso(record.start), "end_time": end}


def _iso(time_s: float) -> str:
    """Return a time [s since 1970] as ISO 8601, to the millisecond."""
    moment = datetime.fromtimestamp(time_s, UTC).replace(tzinfo=None)
    return moment.isoformat(timespec="milliseconds")


def parameter_messages(parameters: Mapping[str, Any]) -> list[Message]:
    """Return parameters as rcl_interfaces/Parameter."""
    return [{"name": name, "value": _value_message(value)} for name, value in parameters.items()]


def _value_message(value: Any) -> Message:  # noqa: ANN401  # of a parameter
    is_list = isinstance(value, list)
    example = (value or [0.0])[0] if is_list else value
    code, name = next(_BY_TYPE[kind] for kind in _BY_TYPE if isinstance(example, kind))
    if is_list:
        return {"type": code + 5, f"{name}_array_value": value}
    return {"type": code, f"{name}_value": value}


def _names(elements: Iterable[Message]) -> list[str]:
    return [element["name"] for element in elements]
