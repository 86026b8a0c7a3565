"""What a test says of a replay: it passes when it is so, and shows a person what happened when it is not."""

import math
import re
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.composites import Sequence
from small_rover import ENERGY_DROP, Sensing, rover_model, rover_tree

from kb import UnknownName
from missions.engine.mission import MissionError
from missions.engine.recording import failed, measured, recovered, sensed
from missions.engine.settings import RunSettings
from missions.testing import FakeClock, ScriptedManaged, replay


@cache
def decided():
    return replay(ENERGY_DROP, rover_model(), rover_tree)


def failure_of(assertion, **expected):
    with pytest.raises(AssertionError) as caught:
        assertion(**expected)
    return str(caught.value)


def test_energy_drop_reads_as_it_is_told():
    decisions = decided()
    drop = decisions.assert_adapts(at=20.0, from_="explore", to="charge", within=0.2)
    assert drop.reason.startswith("explore is unfeasible because energy 0.1 violates >= 0.2")
    decisions.assert_adapts(at=30.0, from_="charge", to="explore", within=0.2)
    decisions.assert_adapts(at=20.0, to="charge", within=0.2)
    decisions.assert_adapts(at=20.0, within=0.2)
    night = decisions.assert_reconfigures(at=10.0, configure="night", within=0.1)
    assert night.reason.startswith("day is unfeasible because light 0.3 violates >= 0.5")
    decisions.assert_reconfigures(at=15.0, deactivate="camera", activate=["radar"], within=0.15)
    decisions.assert_actions("explore", "charge", "explore")
    decisions.assert_begins("explore", at=30.0, within=0.0)
    decisions.assert_ends("explore", "abandoned", at=20.0)
    decisions.assert_ends("explore", at=40.0)
    decisions.assert_never(action="charge", until=19.9)
    decisions.assert_never(activate="dock", configure="day", since=20.2)


def test_change_that_comes_too_late_or_too_early_is_no_success():
    decisions = decided()
    late = failure_of(decisions.assert_adapts, at=20.0, from_="explore", to="charge", within=0.05)
    assert (
        "but explore -> charge is decided at 20.00 s and is in force at 20.10 s (because explore is unfeasible"
        in late
    )
    early = failure_of(decisions.assert_adapts, at=20.05, from_="explore", to="charge", within=5.0)
    assert "expected between 20.05 s and 25.05 s: explore -> charge" in early


def test_failure_shows_what_happened_around_the_expected_time_and_why():
    message = failure_of(decided().assert_adapts, at=15.0, from_="explore", to="charge", within=0.5)
    assert message.splitlines() == [
        "expected between 15.00 s and 15.50 s: explore -> charge",
        "  but explore -> charge is decided at 20.00 s and is in force at 20.10 s "
        "(because explore is unfeasible because energy 0.1 violates >= 0.2 (measured 0.0 s ago))",
        "",
        "what happened around 15.00 s:",
        "     0.50 s  heard     energy is 1",
        "    10.00 s  heard     light is 0.3",
        "    10.00 s  plan      configure night: completed at 10.05 s",
        "                       because day is unfeasible because light 0.3 violates >= 0.5 (measured 0.0 s ago)",
        "    15.00 s  EXPECTED  explore -> charge",
        "    15.00 s  heard     camera has failed",
        "    15.00 s  plan      deactivate camera; activate radar: completed at 15.10 s",
        "                       because by_camera is unfeasible because component camera has failed",
        "    18.00 s  heard     camera is recovered",
        "    18.00 s  plan      deactivate radar; activate camera: completed at 18.15 s",
        "                       because by_camera is feasible and preferred to by_radar",
        "    20.00 s  heard     energy is 0.1",
    ]


def test_actions_in_another_order_are_shown_as_a_difference():
    message = failure_of(lambda: decided().assert_actions("explore", "explore"))
    assert message.splitlines()[:4] == [
        "other actions were begun (-: expected, +: what was done)",
        "  explore",
        "+ charge",
        "  explore",
    ]
    assert "20.00 s  action    charge is requested" in message


