"""Questions to a robot's knowledge base as tools for assistants, by the Model Context Protocol.

The tools that request and cancel actions exist only if that is allowed; an unfeasible action is
refused, as always.
"""

import re
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final

from kb import EventKind, KnowledgeBase
from missions.engine.mission import Mission, MissionError, needs

if TYPE_CHECKING:
    from mcp.server import MCPServer

_PLANNING_S: Final = 10.0
_ACTING: Final = ("request_action", "cancel_action")
"""The tools that act."""
INSTRUCTIONS: Final = (
    "A robot's knowledge base: which actions can be done now, why not, what would help, and how "
    "it is configured. "
    "Ask what_can_be_done first; names are as it gives them."
)


class Assistant:
    """Answers from a knowledge base; each public method is a tool.

    All arguments are needed, as one of another name would be ignored.

    Args:
        mission: whose goals may be planned for; None if it has none.
    """

    def __init__(self, kb: KnowledgeBase, mission: Mission | None = None) -> None:
        self._kb = kb
        self._mission = mission

    def what_can_be_done(self) -> dict[str, Any]:
        """Say of every action whether it can be done now, and why, and which are being done."""
        kb = self._kb
        actions = {
            name: {"feasible": kb.is_feasible(name), "why": kb.why(view)}
            for name, view in kb.actions.items()
        }
        required = [request.action for request in kb.required_actions]
        return {"actions": actions, "being done": required}

    def what_is_known(self) -> dict[str, Any]:
        """Say what was measured, the status of every element, and what is selected and active."""
        kb = self._kb
        measured = {
            name: {"value": view.value, "time": view.time, "unit": view.unit}
            for name, view in kb.attributes.items()
        }
        chosen = [*kb.designs.values(), *kb.configurations.values()]
        known: dict[str, Any] = {
            "measured": measured,
            "selected": [view.name for view in chosen if view.is_selected],
            "active": [name for name, view in kb.components.items() if view.is_active],
        }
        for kind in ("functions", "designs", "components", "configurations"):
            known[kind] = {name: str(view.status) for name, view in getattr(kb, kind).items()}
        return known

    def why(self, element: str) -> str:
        """Say why an element of the model is as it is, and what would help."""
        return str(self._kb.explain(element))

    def why_chosen(self, element: str) -> str:
        """Say why a function has its design, or a component its configuration."""
        return str(self._kb.explain_choice(element))

    def what_if(self, measured: dict[str, float], failed: list[str]) -> dict[str, Any]:
        """Say what could be done with other values and failed components; changes nothing."""
        situation = self._kb.situation(measured, failed=failed)
        feasible = list(situation.selectable_actions())
        views = situation.actions.items()
        unfeasible = {name: situation.why(view) for name, view in views if name not in feasible}
        return {"feasible": feasible, "unfeasible": unfeasible}

    def best_configuration(self, action: str) -> dict[str, Any]:
        """Say which designs and configurations would be chosen now if an action were to be done."""
        choice = self._kb.best_configuration(action)
        if choice is None:
            return {"why not": self._kb.why(self._kb.actions[action])}
        return {"designs": dict(choice.designs), "configurations": dict(choice.configurations)}

    def plan_for(self, goal: str) -> dict[str, Any]:
        """Plan now for a goal in PDDL, e.g. "(inspected pipeline)"; "" for the mission's own."""
        from missions.engine.question import answer, ask

        if self._mission is None:
            raise MissionError("this robot has no mission in PDDL to plan for")
        goals = [goal] if goal else []
        reply = answer(ask(mission=self._mission, kb=self._kb, goals=goals), _PLANNING_S)
        return {
            "outcome": str(reply.result.outcome),
            "steps": [str(step) for step in reply.result.steps],
            "cost": reply.result.cost,
            "obstacles": list(reply.obstacles),
        }

    def latest_decisions(self, most: int) -> list[dict[str, Any]]:
        """Tell the last decisions with their causes: requests, and plans with their reasons."""
        kinds = (EventKind.ACTION_UPDATE, EventKind.RECONFIGURATION_PLAN)
        events = [event for event in self._kb.log if event.kind in kinds]
        return [
            {
                "time": event.time,
                "what": event.text,
                "why": "" if event.plan is None else event.plan.reason,
                "caused by event": event.cause,
            }
            for event in events[-max(1, most) :]
        ]

    def request_action(self, action: str) -> dict[str, Any]:
        """Ask for an action to be done; refused, with the reason, unless it is feasible now."""
        reply = self._kb.request_action(action)
        return {"accepted": bool(reply), "reason": reply.reason}

    def cancel_action(self, action: str) -> dict[str, Any]:
        """Ask for an action no longer to be done."""
        self._kb.cancel_action(action)
        return {"accepted": True, "reason": ""}


def mcp_server(assistant: Assistant, *, allow_actions: bool = False) -> "MCPServer":
    """Return a server with an assistant's methods as tools; to act needs `allow_actions`.

    Raises:
        MissionError: the extra `mcp` is missing.
    """
    with needs("mcp", "the server for assistants"):
        from mcp.server import MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
        from mcp.types import ToolAnnotations

    class Server(MCPServer):
        async def call_tool(
            self,
            name: str,
            arguments: dict[str, Any],
            context: Any = None,  # noqa: ANN401  # as in its base
        ) -> Any:  # noqa: ANN401  # as in its base
            """Call a tool; an error says why, with long names cut."""
            try:
                return await super().call_tool(name, arguments, context)
            except ToolError as error:
                text = str(error.__cause__ or error)
                cut = re.sub(r"\w{80,}", lambda word: f"{word[0][:77]}...", text)
                raise ToolError(f"{cut:.1000}") from None

    server = Server("rosa-taca", version=version("rosa-taca"), instructions=INSTRUCTIONS)
    for name in vars(Assistant):
        if not name.startswith("_") and (allow_actions or name not in _ACTING):
            hints = ToolAnnotations(read_only_hint=name not in _ACTING)
            server.tool(annotations=hints)(getattr(assistant, name))
    return server
