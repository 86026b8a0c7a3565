"""Forecasts of attributes, and until when actions stay feasible."""

import math
from random import Random

import pytest
from clocks import Clock

from kb import InvalidValue, KnowledgeBase, Model, ModelError, UnknownName
from kb.elements import Rate


def rover(**battery):
    model = Model("rover")
    level = model.quality_attribute("energy", low=0.0, high=1.0, **battery)
    light = model.environmental_attribute("light", unit="lx")
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 1}, priority=1, constraints=[light >= 10.0])
    camera.configuration("night", {"exposure": 9}, priority=2, constraints=[light >= 1.0])
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see], constraints=[level >= 0.25])
    model.action("charge")
    return model


@pytest.fixture
def clock():
    return Clock()


def lives(
    model, clock, *, until, energy=lambda t: 1.0 - 0.005 * t, light=None, doing="explore", every=1.0
):
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("energy", energy(0.0))
    if light is not None:
        kb.measure("light", light(0.0))
    kb.request_action(doing)
    for step in range(1, int(until / every) + 1):
        clock.now = step * every
        kb.measure("energy", energy(clock.now))
        if light is not None:
            kb.measure("light", light(clock.now))
    return kb


def test_stated_rate_says_when_and_why_it_is_unfeasible(clock):
    model = rover()
    model.attributes["energy"].changes(-0.005, per="s", while_="explore")
    kb = lives(model, clock, until=60)
    found = kb.feasible_until("explore")
    assert found.at == pytest.approx(60 + (0.7 - 0.25) / 0.005, abs=0.01)
    assert found.earliest <= found.at + 1e-6
    assert str(found).startswith("unfeasible in 90 s (90 to 90): ")
    assert "energy falls by 0.005/s while explore and reaches 0.25" in str(found)
    ahead = kb.forecast("energy", 30.0)
    assert ahead.value == pytest.approx(0.55)
    assert ahead.low <= ahead.value <= ahead.high
    assert ahead.at == 90.0
    assert "energy is 0.55" in str(ahead)


def test_stated_rate_holds_only_while_its_action_is_done(clock):
    model = rover()
    model.attributes["energy"].changes(-18, per="h", while_=model.actions["explore"])
    model.attributes["energy"].changes(0.01, while_="charge")
    kb = lives(model, clock, until=20)
    assert kb.forecast("energy", 10.0, doing=["charge"]).value == pytest.approx(
        1.0
    )  # it cannot be more
    assert kb.forecast("energy", 10.0, doing=["explore"]).value == pytest.approx(0.85)
    assert kb.forecast("energy", 10.0, doing=["explore", "charge"]).value == pytest.approx(0.95)
    assert kb.forecast("energy", 10.0, doing=[]).value == pytest.approx(0.9)
    assert kb.feasible_until("explore", doing=["charge"]).at is None
    kb.cancel_action("explore")
    assert kb.feasible_until("explore").at is not None  # as if it were done


def test_unknown_attribute_is_not_forecast(clock):
    model = rover()
    kb = KnowledgeBase(model, clock=clock)
    assert kb.forecast("energy", 10.0)[2:5] == (None, None, None)
    assert "its model says nothing of that" in kb.forecast("energy", 10.0).reason
    model.attributes["energy"].forecast("trend")
    assert "it is not measured" in kb.forecast("energy", 10.0).reason
    kb.measure("energy", 0.5)
    assert kb.forecast("energy", 10.0).value is None
    assert kb.feasible_until("explore").at is None
    assert str(kb.feasible_until("explore", 60)) == "feasible for 60 s, as far as is known"
    for step in range(1, 6):
        clock.now = float(step)
        kb.measure("energy", 0.5)
    assert "too little was measured" in kb.forecast("energy", 4.0).reason
    model.attributes["energy"].changes(0.1)
    assert kb.forecast("energy", 4.0)[2:5] == (
        pytest.approx(0.9),
        None,
        None,
    )  # it could not be checked yet
    model.change("energy", max_age=2.0)
    clock.now = 30.0
    assert "stale" in kb.forecast("energy", 10.0).reason


