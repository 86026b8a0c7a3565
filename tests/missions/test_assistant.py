"""Assistants ask the knowledge base by the Model Context Protocol, with a client of the protocol's own library."""

import json
import random
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from functools import partial
from importlib.metadata import version
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import anyio
import pytest

from kb import KnowledgeBase
from missions.engine.mission import MissionError
from missions.suave_extended import MISSION
from missions.wires.assistant import Assistant, mcp_server, serve_http

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


@pytest.fixture
def kb():
    made = KnowledgeBase(MISSION.model(), clock=lambda: 1.0)
    made.measure("water_visibility", 3.0)
    made.measure("battery_level", 0.2)
    return made


def asked(kb, calls, *, allow_actions=False):
    """Return (whether it is an error, what was answered) of each call, over the protocol."""
    from mcp import (
        Client,
    )  # slow to import, and every process that takes part in a run of the tests reads this file

    async def ask():
        server = mcp_server(Assistant(kb, MISSION), allow_actions=allow_actions)
        async with Client(server) as client:
            tools = {tool.name for tool in (await client.list_tools()).tools}
            answers = [await client.call_tool(name, arguments) for name, arguments in calls]
        return tools, [
            (bool(one.is_error), one.structured_content, text_of(one)) for one in answers
        ]

    return anyio.run(ask)


def text_of(result):
    return "".join(part.text for part in result.content if part.type == "text")


def test_answers_are_those_of_the_knowledge_base(kb):
    tools, answers = asked(
        kb,
        [
            ("what_can_be_done", {}),
            ("why", {"element": "inspect_pipeline"}),
            ("what_if", {"measured": {"battery_level": 0.9}, "failed": ["c_thruster_1"]}),
            ("best_configuration", {"action": "recharge"}),
            ("why_chosen", {"element": "maintain_motion"}),
            ("what_is_known", {}),
        ],
    )
    assert tools == ASKING, "to act is not among them"
    assert not any(is_error for is_error, *_ in answers)
    can, why, supposed, best, chosen, known = [
        json.loads(text) if text[:1] == "{" else text for *_, text in answers
    ]
    assert {name: one["feasible"] for name, one in can["actions"].items()} == {
        name: kb.is_feasible(name) for name in kb.actions
    }
    assert why == str(kb.explain("inspect_pipeline"))
    situation = kb.situation(battery_level=0.9, failed=["c_thruster_1"])
    assert supposed["feasible"] == list(situation.selectable_actions())
    assert best["designs"] == dict(kb.best_configuration("recharge").designs)
    assert chosen == str(kb.explain_choice("maintain_motion"))
    assert known["measured"]["battery_level"]["value"] == 0.2


def test_plan_is_made_with_what_is_feasible_now(kb):
    _, ((is_error, _, text),) = asked(kb, [("plan_for", {})])
    assert not is_error
    assert [step.split("(")[0].strip("()").split()[0] for step in json.loads(text)["steps"]][
        :1
    ] == ["recharge"]


def test_to_act_has_to_be_allowed_and_passes_the_gate(kb):
    _, ((is_error, *_),) = asked(kb, [("request_action", {"action": "recharge"})])
    assert is_error
    assert not kb.required_actions
    calls = [("request_action", {"action": name}) for name in ("inspect_pipeline", "recharge")]
    tools, answers = asked(kb, calls, allow_actions=True)
    assert tools == ASKING | {"request_action", "cancel_action"}
    refused, accepted = [json.loads(text) for *_, text in answers]
    assert not refused["accepted"]
    assert "battery_level 0.2 violates >= 0.25" in refused["reason"]
    assert accepted["accepted"]
    assert [one.action for one in kb.required_actions] == ["recharge"]
    assert [one.verb for one in kb.log][-1] == "request_action", "it is in the log"


def test_hostile_requests_never_get_an_unfeasible_action_through(kb):
    rng, names = random.Random(8), [*kb.actions, "", "inspect", "x" * 5000, "';--", "recharge "]
    values = [
        None,
        3,
        [],
        {},
        "inspect_pipeline",
        ["inspect_pipeline"],
        {"name": "inspect_pipeline"},
        *names,
    ]
    before = len(list(kb.log))
    calls = [
        (
            rng.choice(["request_action", "what_if", "why", "plan"]),
            {rng.choice(["action", "element", "x"]): rng.choice(values)},
        )
        for _ in range(400)
    ]
    _, answers = asked(
        kb, [call for call in calls if call[1] != {"action": "recharge"}], allow_actions=True
    )
    assert len(answers) > 300
    assert not kb.required_actions
    assert len(list(kb.log)) == before
    assert not kb.is_feasible("inspect_pipeline")