def test_other_failures_say_what_was_instead():
    decisions = decided()
    assert "but it begins at 20.00 s" in failure_of(
        decisions.assert_begins, action="charge", at=10.0
    )
    assert "but it is abandoned at 20.00 s" in failure_of(
        decisions.assert_ends, action="explore", at=20.0
    )
    assert "but the plan of 10.00 s is completed at 10.05 s" in failure_of(
        decisions.assert_reconfigures, at=20.0, configure="night", within=0.1
    )
    assert "but it never does" in failure_of(
        decisions.assert_reconfigures, at=0.0, activate=["camera", "radar"]
    )
    never = failure_of(decisions.assert_never, activate=["radar", "dock"], action="charge")
    assert never.startswith(
        "expected: never begin charge or activate radar, dock\n  but activate radar at 15.00 s"
    )
    assert "but charge is requested at 20.00 s" in never


@pytest.mark.parametrize(
    "claim",
    [
        lambda decisions: decisions.assert_adapts(at=20.0, from_="explor"),
        lambda decisions: decisions.assert_adapts(at=20.0, to="charg"),
        lambda decisions: decisions.assert_actions("explore", "charg"),
        lambda decisions: decisions.assert_begins("charg", at=20.0),
        lambda decisions: decisions.assert_ends("charg", at=20.0),
        lambda decisions: decisions.assert_reconfigures(at=20.0, activate="dok"),
        lambda decisions: decisions.assert_reconfigures(at=20.0, configure="nigt"),
        lambda decisions: decisions.assert_never(action="charg"),
        lambda decisions: decisions.assert_never(deactivate="cammera"),
    ],
)
def test_name_that_the_model_lacks_is_an_error_and_never_a_silent_success(claim):
    with pytest.raises(UnknownName, match="did you mean"):
        claim(decided())


@pytest.mark.parametrize(
    ("since", "until"), [(20.0, 10.0), (1000.0, math.inf), (math.nan, math.inf)]
)
def test_claim_about_no_time_is_refused(since, until):
    with pytest.raises(ValueError, match="is no time of this replay of 40 s"):
        decided().assert_never(action="charge", since=since, until=until)


def test_claim_about_nothing_is_refused():
    for claim in (decided().assert_never, lambda: decided().assert_reconfigures(at=1.0)):
        with pytest.raises(ValueError, match="say what to look for"):
            claim()


def test_finishing_one_action_and_beginning_the_next_is_no_adaptation():
    def tree(kb, percepts):
        steps = [
            Sensing("explore", kb, percepts, "explored"),
            Sensing("charge", kb, percepts, "charged"),
        ]
        return Sequence("both", memory=True, children=steps)

    decisions = replay([measured(0.0, energy=1.0), sensed(5.0, explored=True)], rover_model(), tree)
    decisions.assert_actions("explore", "charge")
    assert "but it never does" in failure_of(
        decisions.assert_adapts, at=5.0, from_="explore", to="charge"
    )


@pytest.mark.parametrize(
    ("limits", "end_s", "why"),
    [(None, "5.00", "SUCCESS"), (RunSettings(duration_s=4.0), "4.00", "time limit")],
)
def test_failure_says_that_the_mission_ended_before_the_stream(limits, end_s, why):
    stream = [
        measured(0.0, light=0.9, energy=1.0),
        sensed(5.0, explored=True),
        measured(20.0, energy=0.1),
        sensed(30.0),
    ]
    decisions = replay(stream, rover_model(), rover_tree, settings=limits)
    count = 2 + (limits is not None)
    told = f"{end_s} s  end       the mission ended ({why}); {count} messages were not heard"
    assert told in failure_of(decisions.assert_adapts, at=20.0, to="charge")
    assert told in failure_of(lambda: decisions.assert_actions("explore", "charge"))
    assert str(decisions).endswith(told)


def test_mission_that_heard_all_is_not_said_to_have_ended():
    assert not any(moment.what == "end" for moment in decided().timeline)