def test_trend_with_outliers_stays_right(clock):
    model = rover()
    model.attributes["energy"].forecast("trend")
    kb = lives(model, clock, until=60, energy=lambda t: 0.01 if t % 7 == 3 else 1.0 - 0.005 * t)
    ahead = kb.forecast("energy", 20.0)
    assert ahead.value == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(("by", "error"), [("constant", 0.1), ("trend", 0.0)])
def test_interval_is_as_wide_as_earlier_errors(clock, by, error):
    model = rover()
    model.attributes["energy"].forecast(by)
    kb = lives(model, clock, until=60)
    ahead = kb.forecast("energy", 20.0)
    assert ahead.high - ahead.low == pytest.approx(2 * error, abs=0.01)
    assert ahead.low - 1e-9 <= 0.6 <= ahead.high


def test_forecast_is_the_same_whoever_asked_before(clock):
    def ask(kb):
        return [kb.forecast("energy", ahead) for ahead in (1.0, 7.0, 30.0)] + [
            kb.feasible_until("explore")
        ]

    def wave(t):
        return 0.6 + 0.2 * math.sin(t / 5)

    model = rover()
    model.attributes["energy"].forecast("trend")
    once = lives(model, clock, until=50, energy=wave)
    other = Clock()
    kb = KnowledgeBase(model, clock=other)
    for event in once.log:
        other.now = event.time
        kb.replay(event)
        ask(kb)
    assert ask(kb) == ask(once)


def test_situation_at_a_later_time_only_adds_caution(clock):
    model = rover()
    model.attributes["energy"].changes(-0.005, while_="explore")
    model.attributes["light"].forecast("trend")
    kb = lives(model, clock, until=60, light=lambda t: 9.0 + 0.015 * t)
    assert kb.situation(at=kb.now + 80).is_feasible("explore")
    then = kb.situation(at=kb.now + 120)
    assert not then.is_feasible("explore")
    assert "energy is 0.1 (0.1 to 0.1) in 120 s: it falls by 0.005/s while explore" in str(
        then.explain("explore")
    )
    assert kb.is_feasible("explore")
    assert then.now == kb.now + 120
    assert kb.forecast("light", 60.0).value > 10.0  # but day is not possible now
    assert kb.situation(at=kb.now + 60).selectable_configurations("camera") == ("night",)
    assert then.situation(energy=0.9).is_feasible(
        "explore"
    )  # what is supposed of it goes before what is forecast
    with pytest.raises(InvalidValue, match="from now on"):
        kb.situation(at=kb.now - 1)


def test_bad_forecast_is_refused_with_what_to_write(clock):
    model = rover()
    energy = model.attributes["energy"]
    with pytest.raises(ModelError, match="constant, trend, or a function"):
        energy.forecast("crystal ball")
    with pytest.raises(ModelError, match="that a module defines"):
        energy.forecast(lambda past, time: 0.5)
    with pytest.raises(UnknownName, match="explore"):
        energy.changes(-1, while_="explor")
    with pytest.raises(UnknownName, match="min"):
        energy.changes(-1, per="m")
    with pytest.raises(InvalidValue, match="finite"):
        energy.changes(math.inf)
    energy.changes(-1, while_="explore")
    with pytest.raises(ModelError, match="a rate of 'energy'"):
        model.remove(model.actions["explore"])
    model.change("energy", rates=[Rate(-1.0, "explor")])  # as files may say
    assert "a rate of energy: unknown action 'explor'; did you mean 'explore'?" in str(
        model.check()
    )
    kb = KnowledgeBase(model, clock=clock)
    for wrong in (-1.0, math.nan):
        with pytest.raises(InvalidValue):
            kb.forecast("energy", wrong)
    with pytest.raises(UnknownName):
        kb.forecast("energy", 1.0, doing=["explor"])


