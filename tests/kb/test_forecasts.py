"""Forecasts of attributes, and until when actions stay feasible."""

import math
from random import Random

import pytest
from clocks import Clock

from kb import InvalidValue, KnowledgeBase, Model, UnknownName
from kb.elements import Rate


def rover(*rates, forecast=None):
    """Return a model with rates of its energy, (per s, while, learns), or a way to forecast."""
    model = Model("rover")
    energy = model.quality_attribute("energy", low=0.0, high=1.0)
    light = model.environmental_attribute("light", unit="lx")
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 1}, priority=1, constraints=[light >= 10.0])
    camera.configuration("night", {"exposure": 9}, priority=2, constraints=[light >= 1.0])
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see], constraints=[energy >= 0.25])
    model.action("charge")
    for per_s, action, *learns in rates:
        energy.changes(per_s, while_=action, learns=any(learns))
    if forecast:
        energy.forecast(forecast)
        light.forecast(forecast)
    return model


class Life:
    """A knowledge base that measures each second."""

    def __init__(self, model, doing="explore"):
        self.clock = Clock()
        self.kb = KnowledgeBase(model, clock=self.clock)
        if doing:
            self.kb.request_action(doing)

    def measure(self, until, **values):
        """Measure functions of time by attribute, from now until a time."""
        while self.clock.now <= until:
            for name, value in values.items():
                self.kb.measure(name, value(self.clock.now))
            self.clock.now += 1.0
        self.clock.now -= 1.0
        return self.kb


def falling(time):
    return 1.0 - 0.005 * time


def test_stated_rate_gives_when_and_why_unfeasible():
    kb = Life(rover((-0.005, "explore"))).measure(60, energy=falling)
    until = kb.feasible_until("explore")
    assert until.at == pytest.approx(60 + (0.7 - 0.25) / 0.005, abs=0.01)
    assert until.earliest <= until.at + 1e-6
    assert str(until) == (
        "unfeasible in 90 s (90 to 90): energy falls by 0.005/s while explore and reaches 0.25"
    )
    forecast = kb.forecast("energy", 30.0)
    assert forecast.low <= forecast.value <= forecast.high
    assert (forecast.at, str(forecast)) == (
        90.0,
        "energy is 0.55 (0.55 to 0.55) in 30 s: it falls by 0.005/s while explore",
    )


@pytest.mark.parametrize(
    ("doing", "value"),
    [(["charge"], 1.0), (["explore"], 0.85), (["explore", "charge"], 0.95), ([], 0.9)],
)
def test_rates_that_apply_add_up_within_the_range(doing, value):
    kb = Life(rover((-0.005, "explore"), (0.01, "charge"))).measure(20, energy=falling)
    assert kb.forecast("energy", 10.0, doing=doing).value == pytest.approx(value)


def test_feasible_until_supposes_what_is_done():
    kb = Life(rover((-0.005, "explore"), (0.01, "charge"))).measure(20, energy=falling)
    assert kb.feasible_until("explore", doing=["charge"]).at is None
    kb.cancel_action("explore")
    assert kb.feasible_until("explore").at is not None  # as if it were done


def test_unknown_forecast_says_why():
    life = Life(rover())
    kb = life.kb
    energy = kb.model.attributes["energy"]
    assert kb.forecast("energy", 10.0)[2:5] == (None, None, None)
    assert "its model says nothing of that" in kb.forecast("energy", 10.0).reason
    energy.forecast("trend")
    assert "it is not measured" in kb.forecast("energy", 10.0).reason
    life.measure(5, energy=lambda _: 0.5)
    assert "too little was measured" in kb.forecast("energy", 4.0).reason
    assert str(kb.feasible_until("explore", 60)) == "feasible for 60 s, as far as is known"
    energy.changes(0.1)
    unchecked = kb.forecast("energy", 4.0)
    assert unchecked[2:5] == (pytest.approx(0.9), None, None)
    assert "how exactly is not known" in unchecked.reason
    kb.model.change("energy", max_age=2.0)
    life.clock.now = 30.0
    assert "stale" in kb.forecast("energy", 10.0).reason


