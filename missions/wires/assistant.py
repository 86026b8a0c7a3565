"""Questions to a robot's knowledge base as tools for assistants, by the Model Context Protocol.

The tools that request and cancel actions exist only if that is allowed; an unfeasible action is refused, as always.
"""

import logging
from collections.abc import Callable, Mapping
from functools import wraps
from hmac import compare_digest
from importlib.metadata import version
from inspect import signature
from typing import TYPE_CHECKING, Any, Final

from kb import Event, EventKind, KnowledgeBase, KnowledgeBaseError
from missions.engine.mission import Mission, MissionError, needs
from rosa_pddl import RosaPddlError

if TYPE_CHECKING:
    from mcp.server import MCPServer

_MOST: Final = 100
"""How many decisions are reported at most."""
_PLANNING_S: Final = 10.0
_log = logging.getLogger(__name__)
INSTRUCTIONS: Final = (
    "A robot's knowledge base: which actions can be done now, why not, what would help, and how it is configured. "
    "Ask what_can_be_done first; names are as it gives them."
)


class Assistant:
    """Answers from a knowledge base; each public method is a tool.

    Args:
        mission: whose goals may be planned for; None if it has none.
    """

    def __init__(self, kb: KnowledgeBase, mission: Mission | None = None) -> None:
        self._kb, self._mission = kb, mission

    def what_can_be_done(self) -> dict[str, Any]:
        """Say of every action whether it can be done now, with the reason, and which are being done."""
        kb = self._kb
        return {
            "actions": {
                one: {"feasible": kb.is_feasible(one), "why": kb.why(view)}
                for one, view in kb.actions.items()
            },
            "being done": [one.action for one in kb.required_actions],
        }

    def what_is_known(self) -> dict[str, Any]:
        """Say what was measured, and the status of every function, design, component and configuration."""
        kb = self._kb
        return {
            "measured": {
                name: {"value": view.value, "time": view.time, "unit": view.unit}
                for name, view in kb.attributes.items()
            },
            "functions": {name: str(view.status) for name, view in kb.functions.items()},
            "designs": _selectable(kb.designs),
            "components": {
                name: {
                    "status": str(view.status),
                    "active": view.is_active,
                    "parameters": dict(view.parameters_in_force),
                }
                for name, view in kb.components.items()
            },
            "configurations": _selectable(kb.configurations),
        }

    def why(self, element: str) -> str:
        """Say why an action, function, design, component, configuration or attribute is so, and what would help."""
        return str(self._kb.explain(element))

    def why_chosen(self, element: str) -> str:
        """Say why a function has its design, or a component its configuration, and not another one."""
        return str(self._kb.explain_choice(element))

    def what_if(
        self, measured: dict[str, float] | None = None, failed: list[str] | None = None
    ) -> dict[str, Any]:
        """Say what could be done if attributes had other values and components had failed; nothing is changed."""
        situation = self._kb.situation(measured or {}, failed=failed or ())
        out = {
            name: situation.why(view)
            for name, view in situation.actions.items()
            if not situation.is_feasible(name)
        }
        return {"feasible": list(situation.selectable_actions()), "unfeasible": out}

    def best_configuration(self, action: str) -> dict[str, Any]:
        """Say which designs and configurations would be chosen now if an action were to be done."""
        choice = self._kb.best_configuration(action)
        if choice is None:
            return {"why not": self._kb.why(self._kb.actions[action])}
        return {"designs": dict(choice.designs), "configurations": dict(choice.configurations)}

    def plan_for(self, goal: str = "") -> dict[str, Any]:
        """Plan, with what is feasible now, for the mission's goal or another in PDDL, e.g. "(inspected pipeline)"."""
        from missions.engine.question import answer, ask

        if self._mission is None:
            raise MissionError("this robot has no mission in PDDL to plan for")
        feasible = self._kb.selectable_actions()
        found = answer(
            ask(mission=self._mission, feasible=feasible, goals=[goal] if goal else []), _PLANNING_S
        )
        steps = [str(step) for step in found.result.steps]
        result = {"outcome": str(found.result.outcome), "steps": steps, "cost": found.result.cost}
        return {**result, "obstacles": list(found.obstacles)}

    def latest_decisions(self, most: int = 20) -> list[dict[str, Any]]:
        """Tell what was decided last, with the cause: requests, and reconfiguration plans with their reasons."""
        events = [
            one
            for one in self._kb.log
            if one.kind in (EventKind.ACTION_UPDATE, EventKind.RECONFIGURATION_PLAN)
        ]
        return [self._decision(one) for one in events[-max(1, min(most, _MOST)) :]]

    def request_action(self, action: str) -> dict[str, Any]:
        """Ask for an action to be done; refused, with the reason, unless it is feasible now."""
        reply = self._kb.request_action(action)
        return {"accepted": bool(reply), "reason": reply.reason}

    def cancel_action(self, action: str) -> dict[str, Any]:
        """Ask for an action no longer to be done."""
        self._kb.cancel_action(action)
        return {"accepted": True, "reason": ""}

    def _decision(self, event: Event) -> dict[str, Any]:
        reason = event.plan.reason if event.plan is not None else ""
        return {
            "time": event.time,
            "what": event.text,
            "why": reason,
            "caused by event": event.cause,
        }


