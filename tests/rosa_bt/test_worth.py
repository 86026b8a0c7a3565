"""When to leave for a detour is decided by what the mission then gains, and told with the reason."""

import pytest
from acting import Act
from py_trees.common import Status
from wrong_worlds import wrong_case

from kb import InvalidValue, KnowledgeBase, Model, UnknownName
from rosa_bt import Detour, Gain, Lookahead, MissionValue, ValueSelector

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
    blade = model.component("blade")
    cut = model.function("cut").design("with_blade", [blade]).function
    model.action("mow", requires=[cut], constraints=[charge >= 0.25])
    model.action("dock")
    charge.changes(-drain)
    clock = Time()
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("charge", 1.0)
    return kb, clock


def dock(there=5.0, back=5.0, spread=0.0):
    return Detour(
        "dock", {"charge": 1.0}, lambda away: there + away, lambda away: back + away, spread
    )


def test_lookahead_leaves_when_the_next_charge_lasts_to_the_end_and_says_why():
    kb, clock = mower()
    away = [0.0]
    gains = (Gain("mow", 2.0, 0.01, away=0.1),)
    lookahead = Lookahead(
        kb, lambda: MissionValue(130.0, gains, (dock(),), away=away[0], unit="m2")
    )
    while lookahead.update().action == "mow":
        assert lookahead.latest.low < lookahead.latest.value < lookahead.latest.high
        clock.now += 1.0
        away[0] += 0.1
        kb.measure("charge", 1.0 - DRAIN * clock.now)
    # a full charge lasts for 75 s, and the farther it is, the longer it takes: as soon as the next one is enough
    assert clock.now == pytest.approx(45.0, abs=4.0)
    reason = lookahead.latest.reason
    assert reason.startswith(f"dock now: leaving at {clock.now:.0f} s gains ")
    assert "; leaving at 7" in reason
    assert kb.why(kb.actions["mow"]).endswith(f"({reason})")
    assert not kb.is_feasible("mow")
    kb.measure("charge", 0.4)
    assert lookahead.update().action == "dock", "a detour that has begun is finished"
    kb.measure("charge", 1.0)
    assert lookahead.update().action == "mow", "and does not begin again at once"
    assert kb.is_feasible("mow")


def test_lookahead_leaves_in_time_for_what_is_to_be_kept_at_the_worse_end():
    kb, clock = mower()
    gains, detours = (Gain("mow", 1.0, away=1.0),), (dock(1.0, 1.0, 0.5),)
    lookahead = Lookahead(
        kb, lambda: MissionValue(30.0, gains, detours, {"charge": 0.4}, clock.now)
    )
    while lookahead.update().action == "mow":
        clock.now += 1.0
        kb.measure("charge", 1.0 - DRAIN * clock.now)
    # after t seconds 1 - t / 100 is left, and the way takes up to 1.5 (t + 1)
    assert 21.0 < clock.now <= 23.4
    assert "less than is to be kept" in lookahead.latest.reason


@pytest.mark.parametrize("left", [40.0, 60.0, 90.0])
def test_lookahead_never_plans_less_than_it_gains_without_detours(left):
    kb, _ = mower()
    kb.measure("charge", 0.5)
    gains = (Gain("mow", 1.0, away=0.5),)
    with_detour = Lookahead(kb, MissionValue(left, gains, (dock(),))).decide()
    assert with_detour.value >= min(left, 25.0)


def test_status_that_somebody_else_asserts_meanwhile_stays():
    kb, clock = mower()
    lookahead = Lookahead(kb, MissionValue(60.0, (Gain("mow", 1.0, away=0.1),), (dock(),)))
    kb.measure("charge", 0.3)
    assert lookahead.update().action == "dock"
    kb.assert_status(kb.actions["mow"], "unfeasible", "a child plays on the lawn")
    clock.now = 12.0
    kb.measure("charge", 1.0)
    lookahead.update()
    assert "a child plays on the lawn" in kb.why(kb.actions["mow"])


def test_wrong_forecasts_and_sensors_violate_nothing_that_reacting_keeps():
    cases = [wrong_case(case) for case in range(40)]
    assert [only for only, _ in cases if only] == []
    assert sum(put_off for _, put_off in cases) > 10


def test_selector_does_the_first_feasible_task_unless_a_detour_pays():
    kb, _ = mower()
    tasks = [Act(kb, name) for name in ("mow", "dock")]
    pays = MissionValue(60.0, (Gain("mow", 1.0, away=0.1),), (dock(),))
    for value, doing in ((None, "mow"), (MissionValue(60.0), "mow"), (pays, "dock")):
        kb.measure("charge", 0.3)
        selector = ValueSelector("next", Lookahead(kb, value), tasks)
        selector.tick_once()
        assert [each.action for each in kb.required_actions] == [doing]
        selector.stop(Status.INVALID)
        for task in tasks:
            task.parent = None


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (MissionValue(9.0, (Gain("mov", 1.0),)), UnknownName, "mow"),
        (MissionValue(float("inf"), (Gain("mow", 1.0),)), InvalidValue, "a finite number"),
        (MissionValue(9.0, (Gain("mow", -1.0),)), InvalidValue, "0 or more a second, not -1.0"),
        (MissionValue(9.0, (Gain("mow", 1.0, 1.5),)), InvalidValue, "below 1, not 1.5"),
        (MissionValue(9.0, (Gain("mow", 1.0),), keep={"charg": 0.1}), UnknownName, "charge"),
    ],
)
def test_value_that_makes_no_sense_is_refused(value, error, words):
    with pytest.raises(error, match=words):
        Lookahead(mower()[0], value)


def test_attribute_without_forecast_is_decided_as_without_looking_ahead():
    kb, _ = mower()
    kb.model.change(kb.model.attributes["charge"], rates=())
    decision = Lookahead(kb, MissionValue(60.0, (Gain("mow", 1.0),), (dock(),))).decide()
    assert decision.action is None
    assert decision.reason.startswith("as without looking ahead, since ")