def test_change_that_a_crash_calls_for_is_found_with_its_reason():
    stream = [
        measured(0.0, light=1.0, energy=1.0),
        failed(2.0, "camera"),
        sensed(9.0, charged=False),
    ]
    managed = ScriptedManaged(FakeClock()).script("radar", crash_after=3.0)
    change = replay(stream, rover_model(), rover_tree, managed=managed).assert_adapts(
        at=5.0, to="charge", within=0.4
    )
    assert "radar is not running, though nobody has stopped it" in change.reason


def test_change_that_is_never_in_force_is_told_so():
    stuck = ScriptedManaged(FakeClock()).script("dock", "activate", hangs=True)
    decisions = replay(ENERGY_DROP, rover_model(), rover_tree, managed=stuck)
    message = failure_of(decisions.assert_adapts, at=20.0, to="charge", within=9.0)
    assert "explore -> charge is decided at 20.00 s and is never in force" in message
    assert math.isinf(decisions.changes[0].in_force_s)
    assert decisions.kb.components["dock"].is_active is False


NEWS = st.one_of(
    st.builds(lambda value: {"energy": value}, st.sampled_from([0.1, 0.5, 1.0])),
    st.builds(lambda value: {"light": value}, st.sampled_from([0.1, 1.0])),
    st.sampled_from([failed, recovered]),
)


def stream_of(news):
    return [
        one(float(time), "camera") if callable(one) else measured(float(time), **one)
        for time, one in enumerate(news, start=1)
    ]


@settings(max_examples=30)
@given(st.lists(NEWS, max_size=8))
def test_what_is_told_of_a_replay_is_so_and_the_same_each_time(news):
    stream = stream_of(news)
    decisions, again = (replay(stream, rover_model(), rover_tree) for _ in range(2))
    assert str(decisions.trace) == str(again.trace)
    assert str(decisions) == str(again)
    decisions.assert_actions(*(name for name, *_ in decisions.actions))
    for change in decisions.changes:
        decisions.assert_begins(change.action, at=change.at_s, within=0.0)
        assert change.before != change.action
        if math.isfinite(change.in_force_s):
            decisions.assert_adapts(
                at=change.at_s,
                from_=change.before,
                to=change.action,
                within=change.in_force_s - change.at_s,
            )
    times = [moment.time for moment in decisions.timeline]
    assert times == sorted(times)


def test_what_else_a_test_wants_to_know_is_in_the_knowledge_base():
    decisions = decided()
    assert (20.0, 0.1) in decisions.kb.attributes["energy"].history
    assert str(decisions).count("\n") > 20
    assert re.search(
        r"plan +deactivate dock; activate camera; configure night: completed at 30.15 s",
        str(decisions),
    )


def test_behaviour_is_handed_in_as_what_makes_it():
    for wrong in (Sequence("mission", memory=True), "rover_tree"):
        with pytest.raises(
            MissionError, match="what decides is made for each replay: lambda kb, percepts"
        ):
            replay(ENERGY_DROP, rover_model(), wrong)
    with pytest.raises(
        MissionError, match="the tree of mission rover is None, not a py_trees behaviour"
    ):
        replay(ENERGY_DROP, rover_model(), lambda kb, percepts: None)


def test_model_may_be_handed_in_as_what_makes_it():
    assert str(replay(ENERGY_DROP, rover_model, rover_tree)) == str(decided())
    with pytest.raises(MissionError, match="the model rover decides nothing by itself"):
        replay(ENERGY_DROP, rover_model)


@pytest.mark.parametrize("wrong", [rover_tree, dict])
def test_what_makes_no_model_to_replay_to_is_refused(wrong):
    with pytest.raises(
        MissionError, match=r"the model to replay to(: TypeError| is \{\}, not a Model)"
    ):
        replay(ENERGY_DROP, wrong, rover_tree)


@pytest.mark.parametrize("wrong", [None, 3])
def test_what_is_no_mission_and_makes_no_model_is_refused(wrong):
    with pytest.raises(
        MissionError, match=f"a mission, its name, a model or what makes one, not {wrong}"
    ):
        replay(ENERGY_DROP, wrong, rover_tree)


def test_model_alone_decides_nothing():
    with pytest.raises(MissionError, match="the model rover decides nothing by itself"):
        replay(ENERGY_DROP, rover_model())