def test_argument_that_a_tool_does_not_take_is_refused_and_not_passed_over(kb):
    calls = [
        ("what_if", {"attributes": {"battery_level": 0.9}}),
        ("what_can_be_done", {"action": "recharge"}),
    ]
    _, answers = asked(kb, calls)
    assert [text for *_, text in answers] == [
        "what_if takes no 'attributes'; it takes measured, failed",
        "what_can_be_done takes no 'action'; it takes nothing",
    ]
    assert all(is_error for is_error, *_ in answers)


def test_argument_that_is_missing_or_of_another_type_is_named(kb):
    calls = [
        ("why", {}),
        ("why", {"element": 3}),
        ("what_if", {"measured": {"battery_level": "much"}}),
    ]
    _, answers = asked(kb, calls)
    assert all(is_error for is_error, *_ in answers)
    for (*_, text), name, wrong in zip(
        answers,
        ("element", "element", "battery_level"),
        ("required", "string", "number"),
        strict=True,
    ):
        assert name in text
        assert wrong in text


def test_refusals_are_told_in_words(kb):
    _, answers = asked(
        kb, [("why", {"element": "inspekt_pipeline"}), ("what_if", {"measured": {"batery": 1}})]
    )
    assert [is_error for is_error, *_ in answers] == [True, True]
    assert "inspect_pipeline" in answers[0][2]
    assert "battery_level" in answers[1][2]


def test_tools_that_only_read_have_the_hint(kb):
    from mcp import Client

    async def ask():
        async with Client(mcp_server(Assistant(kb), allow_actions=True)) as client:
            tools = (await client.list_tools()).tools
            return {tool.name: tool.annotations.read_only_hint for tool in tools}

    acting = {"request_action": False, "cancel_action": False}
    assert anyio.run(ask) == dict.fromkeys(ASKING, True) | acting


def test_long_names_are_cut_in_answers(kb):
    calls = [("why", {"element": "x" * 100_000}), ("x" * 100_000, {}), ("why", {"y" * 100_000: 1})]
    _, answers = asked(kb, calls)
    assert all(is_error and len(text) < 1500 for is_error, _, text in answers)


def test_program_serves_over_stdio():
    from mcp import Client, StdioServerParameters
    from mcp.client.stdio import stdio_client

    async def ask():
        program = StdioServerParameters(
            command=sys.executable, args=["-m", "missions", "mcp", "suave_extended"]
        )
        async with Client(partial(stdio_client, program)()) as client:
            return client.server_info.version, text_of(
                await client.call_tool("why", {"element": "recharge"})
            )

    told, answer = anyio.run(ask)
    assert told == version("rosa-taca")
    assert "recharge" in answer


def test_http_needs_a_token(kb):
    with pytest.raises(MissionError, match="needs a token"):
        serve_http(mcp_server(Assistant(kb)), 0, "")


@contextmanager
def served():
    """Give the address of a program that serves, on some port that nobody else has taken meanwhile."""
    for _ in range(9):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = [
            sys.executable,
            "-m",
            "missions",
            "mcp",
            "suave_extended",
            "--http",
            str(port),
            "--token",
            "secret",
        ]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as program:
            try:
                while program.poll() is None:
                    with suppress(ConnectionRefusedError):
                        socket.create_connection(("127.0.0.1", port)).close()
                        yield f"http://127.0.0.1:{port}/mcp"
                        return
                    time.sleep(0.1)
            finally:
                program.terminate()
    raise AssertionError("it never listens")


def test_over_http_only_who_has_the_token_is_answered():
    asked_for = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "ping"}).encode()

    def status(url, **headers):
        request = Request(
            url,
            asked_for,
            {"Content-Type": "application/json", "Accept": "application/json", **headers},
        )
        try:
            return urlopen(request, timeout=120).status
        except HTTPError as error:
            with error:
                return error.code

    with served() as url:
        assert (status(url), status(url, Authorization="Bearer wrong")) == (401, 401)
        assert status(url, Authorization="Bearer secret") != 401
