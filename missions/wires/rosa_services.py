"""ROSA's own services, as the original's node `rosa_kb` serves them: trees and planners elsewhere can ask us."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from kb import KnowledgeBase, KnowledgeBaseError, ReconfigurationPlan
from kb.records import Process
from missions.wires import ros
from missions.wires.node import Answer, Message, Node, RosError

LOG: Final = "/rosa/log"
_KINDS: Final = {"fds": "design", "c_configs": "configuration"}
"""The kind of the elements in a field whose name does not say it."""
_log = logging.getLogger(__name__)
_BY_TYPE: Final = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
"""Codes and names of types in rcl_interfaces/ParameterValue; the code of an array is 5 more."""
_OF_COMPONENT: Final = ("package", "executable", "is_active", "always_improve")


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
                node.serve(f"/rosa_kb/{name}", f"{package}/srv/{kind}", partial(self._answer, name, answer))
            except RosError:  # the node's library does not have this type
                unknown.append(name)
        if unknown:
            _log.warning(
                "these services of /rosa_kb/ are not served, as their types are not known: %s", ", ".join(unknown)
            )

    def _table(self) -> Iterator[tuple[str, str, Answer]]:
        """Yield each service: its name under `/rosa_kb/`, its type, and the function that answers a request."""
        kb, configurations = self._kb, self._kb.selectable_configurations
        for kind in ("action", "function", "component"):
            yield f"{kind}/insert", f"{kind.capitalize()}Query", partial(self._insert, kind)
        for what, kind, field, whole, ask in (
            ("function_designs", "FunctionDesign", "fds", "function", kb.selectable_designs),
            ("component_configuration", "ComponentConfiguration", "c_configs", "component", configurations),
        ):
            yield f"{what}/selectable", f"Selectable{kind}s", partial(self._selectable, field, whole, ask)
            yield f"{what}/priority", f"Get{kind}Priority", partial(self._named, field)
        yield from (
            ("action/request", "ActionQuery", self._request_action),
            ("action/exists", "ActionQuery", lambda one: {"action": self._thing("action", _name(one, "action"))}),
            ("action/selectable", "ActionQueryArray", self._selectable_actions),
            ("function/adaptable", "AdaptableFunctions", lambda _: self._all("functions", kb.adaptable_functions())),
            ("component/adaptable", "AdaptableComponents", self._adaptable_components),
            ("component/active/set", "ComponentQuery", self._set_active),
            ("component/active/get", "ComponentQuery", lambda one: self._component(_name(one, "component"))),
            ("component_parameters/get", "GetComponentParameters", self._parameters),
            ("select_configuration", "SelectedConfigurations", self._select),
            ("reconfiguration_plan/get", "ReconfigurationPlanQuery", lambda one: self._plan(self._meant_plan(one))),
            ("reconfiguration_plan/get_latest", "ReconfigurationPlanQuery", lambda _: self._plan(kb.latest_plan)),
            ("reconfiguration_plan/result/set", "ReconfigurationPlanQuery", self._finish_plan),
            ("component_process/insert", "ComponentProcessQuery", self._process_started),
            ("component_process/end/set", "ComponentProcessQuery", self._process_ended),
            ("component_process/get_active", "ComponentProcessQueryArray", self._active_processes),
            ("function_design/insert", "FunctionDesignQuery", self._insert_design),
            ("functional_requirement/insert", "FunctionalRequirementQuery", self._insert_requirement),
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
        elif not (reply := self._kb.request_action(name, preference=str(one.get("preference") or "") or None)):
            raise RosError(reply.reason)
        return {"action": self._thing("action", name)}

    def _selectable_actions(self, one: Message) -> Message:
        asked = _names(one, "actions")
        return self._all("actions", [name for name in self._kb.selectable_actions() if name in asked or not asked])

    def _selectable(self, field: str, whole: str, ask: Callable[[str], Iterable[str]], one: Message) -> Message:
        return self._all(field, ask(_name(one, whole)))

    def _named(self, field: str, one: Message) -> Message:
        return self._all(field, _names(one, field))

    def _adaptable_components(self, one: Message) -> Message:
        designs = tuple(map(str, one.get("selected_fds") or ()))
        return self._all("components", self._kb.adaptable_components(designs))

    def _select(self, one: Message) -> Message:
        designs, configurations = _names(one, "selected_fds"), _names(one, "selected_component_configs")
        self._kb.select(
            designs={self._kb.designs[name].function: name for name in designs},
            configurations={self._kb.configurations[name].component: name for name in configurations},
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
            raise RosError(f"no reconfiguration plan has start_time {start!r}; the latest: {latest}")
        return found[-1]

    def _set_active(self, one: Message) -> Message:
        self._kb.component_active(_name(one, "component"), bool(one["component"].get("is_active")))
        return self._component(_name(one, "component"))

    def _component(self, name: str) -> Message:
        return {"component": self._thing("component", name)}

    def _parameters(self, one: Message) -> Message:
        view = self._kb.configurations[_name(one, "c_config")]
        return {**self._component(view.component), "parameters": parameter_messages(view.parameters)}

    def _process_started(self, one: Message) -> Message:
        given = _part(one, "component_process")
        process = self._kb.component_started(_name(given, "component"), given.get("pid", 0))
        return {"component_process": self._process(process)}

    def _process_ended(self, one: Message) -> Message:
        given = _part(one, "component_process")
        self._kb.component_ended(_name(given, "component"), given.get("pid") or None)
        return {"component_process": given}

    def _active_processes(self, _: Message) -> Message:
        return {"component_process": [self._process(one) for one in self._kb.processes if one.end is None]}

    def _insert(self, kind: str, one: Message) -> Message:
        name = _name(one, kind)
        if name not in getattr(self._kb, f"{kind}s"):
            getattr(self._kb.model, kind)(name)
        return {kind: self._thing(kind, name)}

    def _insert_design(self, one: Message) -> Message:
        given = _part(one, "function_design")
        function, name = self._kb.model.functions[_name(given, "function")], _name(one, "function_design")
        components = [self._kb.model.components[c] for c in _names(given, "required_components")]
        if name not in self._kb.designs:
            function.design(name, components, priority=given.get("priority", 1.0))
        return {"function_design": self._thing("design", name)}

    def _insert_requirement(self, one: Message) -> Message:
        given, model = _part(one, "functional_requirement"), self._kb.model
        action = model.actions[_name(given, "action")]
        names = dict.fromkeys([*self._kb.actions[action.name].functions, *_names(given, "required_functions")])
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
            fields |= {"node_type": str(view.kind), "parameters": parameter_messages(view.parameters_in_force)}
            fields |= {field: getattr(view, field) for field in _OF_COMPONENT}
        elif kind != "function":
            whole = "function" if kind == "design" else "component"
            fields |= {"priority": float(view.priority or 0.0), whole: self._thing(whole, getattr(view, whole))}
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
    raise RosError(f"TypeQL is not answered here, as {asked!r}; ask by the other services, or by kb.query")


def _span(one: ReconfigurationPlan | Process) -> Message:
    return {"start_time": _iso(one.start), "end_time": "" if one.end is None else _iso(one.end)}


def _iso(time_s: float) -> str:
    """Return a time [s since 1970] as ISO 8601, to the millisecond."""
    return datetime.fromtimestamp(time_s, UTC).replace(tzinfo=None).isoformat(timespec="milliseconds")


def parameter_messages(parameters: Mapping[str, Any]) -> list[Message]:
    """Return parameters as rcl_interfaces/Parameter."""
    return [{"name": name, "value": _value_message(value)} for name, value in parameters.items()]


def _value_message(value: Any) -> Message:  # noqa: ANN401  # of a parameter
    is_list = isinstance(value, list)
    kinds = type((value or [0.0])[0] if is_list else value).__mro__  # numpy's numbers are subclasses of these
    code, name = next(_BY_TYPE[kind] for kind in kinds if kind in _BY_TYPE)
    return {"type": code + 5, f"{name}_array_value": value} if is_list else {"type": code, f"{name}_value": value}


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
