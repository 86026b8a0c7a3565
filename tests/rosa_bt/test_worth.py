"""When to leave for a detour is decided by what the mission then gains."""

from random import Random

import pytest
from acting import Act, Clock

from kb import InvalidValue, KnowledgeBase, Model, UnknownName
from rosa_bt import Detour, Gain, Lookahead, MissionValue, ValueSelector

DRAIN = 0.01


def mower(drain=DRAIN):
    """A mower that cuts while a quarter of its charge is left, and charges at its dock."""
    model = Model("mower")
    charge = model.quality_attribute("charge", low=0.0, high=1.0)
    blade = model.component("blade")
    cut = model.function("cut").design("with_blade", [blade]).function
    model.action("mow", requires=[cut], constraints=[charge >= 0.25])
    model.action("dock")
    charge.changes(-drain)
    clock = Clock()
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("charge", 1.0)
    return kb, clock


def dock(there=5.0, back=5.0, spread=0.0):
    return Detour(
        "dock", {"charge": 1.0}, lambda away: there + away, lambda away: back + away, spread
    )


def test_lookahead_leaves_when_it_pays_and_says_why():
    kb, clock = mower()
    away = [0.0]
    gains = (Gain("mow", 2.0, 0.01, away=0.1),)
    lookahead = Lookahead(
        kb, lambda: MissionValue(130.0, gains, (dock(),), away=away[0], unit="m2")
    )
    while lookahead.update().action == "mow":
        clock.now += 1.0
        away[0] += 0.1
        kb.measure("charge", 1.0 - DRAIN * clock.now)
    # a full charge lasts for 75 s, and the farther it is, the longer it takes: as soon as the next
    # one is enough
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


def test_wrong_forecast_violates_nothing_that_reacting_keeps():
    put_off = 0
    for case in range(40):
        chance = Random(case)
        kb, clock = mower(chance.choice((-0.01, 0.001, 0.03, 1.0)))
        gains = (Gain("mow", chance.uniform(0.1, 2.0), 0.5, chance.choice((-0.1, 0.3))),)
        value = MissionValue(chance.uniform(40.0, 120.0), gains, (dock(chance.uniform(0.0, 8.0)),))
        tasks = [Act(kb, "mow"), Act(kb, "dock")]
        lookahead = Lookahead(kb, lambda value=value: value)
        tree = ValueSelector("what next", lookahead, tasks)
        for _ in range(20):
            clock.now += chance.choice((0.1, 1.0, 3.0))
            charge = chance.random()
            kb.measure("charge", charge)
            tree.tick_once()
            doing = [request.action for request in kb.required_actions]
            assert charge >= 0.25 or doing == ["dock"]
            put_off += charge >= 0.25 and doing == ["dock"]
        clock.now += 1000.0
        kb.measure("charge", 1.0)
        tree.tick_once()
        assert kb.is_feasible("mow"), "it is not put off for ever"
    assert put_off > 10


@pytest.mark.parametrize(("gain", "doing"), [(0.0, "mow"), (1.0, "dock")])
def test_selector_does_the_first_task_unless_a_detour_pays(gain, doing):
    kb, _ = mower()
    kb.measure("charge", 0.3)
    value = MissionValue(60.0, (Gain("mow", gain, away=0.1),), (dock(),))
    tasks = [Act(kb, name) for name in ("mow", "dock")]
    ValueSelector("next", Lookahead(kb, lambda: value), tasks).tick_once()
    assert [request.action for request in kb.required_actions] == [doing]


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (MissionValue(9.0, (Gain("mov", 1.0),)), UnknownName, "mow"),
        (MissionValue(float("inf"), (Gain("mow", 1.0),)), InvalidValue, "a finite number"),
        (MissionValue(9.0, (Gain("mow", -1.0),)), InvalidValue, "0 or more a second, not -1.0"),
        (
            MissionValue(9.0, detours=(Detour("dock", {"charg": 1.0}, abs, abs),)),
            UnknownName,
            "charge",
        ),
    ],
)
def test_value_that_makes_no_sense_is_refused(value, error, words):
    with pytest.raises(error, match=words):
        Lookahead(mower()[0], lambda: value)