@pytest.mark.parametrize(("by", "error"), [("constant", 0.1), ("trend", 0.0)])
def test_interval_is_as_wide_as_earlier_errors(by, error):
    forecast = Life(rover(forecast=by)).measure(60, energy=falling).forecast("energy", 20.0)
    assert forecast.high - forecast.low == pytest.approx(2 * error, abs=0.01)
    assert forecast.low - 1e-9 <= 0.6 <= forecast.high


def test_replayed_events_give_the_same_forecasts():
    """Also a change of a rate is replayed, and who asked before makes no difference."""

    def ask(kb):
        forecasts = [kb.forecast("light", ahead) for ahead in (1.0, 7.0, 30.0)]
        return [*forecasts, kb.forecast("energy", 9.0), kb.feasible_until("explore")]

    life = Life(rover((-0.005, "explore"), forecast="trend"))
    kb = life.measure(40, energy=falling, light=lambda time: 12 + math.sin(time / 5))
    kb.model.attributes["energy"].changes(-0.002, while_="explore")
    clock = Clock()
    again = KnowledgeBase(rover((-0.005, "explore"), forecast="trend"), clock=clock)
    for event in kb.log:
        clock.now = event.time
        again.replay(event)
        ask(again)
    assert ask(again) == ask(kb)


@pytest.mark.parametrize(
    ("declare", "error", "words"),
    [
        (lambda energy: energy.forecast("crystal ball"), UnknownName, "'constant', 'trend'"),
        (lambda energy: energy.changes(-1, while_="explor"), UnknownName, "explore"),
        (lambda energy: energy.changes(math.inf), InvalidValue, "finite"),
    ],
)
def test_bad_declaration_is_refused_with_what_to_write(declare, error, words):
    with pytest.raises(error, match=words):
        declare(rover().attributes["energy"])


def test_rate_of_an_unknown_action_is_a_finding():
    model = rover((-1.0, "explore"))
    model.change("energy", rates=[Rate(-1.0, "explor")])  # as files may say
    words = "a rate of energy: unknown action 'explor'; did you mean 'explore'?"
    assert words in str(model.check())


@pytest.mark.parametrize(("horizon", "doing"), [(-1.0, None), (math.nan, None), (1.0, ["explor"])])
def test_bad_question_is_refused(horizon, doing):
    kb = Life(rover((-0.005, "explore"))).kb
    with pytest.raises((InvalidValue, UnknownName)):
        kb.forecast("energy", horizon, doing=doing)


def test_interval_holds_nine_in_ten_of_what_goes_in_legs():
    """Errors of forecasts that overlap are all of one leg, and tell nothing of the next."""
    hits = []
    for case in range(12):
        chance = Random(case)
        slope = 0.0
        heights = [0.0]
        for second in range(200):
            slope = slope if second % 40 else chance.gauss(0, 1)
            heights.append(heights[-1] + slope)
        life = Life(rover(forecast="constant"), doing=None)
        for second in range(0, 190, 5):
            life.measure(second, light=lambda time, heights=heights: heights[int(time)])
            life.clock.now += 1.0
            if second >= 100:
                forecast = life.kb.forecast("light", 7.0)
                hits.append(forecast.low <= heights[second + 8] <= forecast.high)
    assert 0.85 <= sum(hits) / len(hits) <= 0.95


def test_rate_is_learned_while_its_action_is_done():
    life = Life(rover((-0.01, "explore", True), (0.01, "charge", True)))
    kb = life.measure(5, energy=falling)
    few = kb.forecast("energy", 10.0)
    assert few[2:5] == (pytest.approx(0.975 - 0.1), None, None)  # too few to say otherwise
    life.measure(20, energy=falling)
    assert kb.forecast("energy", 10.0).low == pytest.approx(0.9 - 0.05)
    kb.cancel_action("explore")
    kb.request_action("charge")
    assert kb.forecast("energy", 10.0)[2:5] == (pytest.approx(1.0), None, None)
    life.measure(30, energy=lambda time: 0.9 + 0.002 * (time - 20.0))
    assert kb.forecast("energy", 10.0).value == pytest.approx(0.92 + 0.02)
    assert kb.forecast("energy", 10.0, doing=["explore"]).value == pytest.approx(0.92 - 0.05)


