"""A managed system does as it is scripted, at the times of its clock, and tells the truth about itself."""

import math
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_rover import ENERGY_DROP, rover_model, rover_tree

from kb import ConfigurationManager, KnowledgeBase, UnknownName
from missions.engine.mission import MissionError
from missions.testing import CommandFailed, FakeClock, ScriptedManaged, replay

VERB = st.sampled_from(["activate", "deactivate"])
COMMANDS = st.lists(
    st.tuples(VERB, st.sampled_from(["a", "b"]), st.sampled_from([0.0, 0.5, 2.0])), max_size=12
)


@given(COMMANDS, st.sampled_from([0.0, 0.5, 3.0]))
def test_commands_to_one_component_are_carried_out_one_after_the_other(commands, takes):
    managed = ScriptedManaged(FakeClock(), takes=takes)
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


def test_script_may_be_about_single_commands():
    managed = ScriptedManaged(FakeClock()).script("camera", "set_parameters", fail_first=math.inf)
    assert managed.set_parameters("camera", {"rate": 1}).exception() is not None
    managed.activate("camera")
    assert managed.active == {"camera"}
    assert managed.parameters("camera") == {}


def test_script_holds_from_now_on_and_until_the_next_one():
    managed = ScriptedManaged(FakeClock()).script("camera", fail_first=1)
    failed = [managed.activate("camera").exception() is not None for _ in range(2)]
    managed.script("camera", "activate", fail_first=2)
    failed += [managed.activate("camera").exception() is not None for _ in range(3)]
    assert failed == [True, False, True, True, False]
    assert managed.scripted == ("camera",)


def test_one_that_hangs_never_ends_and_one_that_lies_has_done_nothing():
    managed = ScriptedManaged(FakeClock()).script("camera", hangs=True).script("radar", lies=True)
    camera, radar = managed.activate("camera"), managed.activate("radar")
    managed.clock.advance(1e6)
    assert not camera.done()
    assert radar.done()
    assert radar.exception() is None
    assert managed.active == frozenset()


def test_component_crashes_some_time_after_each_start():
    managed = ScriptedManaged(FakeClock()).script("camera", crash_after=5.0)
    for _ in range(2):
        managed.activate("camera")
        assert managed.is_active("camera")
        assert managed.next_event() == managed.clock.now + 5.0
        managed.clock.advance(4.9)
        assert managed.is_active("camera")
        managed.clock.advance(0.1)
        assert not managed.is_active("camera")


def test_command_that_is_cancelled_has_no_effect():
    managed = ScriptedManaged(FakeClock(), takes=2.0)
    managed.activate("camera").cancel()
    managed.clock.advance(3.0)
    assert not managed.is_active("camera")


def test_component_that_was_never_told_anything_does_not_run():
    managed = ScriptedManaged(FakeClock())
    assert managed.is_active("camera") is False
    assert managed.parameters("camera") == {}


def test_robot_that_restarted_is_started_again_on_a_reopened_base(tmp_path):
    clock = FakeClock()
    for _ in range(2):
        managed = ScriptedManaged(clock)
        with closing(
            KnowledgeBase(rover_model(), clock=clock, store=tmp_path / "rover.sqlite3")
        ) as kb:
            manager = ConfigurationManager(kb, managed)
            kb.measure("light", 0.9)
            kb.measure("energy", 0.9)
            if not kb.required_actions:
                kb.request_action("explore")
            for _ in range(20):
                manager.update()
                clock.advance(0.5)
            assert managed.active == {"camera"}


def test_manager_gets_along_with_a_slow_and_failing_system():
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
    assert [
        attempt.result for attempt in kb.history.attempts if attempt.operation == "activate"
    ] == [*("failed", "failed", "completed")]


def test_replay_takes_the_next_design_when_a_component_cannot_be_started():
    managed = ScriptedManaged(FakeClock()).script("camera", "activate", fail_first=math.inf)
    decisions = replay(ENERGY_DROP[:2], rover_model(), rover_tree, managed=managed)
    decisions.assert_reconfigures(at=1.0, activate="radar", within=2.0)
    assert managed.active == {"radar"}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda managed: managed.script("camera", "start"),
            "'start' is no command; commands are activate, deactivate",
        ),
        (
            lambda managed: managed.script("camera", takes=-1.0),
            "activate takes -1.0; allowed is a number from 0",
        ),
        (
            lambda managed: managed.script("camera", fail_first=math.nan),
            "takes nan",
        ),
        (
            lambda managed: ScriptedManaged(FakeClock(), takes={"start": 1.0}),
            "'start' is no command",
        ),
        (
            lambda managed: ScriptedManaged(FakeClock(), takes=-2.0),
            "activate takes -2.0; allowed is",
        ),
        (
            lambda managed: managed.clock.advance(-1.0),
            "a clock that shows 0 s cannot be moved to -1 s",
        ),
        (
            lambda managed: managed.clock.advance(math.nan),
            "a clock that shows 0 s cannot be moved to nan s",
        ),
    ],
)
def test_script_without_meaning_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong(ScriptedManaged(FakeClock()))


def test_script_for_a_component_that_the_model_lacks_is_found_before_the_replay():
    managed = ScriptedManaged(FakeClock()).script("cammera", takes=1.0)
    with pytest.raises(UnknownName, match="did you mean 'camera'"):
        replay(ENERGY_DROP, rover_model(), rover_tree, managed=managed)


def test_managed_system_serves_one_replay():
    managed = ScriptedManaged(FakeClock())
    replay(ENERGY_DROP[:1], rover_model(), rover_tree, managed=managed)
    with pytest.raises(MissionError, match=r"a replay begins at 0 s, not at 1.5 s"):
        replay(ENERGY_DROP[:1], rover_model(), rover_tree, managed=managed)
