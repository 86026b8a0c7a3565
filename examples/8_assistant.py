"""An assistant that can only request what is feasible, by the MCP wire (extra `mcp`).

The assistant is a stand-in for a language model: it makes the calls that a model would make.
Whatever it requests, the knowledge base decides; the tools have no other way to the robot.
"""

import asyncio
import json
from collections.abc import Callable

from mcp import Client
from mcp.types import TextContent

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.wires.assistant import Assistant, mcp_server

model = Model("harbour_boat")
wind = model.environmental_attribute("wind", unit="m/s", low=0.0)
crane = model.component("crane", kind="lifecycle")
lift = model.function("lift")
lift.design("by_crane", [crane], priority=1)
model.action("lift_buoy", requires=[lift], constraints=[wind <= 8.0])
model.action("return_to_berth")


class Boat:
    """The boat's parts; it prints what it is commanded."""

    def activate(self, component: str) -> None:
        print(f"    boat: start {component}")

    def deactivate(self, component: str) -> None:
        print(f"    boat: stop {component}")

    def set_parameters(self, component: str, parameters: object) -> None:
        print(f"    boat: set {component} to {parameters}")


kb = KnowledgeBase(model, clock=lambda: 0.0)
manager = ConfigurationManager(kb, Boat())


async def ask(client: Client, tool: str, **arguments: str) -> dict[str, bool | str]:
    """Call a tool and return its answer."""
    result = await client.call_tool(tool, arguments)
    (content,) = result.content
    assert isinstance(content, TextContent)
    answer: dict[str, bool | str] = json.loads(content.text)
    return answer


async def request(client: Client, *wishes: str) -> None:
    """Request the first of the wishes that is accepted."""
    for action in wishes:
        reply = await ask(client, "request_action", action=action)
        print(f"  {action}: {'accepted' if reply['accepted'] else reply['reason']}")
        if reply["accepted"]:
            break
    manager.update()


happenings: dict[str, Callable[[], None]] = {
    "wind 12 m/s": lambda: kb.measure("wind", 12.0),
    "wind 5 m/s": lambda: kb.measure("wind", 5.0),
    "the crane fails": lambda: kb.component_failed("crane"),
}


async def main() -> None:
    """Have the assistant work in strong wind, in a breeze, and with a broken crane."""
    server = mcp_server(Assistant(kb), allow_actions=True)
    async with Client(server) as client:
        for words, happen in happenings.items():
            happen()
            print(f"{words}: the assistant wants to lift the buoy")
            for required in kb.required_actions:
                await ask(client, "cancel_action", action=required.action)
            await request(client, "lift_buoy", "return_to_berth")


asyncio.run(main())