def test_change_of_a_rate_is_an_event_that_replays(clock):
    model, again = rover(), rover()
    model.attributes["energy"].changes(-0.001)
    again.attributes["energy"].changes(-0.001)
    kb, other = KnowledgeBase(model, clock=clock), KnowledgeBase(again, clock=clock)
    kb.measure("energy", 0.9)
    model.attributes["energy"].changes(-0.002)
    for event in kb.log:
        other.replay(event)
    assert other.forecast("energy", 100.0) == kb.forecast("energy", 100.0)
    assert other.forecast("energy", 100.0).value == pytest.approx(0.7)


def half_of(samples, time):
    return samples[-1][1] / 2


def out_of_order(samples, time):
    raise ZeroDivisionError("a bad day")


def test_function_of_the_author_forecasts_or_is_unknown(clock, caplog):
    model = rover()
    model.attributes["energy"].forecast(half_of)
    assert model.attributes["energy"].forecasting == f"{__name__}:half_of"
    kb = lives(model, clock, until=30, energy=lambda t: 0.8)
    ahead = kb.forecast("energy", 5.0)
    assert (ahead.value, ahead.low, ahead.high) == (
        0.4,
        0.0,
        pytest.approx(0.8),
    )  # it was off by 0.4 each time
    model.attributes["energy"].forecast(out_of_order)
    assert kb.forecast("energy", 5.0).value is None
    assert "a bad day" in caplog.text
    model.change("energy", forecasting="elsewhere:unknown")
    assert (
        "elsewhere:unknown, which this program has not given" in kb.forecast("energy", 5.0).reason
    )


def test_interval_holds_nine_in_ten_of_what_goes_in_legs(clock):
    """For 40 s it goes one way: errors of forecasts that overlap are all of one leg, and tell nothing of the next."""
    held = []
    for case in range(12):
        chance, slope, seen = Random(case), 0.0, [0.0]
        for second in range(250):
            slope = slope if second % 40 else chance.gauss(0, 1)
            seen.append(seen[-1] + slope)
        model = Model("legs")
        model.environmental_attribute("height").forecast("constant")
        kb = KnowledgeBase(model, clock=clock)
        for second in range(240):
            clock.now = float(second)
            kb.measure("height", seen[second])
            if second >= 100 and second % 5 == 0:
                found = kb.forecast("height", 8.0)
                held.append(found.low <= seen[second + 8] <= found.high)
    assert 0.85 <= sum(held) / len(held) <= 0.95


@pytest.mark.parametrize("by", ["constant", "trend"])
def test_unchanged_series_reaches_a_ninth_of_its_span(clock, by):
    """Nine spans without a change, one after the other, leave a chance of one in ten that the next one has it."""
    model = rover()
    model.attributes["light"].forecast(by)
    kb = lives(model, clock, until=30, light=lambda _: 1.0)
    assert kb.forecast("light", 8.0)[2:5] == (1.0, 1.0, 1.0)  # four times as far as a check of 2 s
    assert kb.forecast("light", 16.0)[2:5] == (None, None, None)
    kb = lives(model, Clock(), until=60, light=lambda _: 1.0)
    assert kb.forecast("light", 16.0)[2:5] == (1.0, 1.0, 1.0)


def test_rate_is_learned_while_its_action_is_done(clock):
    model = rover()
    energy = model.attributes["energy"]
    energy.changes(-0.01, while_="explore", learns=True)
    energy.changes(0.01, while_="charge", learns=True)
    kb = lives(model, clock, until=5)
    assert kb.forecast("energy", 10.0).value == pytest.approx(
        0.975 - 0.1
    )  # too few to say otherwise
    kb = lives(model, Clock(), until=0)
    clock = Clock()
    kb = lives(model, clock, until=20)
    assert kb.forecast("energy", 10.0).value == pytest.approx(0.9 - 0.05)
    kb.cancel_action("explore")
    kb.request_action("charge")
    for _ in range(10):
        clock.now += 1.0
        kb.measure("energy", 0.9 + 0.002 * (clock.now - 20.0))
    assert kb.forecast("energy", 10.0).value == pytest.approx(0.92 + 0.02)
    assert kb.forecast("energy", 10.0, doing="explore").value == pytest.approx(0.92 - 0.05)


