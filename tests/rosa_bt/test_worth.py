"""What to do next is decided by what it is worth, exactly over the horizon, and told with the reason."""

from functools import cache

import pytest
from acting import Act
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.common import Status
from wrong_worlds import wrong_case

from kb import InvalidValue, KnowledgeBase, Model, PriorityPlanner, UnknownName
from rosa_bt import Errand, Gain, Lookahead, WhatNext, Worth, WorthPlanner

DRAIN = 0.01


class Time:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def mower(drain=DRAIN):
    """A mower that cuts while a quarter of its charge is left, and charges at its dock."""
    model = Model("mower")
    charge = model.quality_attribute("charge", low=0.0, high=1.0)
    light = model.environmental_attribute("light")
    blade = model.component("blade", always_improve=True)
    blade.configuration("fast", {"speed": 2.0}, priority=1, constraints=[light >= 0.5])
    blade.configuration("slow", {"speed": 1.0}, priority=2)
    model.action(
        "mow", requires=[model.function("cut").design("with_blade", [blade], priority=1).function]
    )
    model.actions["mow"].constrain(charge >= 0.25)
    model.action("dock", requires=[])
    charge.changes(-drain)
    clock = Time()
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("charge", 1.0)
    kb.measure("light", 1.0)
    return kb, clock


def dock(there=5.0, back=5.0, spread=0.0):
    return Errand(
        "dock", {"charge": 1.0}, lambda away: there + away, lambda away: back + away, spread
    )


def test_charge_is_filled_when_the_next_one_lasts_to_the_end_and_it_is_said_why():
    kb, clock = mower()
    away = [0.0]
    gains = (Gain("mow", 2.0, 0.1, away=0.1),)
    lookahead = Lookahead(kb, lambda: Worth(130.0, gains, (dock(),), away=away[0], unit="m2"))
    while lookahead.update().action == "mow":
        assert lookahead.latest.low < lookahead.latest.worth < lookahead.latest.high
        clock.now += 1.0
        away[0] += 0.1
        kb.measure("charge", 1.0 - DRAIN * clock.now)
    # a full charge lasts for 75 s, and the farther it is, the longer it takes: as soon as the next one is enough
    assert clock.now == pytest.approx(45.0, abs=3.0)
    assert kb.why(kb.actions["mow"]).endswith(f"({lookahead.latest.reason})")
    assert lookahead.latest.reason.startswith(
        f"dock now: leaving at {clock.now:.0f} s that lasts to the end and gains "
    )
    assert "; leaving at 7" in lookahead.latest.reason
    assert not kb.is_feasible("mow")
    kb.measure("charge", 0.4)
    assert lookahead.update().action == "dock", "one that is begun is carried on with"
    kb.measure("charge", 1.0)
    assert lookahead.update().action == "mow"
    assert kb.is_feasible("mow")


def best_by_trying(steps, level, there, back, drain, rate, away_m_s):
    """Return the most that any course of whole steps gains, where errands take whole steps too."""

    @cache
    def most(step, level, away):
        if step >= steps:
            return 0.0
        options = [most(step + 1, round(level - drain, 6), away)]
        if level - drain >= 0.25 - 1e-9:
            options.append(rate + most(step + 1, round(level - drain, 6), away + away_m_s))
        takes = there + back + 2 * away
        if level - drain * (there + away) >= 0 and there + away < steps - step:
            options.append(most(step + takes, round(1.0 - drain * (back + away), 6), away))
        return max(options)

    return most(0, level, 0)


def test_what_somebody_else_has_said_meanwhile_stands():
    kb, clock = mower()
    lookahead = Lookahead(kb, Worth(60.0, (Gain("mow", 1.0, away=0.1),), (dock(),)))
    kb.measure("charge", 0.3)
    assert lookahead.update().action == "dock"
    kb.assert_status(kb.actions["mow"], "unfeasible", "a child plays on the lawn")
    clock.now = 12.0
    kb.measure("charge", 1.0)
    lookahead.update()
    assert "a child plays on the lawn" in kb.why(kb.actions["mow"])
    assert lookahead.latest.action is None


