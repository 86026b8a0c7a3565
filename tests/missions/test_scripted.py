"""Scripted systems and mocked leaves do as they are told, at the times of their clock."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviours import Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from small_rover import Sensing, rover_model, rover_tree

from kb import ConfigurationManager, KnowledgeBase, UnknownName
from missions.engine.mission import Percepts
from missions.testing import CommandFailed, FakeClock, ScriptedManaged, mock_leaf
from missions.testing.scripted import LETTERS
from rosa_bt import TreeRunner

COMMANDS = st.lists(
    st.tuples(
        st.sampled_from(["activate", "deactivate"]),
        st.sampled_from(["a", "b"]),
        st.sampled_from([0.0, 0.5, 2.0]),
    ),
    max_size=12,
)


@given(COMMANDS, st.sampled_from([0.0, 0.5, 3.0]))
def test_commands_to_a_component_are_carried_out_in_order(commands, takes):
    managed = ScriptedManaged(FakeClock()).script("a", takes=takes).script("b", takes=takes)
    last = {}
    for verb, component, pause in commands:
        last[component] = verb, getattr(managed, verb)(component)
        managed.clock.advance(pause)
    managed.clock.advance(takes * (len(commands) + 1))
    assert all(operation.done() for _, operation in last.values())
    assert managed.active == {name for name, (verb, _) in last.items() if verb == "activate"}
    assert managed.next_event() == math.inf
    verbs = [(command.verb, command.component) for command in managed.commands]
    assert verbs == [(verb, name) for verb, name, _ in commands]


@given(st.integers(0, 4), st.integers(1, 6))
def test_first_commands_fail_as_often_as_scripted(fail_first, count):
    managed = ScriptedManaged(FakeClock()).script("camera", fail_first=fail_first, takes=1.0)
    for number in range(1, count + 1):
        operation = managed.activate("camera")
        assert not operation.done()
        managed.clock.advance(1.0)
        assert operation.done()
        assert isinstance(operation.exception(), CommandFailed) == (number <= fail_first)
        assert managed.is_active("camera") == (number > fail_first)


def test_script_is_about_its_commands_until_the_next_script():
    managed = ScriptedManaged(FakeClock()).script("camera", "set_parameters", fail_first=math.inf)
    assert managed.set_parameters("camera", {"rate": 1}).exception() is not None
    managed.activate("camera")
    assert managed.active == {"camera"}
    assert managed.parameters("camera") == {}
    managed.script("camera", fail_first=0)
    assert managed.set_parameters("camera", {"rate": 1}).exception() is None
    assert managed.scripted == ("camera",)


@pytest.mark.parametrize(
    ("script", "is_done", "actives"),
    [
        ({"hangs": True}, False, [False, False]),
        ({"lies": True}, True, [False, False]),
        ({"takes": 5.5}, True, [False, True]),
    ],
)
def test_component_hangs_lies_or_is_slow(script, is_done, actives):
    managed = ScriptedManaged(FakeClock()).script("camera", **script)
    operation = managed.activate("camera")
    states = [managed.is_active("camera")]
    managed.clock.advance(6.0)
    states.append(managed.is_active("camera"))
    assert states == actives
    assert operation.done() is is_done
    managed.activate("radar").cancel()
    assert not managed.is_active("radar")


def test_manager_copes_with_a_slow_and_failing_system():
    clock = FakeClock()
    managed = ScriptedManaged(clock).script("camera", "activate", fail_first=2, takes=0.5)
    kb = KnowledgeBase(rover_model(), clock=clock)
    kb.measure("light", 0.1)
    manager = ConfigurationManager(kb, managed)
    kb.request_action("explore")
    for _ in range(100):
        manager.update()
        clock.advance(0.1)
    assert managed.active == {"camera"}
    assert managed.parameters("camera") == {"exposure_s": 0.2}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda managed: managed.script("camera", "start"), "'start' is no command; commands are"),
        (lambda managed: managed.script("camera", takes=-1.0), "activate takes -1.0; allowed is"),
        (lambda managed: managed.script("camera", fail_first=math.nan), "takes nan"),
        (lambda managed: managed.clock.advance(-1.0), "that shows 0 s cannot be moved to -1 s"),
    ],
)
def test_script_without_meaning_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong(ScriptedManaged(FakeClock()))


def ticked(root, times):
    """Tick a tree and return the statuses of its root."""
    runner = TreeRunner(root, clock=FakeClock())
    statuses = []
    for _ in range(times):
        runner.tick()
        statuses.append(root.status)
    runner.shutdown()
    return statuses


@given(st.text("RSF", min_size=1, max_size=8), st.integers(1, 12))
def test_mocked_leaf_repeats_the_last_outcome_of_its_script(script, times):
    root = Sequence("root", memory=False, children=[Success("leaf")])
    mock = mock_leaf(root, "leaf", script)
    expected = [LETTERS[script[min(number, len(script) - 1)]] for number in range(times)]
    assert ticked(root, times) == expected
    ended = [status is not Status.RUNNING for status in expected]
    assert (mock.ticks, mock.starts) == (times, 1 + sum(ended[:-1]))
    assert mock.interruptions == (not ended[-1])  # by the shutdown


@given(st.text("RSF", min_size=1, max_size=6))
def test_mocked_action_is_still_requested_and_released(script):
    kb = KnowledgeBase(rover_model(), clock=FakeClock())
    root = Selector("root", memory=False, children=[Sensing("explore", kb, Percepts(), "never")])
    mock_leaf(root, "explore", script)
    ticked(root, len(script))
    rounds = script.replace("S", "S ").replace("F", "F ").split()
    results = {"S": "completed", "F": "failed", "R": "abandoned"}
    assert [record.result for record in kb.history.actions] == [results[r[-1]] for r in rounds]
    assert not kb.required_actions


def test_leaf_or_script_that_does_not_exist_is_refused():
    root = rover_tree(KnowledgeBase(rover_model(), clock=FakeClock()), Percepts())
    with pytest.raises(UnknownName, match=r"unknown leaf 'explor'; did you mean 'explore'"):
        mock_leaf(root, "explor", "S")
    for wrong in ("RSX", ""):
        with pytest.raises(ValueError, match="outcomes are letters R, S and F"):
            mock_leaf(root, "explore", wrong)
