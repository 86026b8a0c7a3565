"""The best joint choice: equal to trying everything, the same every time, and honest about what was not proven."""

import pytest
from best_by_trying import best_by_trying, every_choice, exact, outcome
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from models import Clock, Twins, events, models

from kb import InvalidValue, KnowledgeBase, Model, PriorityPlanner, UnknownName
from kb.optimum import best_choice, solve, verdicts
from kb.optimum_planner import OptimalPlanner
from kb.optimum_posing import pose
from kb.selection import Criterion

SLOW = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
VALUES = st.sampled_from((0.0, 0.1, 0.3, 1.0, 2.5, -0.7))
WEIGHTS = st.sampled_from((1.0, 0.5, -1.0, 0.0, 0.1))
COSTS = st.sampled_from((0.0, 0.1, 1.0))


@st.composite
def estimated_models(draw):
    model = draw(models())
    causers = [*model.designs.values(), *model.components.values(), *model.configurations.values()]
    if causers:
        for _ in range(draw(st.integers(1, 12))):
            causer = draw(st.sampled_from(causers))
            kind = draw(st.sampled_from(("positive", "negative", "positive", "absolute")))
            causer.estimate(draw(st.sampled_from(sorted(model.attributes))), draw(VALUES), kind)
    return model


@st.composite
def robots(draw, estimated=True):
    """A knowledge base in which something happened and something is required."""
    model = draw(estimated_models() if estimated else models())
    twins = Twins(model)
    for event in draw(st.lists(events(model), max_size=8)):
        twins.happen(event)
    for action in model.actions:
        if draw(st.sampled_from((True, True, False))):
            twins.kb.request_action(action)
    return twins.kb


@st.composite
def criteria(draw, kb):
    names = sorted(kb.model.attributes)
    weights = draw(st.dictionaries(st.sampled_from(names), WEIGHTS, max_size=2))
    budgets = draw(st.dictionaries(st.sampled_from(names), st.sampled_from((0.0, 0.4, 1.0, 2.6, 5.0)), max_size=2))
    components = sorted(kb.model.components)
    each = st.dictionaries(st.sampled_from(components), COSTS) if components else COSTS
    return Criterion(weights, draw(COSTS | each), budgets)


@SLOW
@given(st.data())
def test_best_choice_is_the_one_found_by_trying_all(data):
    kb = data.draw(robots())
    criterion = data.draw(criteria(kb))
    expected = best_by_trying(kb._state, criterion)
    found = best_choice(kb._state, criterion)
    assert found.is_proven
    if expected is None:
        assert found.choice is None
        assert found.reason
        return
    worth, designs, configurations = expected
    assert (found.value, found.gap, found.resolution) == (pytest.approx(float(worth), abs=1e-12), 0.0, 0.0)
    assert dict(found.choice.designs) == designs
    assert dict(found.choice.configurations) == configurations