def test_rate_not_learned_yet_has_no_interval(clock):
    model = rover()
    model.attributes["energy"].changes(-0.005, while_="explore", learns=True)
    model.attributes["energy"].changes(0.01, while_="charge", learns=True)
    kb = lives(model, clock, until=60)
    assert kb.forecast("energy", 5.0).low == pytest.approx(0.7 - 0.025)
    kb.cancel_action("explore")
    kb.request_action("charge")
    guessed = kb.forecast("energy", 5.0)
    assert (guessed.value, guessed.low, guessed.high) == (pytest.approx(0.7 + 0.05), None, None)
    assert "how exactly is not known" in guessed.reason


def test_value_at_a_bound_teaches_no_rate(clock):
    model = rover()
    model.attributes["energy"].changes(-0.01, while_="explore", learns=True)
    kb = lives(model, clock, until=60, energy=lambda t: max(0.6 - 0.02 * t, 0.0))
    stuck = kb.forecast("energy", 5.0)
    assert (stuck.low, stuck.value) == (0.0, 0.0)
    assert stuck.high < 0.02
    kb.cancel_action("explore")
    clock.now += 1.0
    kb.measure("energy", 0.9)
    assert kb.forecast("energy", 10.0, doing="explore").value == pytest.approx(0.9 - 0.2)


@pytest.mark.parametrize("rate", [-1 / 330, -1 / 167])
def test_constant_rate_learns_while_actions_run(clock, rate):
    model = rover()
    model.attributes["energy"].changes(-1 / 200, learns=True)
    kb = KnowledgeBase(model, clock=clock)
    for second in range(120):
        clock.now = float(second)
        kb.measure("energy", 1.0 + rate * second)
        if second % 7 == 0:
            kb.request_action("explore")
        elif second % 7 == 4:
            kb.cancel_action("explore")
    ahead = kb.forecast("energy", 20.0)
    assert ahead.value == pytest.approx(1.0 + rate * 139)
    assert ahead.high - ahead.low < 1e-6


def test_rate_is_learned_beside_one_that_is_known(clock):
    model = rover()
    model.attributes["energy"].changes(-0.01, learns=True)
    model.attributes["energy"].changes(0.05, while_="charge", learns=True)
    kb = KnowledgeBase(model, clock=clock)
    level = 0.5
    for second in range(60):
        clock.now = float(second)
        kb.measure("energy", level)
        if second == 30:
            kb.request_action("charge")
        level += -0.005 if second < 30 else 0.01
    assert kb.forecast("energy", 5.0, doing="charge").value == pytest.approx(level - 0.01 + 0.05)
    assert kb.forecast("energy", 5.0, doing=()).value == pytest.approx(level - 0.01 - 0.025)


def test_restored_attribute_leaves_the_jump_out_of_its_errors(clock):
    """A battery that lasts 150 s, with noise, is recharged at a quarter."""
    model = rover()
    model.attributes["energy"].changes(-1 / 200, learns=True)
    kb = KnowledgeBase(model, clock=clock)
    chance = Random(1)
    level = 1.0
    levels = []
    widths = []
    hits = []
    for second in range(700):
        clock.now = float(second)
        levels.append(min(max(level + chance.gauss(0, 0.002), 0.0), 1.0))
        kb.measure("energy", levels[-1])
        level = 1.0 if level < 0.25 else level - 1 / 150
    for event in [event for event in kb.log if event.verb == "measure"]:
        clock.now = event.time
        if clock.now == 0.0:
            kb = KnowledgeBase(model, clock=clock)
        kb.measure(*event.arguments)
        ahead = kb.forecast("energy", 20.0)
        then = int(clock.now) + 20
        if clock.now >= 100 and then < 700:
            widths.append(ahead.high - ahead.low)
            hits.append(ahead.low <= levels[then] <= ahead.high)
    assert sorted(widths)[len(widths) // 2] < 0.04
    assert sum(hits) / len(hits) >= 0.75  # of the others the horizon includes a recharge