@settings(max_examples=40, deadline=None)
@given(
    st.integers(2, 14), st.sampled_from([0.3, 0.5, 1.0]), st.integers(1, 3), st.integers(1, 3),
    st.sampled_from([0.03, 0.125, 0.25]), st.integers(0, 1),
)  # fmt: skip
def test_no_other_course_gains_more(steps, level, there, back, drain, away_m_s):
    kb, _ = mower(drain)
    kb.measure("charge", level)
    gain = Gain("mow", 1.5, away=float(away_m_s))
    decision = Lookahead(kb, Worth(float(steps), (gain,), (dock(there, back),))).decide()
    assert decision.worth == pytest.approx(
        best_by_trying(steps, level, there, back, drain, 1.5, away_m_s), abs=1e-6
    )


def test_what_is_to_be_kept_is_left_at_the_end_of_an_errand_at_the_worse_end():
    kb, clock = mower()
    stated = (Gain("mow", 1.0, away=1.0),), (dock(1.0, 1.0, 0.5),), {"charge": 0.4}
    lookahead = Lookahead(kb, lambda: Worth(30.0, *stated, clock.now))
    while lookahead.update().action == "mow":
        clock.now += 1.0
        kb.measure("charge", 1.0 - DRAIN * clock.now)
    # after t seconds 1 - t / 100 is left, and the way takes up to 1.5 (t + 1)
    assert 21.0 < clock.now <= 23.4


def test_a_change_that_takes_longer_than_it_is_good_for_is_not_made():
    kb, _ = mower()
    kb.model.attributes["light"].changes(-0.05)
    rates = {"fast": 2.0, "slow": 1.5}
    kb.measure("light", 0.3)
    kb.request_action("mow")
    kb.select(*PriorityPlanner().choose(kb))
    kb.measure("light", 0.7)  # fast would do, for 4 s
    for switching_s, chosen in ((0.1, "fast"), (3.0, "slow")):
        lookahead = Lookahead(kb, Worth(60.0, (Gain("mow", rates, switching_s=switching_s),)))
        choice = WorthPlanner(lookahead).choose(kb)
        assert choice.configurations["blade"] == chosen
    assert choice.reason.startswith("mow in slow now: that gains ")
    assert WorthPlanner(Lookahead(kb)).choose(kb) == PriorityPlanner().choose(kb)


def test_wrong_forecasts_sensors_and_clocks_violate_nothing_that_reacting_keeps():
    found = [
        wrong_case(case) for case in range(20)
    ]  # 1,000 of them in tests/benchmarks/test_wrong_worlds.py
    assert [only for only, _ in found if only] == []
    assert sum(put_off for _, put_off in found) > 10


def test_first_that_is_feasible_is_done_and_with_nothing_stated_nothing_else_is_decided():
    kb, _ = mower()
    tasks = [Act(kb, name) for name in ("mow", "dock")]
    going_away = Worth(60.0, (Gain("mow", 1.0, away=0.1),), (dock(),))
    for worth, doing in ((None, "mow"), (Worth(60.0), "mow"), (going_away, "dock")):
        kb.measure("charge", 0.3)
        next_one = WhatNext("next", Lookahead(kb, worth), tasks)
        next_one.tick_once()
        assert [one.action for one in kb.required_actions] == [doing]
        next_one.stop(Status.INVALID)
        for task in tasks:
            task.parent = None


@pytest.mark.parametrize(
    ("worth", "error", "words"),
    [
        (Worth(9.0, (Gain("mov", 1.0),)), UnknownName, "mow"),
        (Worth(float("inf"), (Gain("mow", 1.0),)), InvalidValue, "a finite number is needed"),
        (Worth(9.0, (Gain("mow", {"fst": 1.0}),)), UnknownName, "fast"),
        (
            Worth(9.0, (Gain("mow", -1.0),)),
            InvalidValue,
            "what mow gains in a second is 0 or more, not -1.0",
        ),
        (Worth(9.0, (Gain("mow", 1.0, 1.5),)), InvalidValue, "a share from 0 to below 1, not 1.5"),
        (Worth(9.0, (Gain("mow", 1.0),), keep={"charg": 0.1}), UnknownName, "charge"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_there_is(worth, error, words):
    with pytest.raises(error, match=words):
        Lookahead(mower()[0], worth)


def test_what_is_not_known_is_decided_as_without_looking_ahead():
    kb, _ = mower()
    kb.model.change(kb.model.attributes["charge"], rates=())
    decision = Lookahead(kb, Worth(60.0, (Gain("mow", 1.0),), (dock(),))).decide()
    assert decision.action is None
    assert decision.reason.startswith(
        "as without looking ahead, since it is not known what charge is in "
    )
