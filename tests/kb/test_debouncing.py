"""Constraints that do not flap: hysteresis, dwell, and n of the last k measurements."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import OPERATORS, Clock, compare

from kb import EventKind, KnowledgeBase, Model, ModelError, PriorityPlanner, Status

HOLDS = {
    ">=": lambda value, bound: value >= bound,
    ">": lambda value, bound: value > bound,
    "<=": lambda value, bound: value <= bound,
    "<": lambda value, bound: value < bound,
}
VALUES = st.sampled_from((0.0, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0))


def rover(*, operator=">=", hysteresis=0.0, dwell=0.0, agreement=(1, 1)):
    model = Model("rover")
    light = model.environmental_attribute("light", agreement=agreement)
    bound = compare(light, operator, 0.5).steady(hysteresis=hysteresis, dwell=dwell)
    camera = model.component("camera", always_improve=True)
    camera.configuration("day", priority=1, constraints=[bound])
    camera.configuration("night", priority=2)
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see])
    return model


def status(kb):
    return kb.configurations["day"].constraints[0].status


class Oracle:
    """One constraint by the letter: what it was, since when, and the last k measurements; looked at at every step."""

    def __init__(self, operator, hysteresis, dwell, agreement):
        self.operator, self.hysteresis, self.dwell = operator, hysteresis, dwell
        self.enough, self.last = agreement
        self.values, self.status, self.since = [], "not evaluated", None

    def step(self, now, value=None):
        if value is not None:
            self.values = [*self.values, value][-self.last :]
        margin = self.hysteresis if self.status == "violated" else 0.0
        bound = 0.5 + (margin if self.operator in (">=", ">") else -margin)
        good = sum(HOLDS[self.operator](one, bound) for one in self.values)
        said = {
            good >= self.enough: "satisfied",
            len(self.values) - good >= self.enough: "violated",
        }
        wanted = said.get(True, self.status)
        if wanted != self.status and (
            self.status == "not evaluated" or now >= self.since + self.dwell
        ):
            self.status, self.since = wanted, now


settings_of_constraints = st.fixed_dictionaries(
    {
        "operator": st.sampled_from(OPERATORS),
        "hysteresis": st.sampled_from((0.0, 0.1, 0.2)),
        "dwell": st.sampled_from((0.0, 1.0, 2.5)),
        "agreement": st.sampled_from(((1, 1), (2, 2), (2, 3), (3, 5))),
    }
)
steps = st.lists(
    st.tuples(st.sampled_from((0.0, 0.25, 0.5, 1.0, 3.0)), st.none() | VALUES),
    min_size=1,
    max_size=40,
)


@settings(max_examples=100)
@given(settings_of_constraints, steps)
def test_a_steady_constraint_is_what_the_letter_says_after_every_step(given_settings, story):
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(**given_settings), clock=clock)
    oracle = Oracle(**given_settings)
    now = 0.0
    for pause, value in story:
        for _ in range(round(pause / 0.25)):  # the letter looks all the time
            now += 0.25
            oracle.step(now)
        clock.now = now
        if value is not None:
            kb.measure("light", value)
            oracle.step(now, value)
        assert str(status(kb)) == oracle.status


@given(
    st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 1.0)), min_size=2, max_size=60),
    st.floats(0.5, 5.0),
)
def test_noise_of_any_kind_about_a_threshold_switches_at_most_once_a_dwell(noise, dwell):
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(dwell=dwell), clock=clock)
    changes, plans = [], []
    kb.subscribe(
        lambda event: changes.extend(one for one in event.changes if one.kind == "constraint")
    )
    kb.subscribe(
        lambda event: plans.append(event) if event.kind is EventKind.RECONFIGURATION_PLAN else None
    )
    planner = PriorityPlanner()

    def adapt():
        plan = planner.plan(kb)
        if plan is not None:
            for name in plan.activate:
                kb.component_active(name, True)
            kb.finish_plan(plan, "completed")

    kb.request_action("explore")
    kb.measure("light", 1.0)
    adapt()
    first_changes, first_plans = len(changes), len(plans)
    for pause, value in noise:
        clock.now += pause
        kb.measure("light", value)
        adapt()
    assert len(changes) - first_changes <= clock.now / dwell
    assert len(plans) - first_plans <= clock.now / dwell


def test_by_default_nothing_is_debounced_as_in_rosa():
    kb = KnowledgeBase(rover(), clock=Clock())
    for value in (0.49, 0.5, 0.49, 0.5):
        kb.measure("light", value)
        assert status(kb) is (Status.SATISFIED if value >= 0.5 else Status.VIOLATED)


def test_a_violated_constraint_with_hysteresis_comes_back_only_beyond_its_threshold():
    kb = KnowledgeBase(rover(hysteresis=0.1), clock=Clock(0.0))
    seen = []
    for value in (0.5, 0.49, 0.55, 0.6, 0.5):
        kb.measure("light", value)
        seen.append(str(status(kb)))
    assert seen == ["satisfied", "violated", "violated", "satisfied", "satisfied"]


def test_what_is_held_is_explained_and_told_what_would_help():
    kb = KnowledgeBase(rover(hysteresis=0.1), clock=Clock(0.0))
    kb.measure("light", 0.4)
    kb.measure("light", 0.55)
    explanation = kb.explain(kb.configurations["day"])
    assert str(explanation) == (
        "day is unfeasible because light 0.55 satisfies >= 0.5 (measured 0.0 s ago), but >= 0.5 stays violated "
        "until light >= 0.6; it would be feasible with light >= 0.6"
    )
    assert kb.situation(light=0.6).configurations["day"].status is Status.FEASIBLE
    assert kb.situation(light=0.59).configurations["day"].status is Status.UNFEASIBLE


def test_what_dwell_holds_changes_by_itself_when_the_dwell_is_over():
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(dwell=5.0), clock=clock)
    heard = []
    kb.measure("light", 0.4)
    clock.now = 2.0
    kb.measure("light", 0.9)
    kb.subscribe(heard.append)
    clock.now = 4.9
    assert status(kb) is Status.VIOLATED
    assert str(kb.explain(kb.configurations["day"])).endswith(
        "but >= 0.5 stays violated for 5 s at least; it would be feasible with light >= 0.5 for longer"
    )
    clock.now = 5.0
    assert status(kb) is Status.SATISFIED
    assert [event.text for event in heard] == ["light >= 0.5 is satisfied, after its dwell"]


@pytest.mark.parametrize(
    ("how", "values", "told"),
    [
        (
            {"agreement": (2, 3)},
            (0.4, 0.4, 0.9),
            "stays violated until 2 of the last 3 measurements say otherwise",
        ),
        (
            {"agreement": (2, 3)},
            (0.9, 0.9, 0.4),
            "stays satisfied until 2 of the last 3 measurements say otherwise",
        ),
        ({"dwell": 5.0}, (0.9, 0.4), "stays satisfied for 5 s at least"),
        ({"hysteresis": 0.1, "dwell": 5.0}, (0.4, 0.9), "stays violated for 5 s at least"),
        (
            {"hysteresis": 0.1, "dwell": 5.0},
            (0.4, 0.55),
            "stays violated for 5 s at least, and until light >= 0.6",
        ),
        (
            {"hysteresis": 0.1, "agreement": (2, 3)},
            (0.4, 0.4, 0.55),
            "stays violated until 2 of the last 3 measurements are >= 0.6",
        ),
        (
            {"agreement": (2, 3)},
            (0.9,),
            "light 0.9 is not confirmed: 2 of the last 3 measurements have to agree",
        ),
        ({"hysteresis": 0.1, "operator": "<="}, (0.6, 0.45), "stays violated until light <= 0.4"),
    ],
)
def test_what_holds_a_steady_constraint_is_told_in_its_own_words(how, values, told):
    kb = KnowledgeBase(rover(**how), clock=Clock(0.0))
    for value in values:
        kb.measure("light", value)
    assert told in kb.explain(kb.configurations["day"].constraints[0]).fact


def test_threshold_and_hysteresis_add_up_as_on_paper():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("go", constraints=[(light >= 0.1).steady(hysteresis=0.2)])
    kb = KnowledgeBase(model, clock=Clock(0.0))
    kb.measure("light", 0.0)
    assert str(kb.explain("go")).endswith("it would be feasible with light >= 0.3")
    kb.measure("light", 0.3)
    assert kb.is_feasible("go")


def test_a_value_that_goes_back_in_time_changes_nothing():
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(dwell=5.0), clock=clock)
    kb.measure("light", 0.9)
    clock.now = 1.0
    kb.measure("light", 0.1)
    clock.now = 2.0
    kb.measure("light", 0.9)
    clock.now = 60.0
    assert status(kb) is Status.SATISFIED


def test_one_odd_measurement_of_three_changes_nothing():
    kb = KnowledgeBase(rover(agreement=(2, 3)), clock=Clock(0.0))
    seen = []
    for value in (0.9, 0.9, 0.1, 0.9, 0.1, 0.1):
        kb.measure("light", value)
        seen.append(str(status(kb)))
    assert seen == ["not evaluated", "satisfied", "satisfied", "satisfied", "violated", "violated"]


def test_old_measurements_have_no_say_once_the_latest_was_stale():
    clock = Clock(0.0)
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=5.0, agreement=(2, 3))
    model.action("look", constraints=[light >= 0.5])
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("light", 0.1)
    kb.measure("light", 0.1)
    assert not kb.is_feasible("look")
    clock.now = 10.0
    assert kb.is_feasible("look")
    kb.measure("light", 0.9)
    clock.now = 11.0
    kb.measure("light", 0.9)
    assert kb.is_feasible("look")


def test_debouncing_can_be_changed_while_the_base_is_at_work():
    kb = KnowledgeBase(rover(), clock=Clock(0.0))
    kb.measure("light", 0.4)
    (bound,) = kb.model.constraints
    kb.model.change(bound, hysteresis=0.2)
    kb.measure("light", 0.6)
    assert status(kb) is Status.VIOLATED
    kb.model.change(bound, hysteresis=0.0)
    assert status(kb) is Status.SATISFIED
    kb.model.change(kb.model.attributes["light"], agreement=(2, 2))
    assert status(kb) is Status.NOT_EVALUATED
    kb.measure("light", 0.1)
    assert status(kb) is Status.NOT_EVALUATED
    kb.measure("light", 0.1)
    assert status(kb) is Status.VIOLATED
    steady = (kb.model.attributes["light"] <= 0.3).steady(dwell=1.0)
    kb.model.components["camera"].constrain(steady)
    kb.model.change(kb.model.attributes["light"], agreement=(1, 1))
    assert kb.components["camera"].constraints[0].status is Status.SATISFIED


@pytest.mark.parametrize(
    "wrong", [(1, 2), (0, 1), (3, 2), (2,), "2 of them", (1.0, 1), (True, True), None]
)
def test_an_agreement_is_of_more_than_half(wrong):
    with pytest.raises(ModelError, match="agreement of 'light' is two whole numbers"):
        Model("rover").quality_attribute("light", agreement=wrong)


@pytest.mark.parametrize("what", ["hysteresis", "dwell"])
@pytest.mark.parametrize("wrong", [-1.0, float("nan"), float("inf"), "much"])
def test_hysteresis_and_dwell_are_numbers_from_zero(what, wrong):
    light = Model("rover").quality_attribute("light")
    with pytest.raises(ValueError, match="number"):
        (light >= 0.5).steady(**{what: wrong})
