"""ROSA's own services, as the original's node `rosa_kb` serves them to trees and planners."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from kb import KnowledgeBase, KnowledgeBaseError, ReconfigurationPlan
from kb.records import Process
from missions.wires import ros
from missions.wires.node import Answer, Message, Node, RosError

LOG: Final = "/rosa/log"
_BY_TYPE: Final = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
"""Codes and names of types in rcl_interfaces/ParameterValue; the code of an array is 5 more."""
_OF_COMPONENT: Final = ("package", "executable", "is_active", "always_improve")
_log = logging.getLogger(__name__)


class RosaServices:
    """Serves ROSA's services under `/rosa_kb/` from a knowledge base.

    Services, types and fields have the original's names; times are ISO 8601, by the knowledge
    base's clock.
    """

    def __init__(self, kb: KnowledgeBase, node: Node) -> None:
        self._kb = kb
        self._node = node
        unknown = []
        for name, kind, answer in self._table():
            package = "ros_typedb_msgs" if kind == "Query" else "rosa_msgs"
            respond = partial(self._answer, name, answer)
            try:
                node.serve(f"/rosa_kb/{name}", f"{package}/srv/{kind}", respond)
            except RosError:  # this type is not installed
                unknown.append(name)
        if unknown:
            names = ", ".join(unknown)
            _log.warning("not served under /rosa_kb/, as their types are not known: %s", names)

    def _table(self) -> Iterator[tuple[str, str, Answer]]:
        """Yield each service: its name under `/rosa_kb/`, its type, and what answers a request."""
        kb, plan = self._kb, "ReconfigurationPlanQuery"
        yield "action/request", "ActionQuery", self._request_action
        yield "action/exists", "ActionQuery", partial(self._get, "action")
        yield "action/insert", "ActionQuery", partial(self._insert, "action")
        yield "action/selectable", "ActionQueryArray", self._selectable_actions
        yield "function/insert", "FunctionQuery", partial(self._insert, "function")
        yield "function/adaptable", "AdaptableFunctions", self._adaptable_functions
        yield "function_design/insert", "FunctionDesignQuery", self._insert_design
        yield "function_designs/selectable", "SelectableFunctionDesigns", self._selectable_designs
        yield "function_designs/priority", "GetFunctionDesignPriority", partial(self._named, "fds")
        yield "functional_requirement/insert", "FunctionalRequirementQuery", self._insert_need
        yield "component/insert", "ComponentQuery", partial(self._insert, "component")
        yield "component/adaptable", "AdaptableComponents", self._adaptable_components
        yield "component/active/set", "ComponentQuery", self._set_active
        yield "component/active/get", "ComponentQuery", partial(self._get, "component")
        configurations = "component_configuration"
        selectable = "SelectableComponentConfigurations"
        yield f"{configurations}/selectable", selectable, self._selectable_configurations
        priority = "GetComponentConfigurationPriority"
        yield f"{configurations}/priority", priority, partial(self._named, "c_configs")
        yield "component_parameters/get", "GetComponentParameters", self._parameters
        yield "component_process/insert", "ComponentProcessQuery", self._start_process
        yield "component_process/end/set", "ComponentProcessQuery", self._end_process
        yield "component_process/get_active", "ComponentProcessQueryArray", self._processes
        yield "select_configuration", "SelectedConfigurations", self._select
        yield "reconfiguration_plan/get", plan, lambda request: self._plan(self._find_plan(request))
        yield "reconfiguration_plan/get_latest", plan, lambda _: self._plan(kb.latest_plan)
        yield "reconfiguration_plan/result/set", plan, self._finish_plan
        yield "query", "Query", _refuse_query

    def _answer(self, name: str, answer: Answer, request: Message) -> Message:
        """Add `success` to an answer; answers have no field for a reason, so `/rosa/log` has it."""
        try:
            return {**answer(request), "success": True}
        except (KnowledgeBaseError, RosError) as error:
            text = f"/rosa_kb/{name} is refused: {error}"
            self._node.publish(LOG, ros.LOG, ros.log(self._kb.now, ros.WARN, text))
            return {"success": False}

    # ---------------------------------------------------------------- what requests do

    def _request_action(self, request: Message) -> Message:
        """Request an action; cancel it if `is_required` is false, as ROSA's tree does."""
        name = _name(request, "action")
        if request["action"].get("is_required"):
            reply = self._kb.request_action(name, preference=request.get("preference") or None)
            if not reply:
                raise RosError(reply.reason)
        else:
            self._kb.cancel_action(name)
        return self._get("action", request)

    def _selectable_actions(self, request: Message) -> Message:
        names = _names(request, "actions")
        selectable = self._kb.selectable_actions()
        return {
            "actions": self._things("action", [n for n in selectable if n in names or not names])
        }

    def _adaptable_functions(self, _: Message) -> Message:
        return {"functions": self._things("function", self._kb.adaptable_functions())}

    def _adaptable_components(self, request: Message) -> Message:
        designs = tuple(map(str, request.get("selected_fds") or ()))
        return {"components": self._things("component", self._kb.adaptable_components(designs))}

    def _selectable_designs(self, request: Message) -> Message:
        names = self._kb.selectable_designs(_name(request, "function"))
        return {"fds": self._things("design", names)}

    def _selectable_configurations(self, request: Message) -> Message:
        names = self._kb.selectable_configurations(_name(request, "component"))
        return {"c_configs": self._things("configuration", names)}

    def _named(self, field: str, request: Message) -> Message:
        kind = "design" if field == "fds" else "configuration"
        return {field: self._things(kind, _names(request, field))}

    def _select(self, request: Message) -> Message:
        designs = _names(request, "selected_fds")
        configurations = _names(request, "selected_component_configs")
        by_function = {self._kb.designs[name].function: name for name in designs}
        by_component = {self._kb.configurations[name].component: name for name in configurations}
        self._kb.select(designs=by_function, configurations=by_component)
        return {}

    def _finish_plan(self, request: Message) -> Message:
        result = str(_part(request, "reconfig_plan").get("result"))
        self._kb.finish_plan(self._find_plan(request), result)
        return self._plan(self._find_plan(request))

    def _find_plan(self, request: Message) -> ReconfigurationPlan:
        start = str(_part(request, "reconfig_plan").get("start_time"))
        for plan in reversed(self._kb.plans):
            if _iso(plan.start) == start:
                return plan
        latest = ", ".join(_iso(plan.start) for plan in self._kb.plans[-3:]) or "none"
        raise RosError(f"no reconfiguration plan has start_time {start!r}; the latest: {latest}")

    def _set_active(self, request: Message) -> Message:
        is_active = bool(_part(request, "component").get("is_active"))
        self._kb.component_active(_name(request, "component"), is_active)
        return self._get("component", request)

    def _parameters(self, request: Message) -> Message:
        view = self._kb.configurations[_name(request, "c_config")]
        parameters = parameter_messages(view.parameters)
        return {"component": self._thing("component", view.component), "parameters": parameters}

    def _start_process(self, request: Message) -> Message:
        part = _part(request, "component_process")
        process = self._kb.component_started(_name(part, "component"), part.get("pid", 0))
        return {"component_process": self._process(process)}

    def _end_process(self, request: Message) -> Message:
        part = _part(request, "component_process")
        self._kb.component_ended(_name(part, "component"), part.get("pid") or None)
        return {"component_process": part}

    def _processes(self, _: Message) -> Message:
        active = [process for process in self._kb.history.processes if process.end is None]
        return {"component_process": [self._process(process) for process in active]}

    def _get(self, kind: str, request: Message) -> Message:
        return {kind: self._thing(kind, _name(request, kind))}

    def _insert(self, kind: str, request: Message) -> Message:
        name = _name(request, kind)
        if name not in getattr(self._kb, f"{kind}s"):
            getattr(self._kb.model, kind)(name)
        return self._get(kind, request)

    def _insert_design(self, request: Message) -> Message:
        part = _part(request, "function_design")
        name = _name(request, "function_design")
        function = self._kb.model.functions[_name(part, "function")]
        components = _names(part, "required_components")
        if name not in self._kb.designs:
            function.design(name, components, priority=part.get("priority", 1.0))
        return {"function_design": self._thing("design", name)}

    def _insert_need(self, request: Message) -> Message:
        part = _part(request, "functional_requirement")
        model = self._kb.model
        action = model.actions[_name(part, "action")]
        names = [*self._kb.actions[action.name].functions, *_names(part, "required_functions")]
        model.change(action, functions=[model.functions[name] for name in dict.fromkeys(names)])
        return {"functional_requirement": part}

    # ---------------------------------------------------------------- elements as messages

    def _things(self, kind: str, names: Iterable[str]) -> list[Message]:
        return [self._thing(kind, name) for name in names]

    def _thing(self, kind: str, name: str) -> Message:
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
            fields[owner] = self._thing(owner, getattr(view, owner))
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

    def _process(self, process: Process) -> Message:
        component = self._thing("component", process.component)
        return {"pid": process.pid, **_span(process), "component": component}


def _refuse_query(request: Message) -> Message:
    text = str(request.get("query", ""))[:60]
    raise RosError(f"TypeQL such as {text!r} is not answered; use the other services, or kb.query")


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
    kinds = type(example).__mro__  # numpy's numbers are subclasses of these
    code, name = next(_BY_TYPE[kind] for kind in kinds if kind in _BY_TYPE)
    if is_list:
        return {"type": code + 5, f"{name}_array_value": value}
    return {"type": code, f"{name}_value": value}


def _part(request: Message, key: str) -> Message:
    part = request.get(key)
    if not isinstance(part, dict):
        fields = ", ".join(request) or "none"
        raise RosError(f"the request needs an object in the field {key!r}; its fields are {fields}")
    return part


def _name(request: Message, key: str) -> str:
    name = _part(request, key).get("name")
    if not isinstance(name, str) or not name:
        raise RosError(f"{key} needs a text in the field 'name'")
    return name


def _names(request: Message, key: str) -> list[str]:
    return [_name({key: part}, key) for part in request.get(key) or ()]
