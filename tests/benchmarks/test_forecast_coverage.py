"""How often the intervals of forecasts contain what comes in missions, and how wide they are."""

import sys
from bisect import bisect_left
from itertools import pairwise
from pathlib import Path
from random import Random
from statistics import fmean, median

import pytest

from kb import KnowledgeBase, Model
from missions.suave_extended.model import suave_extended_model

sys.path.insert(0, str(Path(__file__).parents[1] / "missions"))
from running import run_mission

pytestmark = pytest.mark.benchmark

SEEDS = range(100, 103)
HORIZONS_S = (2.0, 5.0, 10.0, 20.0, 40.0)
ACTION_VERBS = ("request_action", "cancel_action")
CASES = {
    ("suave", "water_visibility"): "constant",
    ("suave_extended", "battery_level"): "rates",
    ("agv", "energy"): "rates",
    ("agv", "light"): "constant",
    ("agv", "driven"): "trend",
    ("uav", "battery_level"): "rates",
}


def make_model(kb, attribute, method):
    model = Model("robot")
    source = kb.model.attributes[attribute]
    element = model.quality_attribute(attribute, low=source.low, high=source.high)
    for action in kb.actions:
        model.action(action)
        if method == "rates":
            element.changes(0.0, while_=action, learns=True)
    if method != "rates":
        element.forecast(method)
    return model


def forecasts(kb, attribute, model, every_s, noise=0.0, seed=0):
    """Go through a run again; yield each forecast with what came, and whether that was as assumed.

    It was if the same actions were done meanwhile, and the attribute was not restored.
    """
    chance = Random(seed)
    element = model.attributes[attribute]
    times = []
    values = []
    for event in kb.log:
        if event.verb == "measure" and event.arguments[0] == attribute:
            value = event.arguments[1] + chance.gauss(0.0, noise)
            times.append(event.time)
            values.append(min(max(value, element.low), element.high))
    gap = median(after - before for before, after in pairwise(times))
    usual = median(abs(after - before) for before, after in pairwise(values))
    jumps = [abs(after - before) > 10 * usual > 0.0 for before, after in pairwise(values)]
    turns = [event.time for event in kb.log if event.verb in ACTION_VERBS]
    now = [0.0]
    again = KnowledgeBase(model, clock=lambda: now[0])
    due = every_s
    place = -1
    for event in kb.log:
        now[0] = event.time
        if event.verb in ACTION_VERBS:
            again.replay(event)
        if event.verb != "measure" or event.arguments[0] != attribute:
            continue
        place += 1
        again.measure(attribute, values[place])
        if event.time < due:
            continue
        due = event.time + every_s
        for ahead in HORIZONS_S:
            then = bisect_left(times, event.time + ahead - 1e-6)
            if then == len(times):
                continue
            is_seldom = times[then] > event.time + ahead + 2 * gap
            at = event.time + ahead if is_seldom else times[then]
            came = then - 1 if is_seldom else then
            forecast = again.forecast(attribute, at - event.time)
            is_as_assumed = not any(jumps[place:came]) and not any(
                event.time < turn <= at for turn in turns
            )
            yield ahead, forecast, values[came], is_as_assumed


def is_hit(forecast, came):
    return forecast.low - 1e-9 <= came <= forecast.high + 1e-9


def test_intervals_contain_what_comes_as_often_as_they_say(tables):
    rows = []
    for (mission, attribute), method in CASES.items():
        runs = [run_mission(mission, seed=seed)[0].kb for seed in SEEDS]
        cases = []
        for kb in runs:
            cases += forecasts(kb, attribute, make_model(kb, attribute, method), every_s=3.0)
        bounded = [case for case in cases if case[1].low is not None]
        hits = [is_hit(forecast, came) for _, forecast, came, _ in bounded]
        as_assumed = [is_hit(forecast, came) for _, forecast, came, is_so in bounded if is_so]
        width = median(forecast.high - forecast.low for _, forecast, _, _ in bounded)
        unknown = len(cases) - len(bounded)
        shares = [f"{fmean(hits):.0%}", f"{fmean(as_assumed):.0%}", f"{width:.3g}"]
        rows.append((mission, attribute, method, len(cases), unknown, *shares))
    heads = ("mission", "attribute", "by", "asked", "unknown", "held", "as assumed", "width")
    table = [heads, tuple("---" for _ in heads), *rows]
    tables["forecasts"] = lambda: "\n".join(f"| {' | '.join(map(str, row))} |" for row in table)
    assert all(int(row[-2].removesuffix("%")) >= 80 for row in rows)


@pytest.mark.parametrize("noise", [0.0, 0.002])
@pytest.mark.parametrize("discharge_time_s", [167, 200, 330])
def test_battery_of_suave_20_s_ahead_is_at_most_0_04_wide(discharge_time_s, noise, tables):
    widths = []
    hits = []
    for seed in SEEDS:
        kb = run_mission("suave_extended", seed=seed, discharge_time_s=discharge_time_s)[0].kb
        model = suave_extended_model()
        for ahead, forecast, came, _ in forecasts(kb, "battery_level", model, 1.0, noise, seed):
            if ahead == 20.0 and forecast.low is not None:
                widths.append(forecast.high - forecast.low)
                hits.append(is_hit(forecast, came))
    widest = sorted(widths)[len(widths) * 95 // 100]
    row = (discharge_time_s, noise, f"{fmean(hits):.1%}", f"{fmean(widths):.4f}", f"{widest:.4f}")
    tables[f"battery {row[:2]}"] = lambda: f"| {' | '.join(map(str, row))} |"
    assert widest <= 0.04
    assert fmean(hits) >= 0.85