def _selectable(views: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: {"status": str(view.status), "selected": view.is_selected}
        for name, view in views.items()
    }


def mcp_server(assistant: Assistant, *, allow_actions: bool = False) -> "MCPServer":
    """Return a server that offers an assistant's methods as tools; those that act only with `allow_actions`.

    Raises:
        MissionError: the extra `mcp` is missing.
    """
    with needs("mcp", "the server for assistants"):
        from mcp.server import MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    kept = () if allow_actions else ("request_action", "cancel_action")
    tools = {
        name: getattr(assistant, name)
        for name in vars(Assistant)
        if name[0] != "_" and name not in kept
    }

    class Server(MCPServer):
        async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:  # noqa: ANN401  # as its base has it
            takes = signature(tools[name]).parameters if name in tools else arguments
            if (
                unknown := arguments.keys() - takes
            ):  # otherwise they are ignored, and another question is answered
                raise ToolError(
                    f"{name} takes no {min(unknown)!r:.80}; it takes {', '.join(takes) or 'nothing'}"
                )
            return await super().call_tool(name, arguments, context)

    server = Server("rosa-taca", version=version("rosa-taca"), instructions=INSTRUCTIONS)
    for tool in tools.values():
        server.tool(tool.__name__)(_answering(tool))
    return server


def _answering(tool: Callable[..., Any]) -> Callable[..., Any]:
    """Return a tool that logs each call, and passes on the text of our errors."""

    @wraps(tool)
    def answered(*given: Any, **named: Any) -> Any:  # noqa: ANN401  # those of the tool
        _log.info("an assistant asks %s%r", tool.__name__, named or given)
        try:
            return tool(*given, **named)
        except (KnowledgeBaseError, MissionError, RosaPddlError) as error:
            from mcp.server.mcpserver.exceptions import ToolError

            raise ToolError(str(error)) from None

    return answered


def serve_http(server: "MCPServer", port: int, token: str) -> None:
    """Serve over HTTP on this machine, only to clients with the token, until interrupted.

    Raises:
        MissionError: there is no token, or the extra `mcp` is missing.
    """
    if not token:
        raise MissionError(
            "over HTTP an assistant needs a token: --token, or the variable ROSA_TOKEN"
        )
    with needs("mcp", "the server for assistants"):
        import uvicorn
    app, wanted = server.streamable_http_app(), f"Bearer {token}".encode()

    async def guarded(scope: Any, receive: Any, send: Any) -> None:  # noqa: ANN401  # as ASGI has it
        given = dict(scope.get("headers") or ()).get(b"authorization", b"")
        if scope["type"] == "http" and not compare_digest(given, wanted):
            await send(
                {
                    "type": "http.response.start",
                    "status": 401,
                    "headers": [(b"content-type", b"text/plain")],
                }
            )
            await send(
                {
                    "type": "http.response.body",
                    "body": b"a token is needed: Authorization: Bearer TOKEN\n",
                }
            )
        else:
            await app(scope, receive, send)

    uvicorn.run(guarded, host="127.0.0.1", port=port, log_level="warning")
