"""Assistants ask the knowledge base, with a client of the protocol's own library."""

import json
import sys
from functools import partial
from importlib.metadata import version

import anyio
import pytest

from kb import KnowledgeBase
from missions.suave_extended import MISSION
from missions.wires.assistant import Assistant, mcp_server

ASKING = {
    "best_configuration",
    "latest_decisions",
    "plan_for",
    "what_can_be_done",
    "what_if",
    "what_is_known",
    "why",
    "why_chosen",
}


MUCH = "x" * 100_000


@pytest.fixture
def kb():
    made = KnowledgeBase(MISSION.model(), clock=lambda: 1.0)
    made.measure("water_visibility", 3.0)
    made.measure("battery_level", 0.2)
    return made


def asked(kb, calls, *, allow_actions=False):
    """Return the tools, and (is an error, content, text) of each call, over the protocol."""
    from mcp import Client  # slow to import

    async def ask():
        async with Client(
            mcp_server(Assistant(kb, MISSION), allow_actions=allow_actions)
        ) as client:
            tools = (await client.list_tools()).tools
            results = [await client.call_tool(name, arguments) for name, arguments in calls]
        answers = [(bool(r.is_error), r.structured_content, text_of(r)) for r in results]
        return {tool.name: tool.annotations.read_only_hint for tool in tools}, answers

    return anyio.run(ask)


def text_of(result):
    return "".join(part.text for part in result.content if part.type == "text")


def test_answers_are_those_of_the_knowledge_base(kb):
    calls = {
        "what_can_be_done": {},
        "why": {"element": "inspect_pipeline"},
        "what_if": {"measured": {"battery_level": 0.9}, "failed": ["c_thruster_1"]},
        "best_configuration": {"action": "recharge"},
        "why_chosen": {"element": "maintain_motion"},
        "what_is_known": {},
        "plan_for": {"goal": ""},
    }
    tools, answers = asked(kb, calls.items())
    assert tools == dict.fromkeys(ASKING, True), "to act is not among them, and all only read"
    assert not any(is_error for is_error, *_ in answers)
    can, why, supposed, best, chosen, known, plan = [
        json.loads(text) if text[:1] == "{" else text for *_, text in answers
    ]
    feasible = {name: entry["feasible"] for name, entry in can["actions"].items()}
    assert feasible == {name: kb.is_feasible(name) for name in kb.actions}
    assert why == str(kb.explain("inspect_pipeline"))
    situation = kb.situation(battery_level=0.9, failed=["c_thruster_1"])
    assert supposed["feasible"] == list(situation.selectable_actions())
    assert best["designs"] == dict(kb.best_configuration("recharge").designs)
    assert chosen == str(kb.explain_choice("maintain_motion"))
    assert known["measured"]["battery_level"] == {"value": 0.2, "time": 1.0, "unit": ""}
    assert plan["steps"][0].startswith("recharge(")


def test_request_has_to_be_allowed_and_passes_the_gate(kb):
    _, ((is_error, *_),) = asked(kb, [("request_action", {"action": "recharge"})])
    assert is_error
    assert not kb.required_actions
    names = ("inspect_pipeline", "recharge")
    calls = [("request_action", {"action": name}) for name in names]
    calls.append(("latest_decisions", {"most": 20}))
    tools, answers = asked(kb, calls, allow_actions=True)
    acting = {"request_action": False, "cancel_action": False}
    assert tools == dict.fromkeys(ASKING, True) | acting
    refused, accepted = [json.loads(text) for *_, text in answers[:2]]
    assert not refused["accepted"]
    assert "battery_level 0.2 violates >= 0.25" in refused["reason"]
    assert accepted["accepted"]
    assert [request.action for request in kb.required_actions] == ["recharge"]
    assert "recharge is requested" in answers[2][2]


@pytest.mark.parametrize(
    ("tool", "arguments", "words"),
    [
        ("what_if", {"attributes": {}}, ["measured", "failed", "required"]),
        ("why", {}, ["element", "required"]),
        ("why", {"element": 3}, ["element", "string"]),
        ("why", {"element": "inspekt_pipeline"}, ["inspect_pipeline"]),
        ("what_if", {"measured": {"batery": 1}, "failed": []}, ["battery_level"]),
        ("why", {"element": MUCH}, ["unknown"]),
        (MUCH, {}, ["Unknown tool: xxx"]),
    ],
)
def test_call_that_is_wrong_is_refused_in_words(kb, tool, arguments, words):
    _, ((is_error, _, text),) = asked(kb, [(tool, arguments)])
    assert is_error
    assert len(text) < 1500
    for word in words:
        assert word in text


def test_program_serves_over_stdio():
    from mcp import Client, StdioServerParameters
    from mcp.client.stdio import stdio_client

    async def ask():
        arguments = ["-m", "missions", "mcp", "suave_extended"]
        program = StdioServerParameters(command=sys.executable, args=arguments)
        async with Client(partial(stdio_client, program)()) as client:
            answer = await client.call_tool("why", {"element": "recharge"})
            return client.server_info.version, text_of(answer)

    told, answer = anyio.run(ask)
    assert told == version("rosa-taca")
    assert "recharge" in answer