@pytest.mark.parametrize("rate", [-1 / 330, -1 / 167])
def test_constant_rate_learns_while_actions_run(rate):
    life = Life(rover((-1 / 200, "", True)), doing=None)
    for second in range(0, 120, 4):
        kb = life.measure(second, energy=lambda time: 1.0 + rate * time)
        (kb.request_action if second % 8 else kb.cancel_action)("explore")
        life.clock.now += 1.0
    forecast = kb.forecast("energy", 20.0)
    assert forecast.value == pytest.approx(1.0 + rate * 137, abs=1e-6)
    assert forecast.high - forecast.low < 1e-6


def test_rate_is_learned_beside_one_that_is_known():
    life = Life(rover((-0.01, "", True), (0.05, "charge", True)), doing=None)
    life.measure(30, energy=lambda time: 0.5 - 0.005 * time)
    life.kb.request_action("charge")
    kb = life.measure(60, energy=lambda time: 0.35 + 0.01 * (time - 30))
    assert kb.forecast("energy", 5.0, doing=["charge"]).value == pytest.approx(0.65 + 0.05)
    assert kb.forecast("energy", 5.0, doing=()).value == pytest.approx(0.65 - 0.025)


def test_interval_includes_actions_that_nobody_stated():
    """Each tenth second another action begins; if it is stated that none does, this is left out."""
    life = Life(rover((-0.001, "explore", True), (0.004, "charge", True)), doing=None)
    kb = life.kb
    level = 0.5
    levels = []
    for second in range(0, 200, 10):
        action, rate = ("charge", 0.004) if second % 20 else ("explore", -0.002)
        kb.request_action(action)
        levels += [level + rate * passed for passed in range(10)]
        life.measure(second + 9, energy=lambda time, levels=levels: levels[int(time)])
        kb.cancel_action(action)
        life.clock.now += 1.0
        level += 10 * rate
    kb.request_action("explore")
    widths = {}
    for doing in (None, ["explore"]):
        forecast = kb.forecast("energy", 8.0, doing=doing)
        widths[bool(doing)] = forecast.high - forecast.low
    assert widths[True] < 0.001
    assert widths[False] > 0.04


def test_restored_attribute_leaves_the_jump_out_of_its_errors():
    """A battery that lasts 150 s, with noise, is recharged at a quarter."""
    chance = Random(1)
    level = 1.0
    levels = []
    for _ in range(360):
        levels.append(min(max(level + chance.gauss(0, 0.002), 0.0), 1.0))
        level = 1.0 if level < 0.25 else level - 1 / 150
    life = Life(rover((-1 / 200, "", True)))
    widths = []
    hits = []
    for second in range(100, 340, 3):
        kb = life.measure(second, energy=lambda time: levels[int(time)])
        forecast = kb.forecast("energy", 20.0)
        widths.append(forecast.high - forecast.low)
        hits.append(forecast.low <= levels[second + 20] <= forecast.high)
        life.clock.now += 1.0
    assert sorted(widths)[len(widths) // 2] < 0.04
    assert sum(hits) / len(hits) >= 0.75  # of the others the horizon includes a recharge


def test_trend_with_outliers_stays_right():
    life = Life(rover(forecast="trend"))
    kb = life.measure(60, energy=lambda time: 0.01 if time % 7 == 3 else falling(time))
    assert kb.forecast("energy", 20.0).value == pytest.approx(0.6, abs=0.01)


def test_burst_after_a_long_time_does_not_slow_a_forecast_down():
    life = Life(rover(forecast="trend"), doing=None)
    for number in range(60):
        life.clock.now += 60.0 if number < 40 else 1e-6
        life.kb.measure("energy", 0.5)
    assert life.kb.forecast("energy", 10.0).value == 0.5
