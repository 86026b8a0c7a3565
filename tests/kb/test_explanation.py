"""Explanations: sentences that a person reads, chains that end in facts, numbers that agree with their comparison."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import Clock, compare

from kb import KnowledgeBase, Model, Status, UnknownName
from kb.explain import shortest

SPELLED_OUT = re.compile(
    r"(?P<shown>\S+) (?P<word>violates|satisfies) (?P<operator>[<>]=?) (?P<bound>\S+)"
)


def holds(shown, operator, bound):
    return {">=": shown >= bound, ">": shown > bound, "<=": shown <= bound, "<": shown < bound}[
        operator
    ]


@pytest.fixture
def clock():
    return Clock(50.0)


@pytest.fixture
def kb(clock):
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 0.01}, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, constraints=[light >= 0.1])
    see = model.function("see")
    see.design("by camera", [camera])
    model.function("dream")
    model.action("explore", requires=[see], constraints=[light >= 0.25])
    model.action("look", requires=[see])
    model.action("imagine", requires=["dream"])
    model.action("rest")
    return KnowledgeBase(model, clock=clock)


def test_a_violated_constraint_of_an_action_is_told_with_measurement_bound_and_age(kb, clock):
    kb.measure("light", 0.24)
    clock.now += 1.0
    assert (
        kb.explain("explore").sentence
        == "explore is unfeasible because light 0.24 violates >= 0.25 (measured 1.0 s ago)"
    )


def test_a_failed_component_is_told_through_every_level(kb):
    kb.component_failed("camera")
    assert kb.explain("look").sentence == (
        "look is unfeasible because function see is unfeasible because function design by camera is unfeasible "
        "because component camera has failed"
    )
    assert kb.explain(kb.components["camera"]).sentence == "camera has failed"


def test_configurations_that_are_all_unfeasible_are_told_together(kb, clock):
    kb.measure("light", 0.05)
    clock.now += 2.5
    assert kb.explain(kb.components["camera"]).sentence == (
        "camera is unfeasible because configuration day is unfeasible because light 0.05 violates >= 0.5 "
        "(measured 2.5 s ago) and configuration night is unfeasible because light 0.05 violates >= 0.1 "
        "(measured 2.5 s ago)"
    )


def test_a_function_without_a_design_says_so(kb):
    assert kb.explain("imagine").sentence == (
        "imagine is unfeasible because function dream is unfeasible because it has no design"
    )


def test_each_status_of_a_required_chain_reads_as_a_sentence(kb):
    kb.request_action("look")
    assert kb.explain("look").sentence == (
        "look is unsolved because function see is unsolved because none of its designs is selected"
    )
    kb.select({"see": "by camera"})
    assert kb.explain(kb.functions["see"]).sentence == (
        "see is unsolved because function design by camera is unsolved because component camera is unsolved because "
        "it is required and not active"
    )
    kb.component_active("camera", True)
    assert (
        kb.explain(kb.components["camera"]).sentence
        == "camera is unsolved because none of its configurations is selected"
    )
    kb.select({}, {"camera": "day"})
    assert (
        kb.explain("look").sentence
        == "look is solved because it is required, and all that it needs is in place"
    )
    kb.measure("light", 0.3)
    assert kb.explain(kb.components["camera"]).sentence == (
        "camera is in configuration error because configuration day is unfeasible because light 0.3 violates >= 0.5 "
        "(measured 0.0 s ago)"
    )
    assert kb.explain("look").sentence.startswith(
        "look is in implicit configuration error because function see is in implicit configuration error because "
        "function design by camera is in implicit configuration error because component camera is in configuration "
        "error because configuration day is unfeasible"
    )


def test_an_asserted_status_says_that_it_is_asserted(kb):
    kb.assert_status(kb.functions["see"], "unfeasible")
    assert kb.explain("look").sentence == (
        "look is unfeasible because function see is unfeasible because it is asserted so"
    )
    kb.assert_status(kb.components["camera"], "failure")
    assert (
        kb.explain(kb.components["camera"]).sentence
        == "camera is in failure because it is asserted so"
    )


def test_the_whole_text_is_the_sentence_and_what_would_help(kb):
    kb.component_failed("camera")
    for view in (kb.actions["look"], kb.components["camera"]):
        explanation = kb.explain(view)
        assert (
            str(explanation)
            == f"{explanation.sentence}; it would be feasible with camera recovered"
        )
    for view in (kb.actions["rest"], *kb.actions["explore"].constraints):
        assert str(kb.explain(view)) == kb.explain(view).sentence
        assert kb.explain(view).remedies == ()


def test_a_refusal_gives_the_explanation(kb):
    kb.measure("light", 0.24)
    reply = kb.request_action("explore")
    assert not reply
    assert reply.reason.startswith(kb.explain("explore").sentence)


def test_causes_form_the_chain_down_to_the_fact(kb):
    kb.measure("light", 0.05)
    chain = []
    explanation = kb.explain("look")
    while explanation.causes:
        chain.append((explanation.kind, explanation.name, explanation.status))
        explanation = explanation.causes[0]
    assert chain == [
        ("action", "look", "unfeasible"),
        ("function", "see", "unfeasible"),
        ("function design", "by camera", "unfeasible"),
        ("component", "camera", "unfeasible"),
        ("configuration", "day", "unfeasible"),
    ]
    assert (explanation.kind, explanation.status) == ("constraint", "violated")
    assert explanation.fact == "light 0.05 violates >= 0.5 (measured 0.0 s ago)"


def test_a_bare_name_means_the_action_first(kb):
    model = Model("recharge")
    model.component("recharge")
    model.function("recharge").design("recharge", ["recharge"])
    base = KnowledgeBase(model)
    assert base.explain("recharge").kind == "function"
    model.action("recharge")
    base = KnowledgeBase(model)
    assert base.explain("recharge").kind == "action"
    assert base.explain(base.components["recharge"]).kind == "component"
    assert base.explain(model.designs["recharge"]).kind == "function design"


def test_explaining_an_unknown_name_says_which_is_near(kb):
    with pytest.raises(UnknownName, match="did you mean 'explore'"):
        kb.explain("explor")


def test_an_action_tells_every_thing_that_makes_it_unfeasible(kb):
    kb.measure("light", 0.05)
    text = kb.explain("explore").sentence
    assert "light 0.05 violates >= 0.25" in text
    assert "function see is unfeasible" in text


def test_a_design_tells_every_thing_that_makes_it_unfeasible():
    model = Model("design")
    light = model.environmental_attribute("light")
    model.component("camera")
    model.function("see").design("by camera", ["camera"], constraints=[light >= 0.5])
    kb = KnowledgeBase(model)
    kb.measure("light", 0.1)
    kb.component_failed("camera")
    text = kb.explain(kb.designs["by camera"]).sentence
    assert "light 0.1 violates >= 0.5" in text
    assert "camera has failed" in text


def test_a_feasible_function_never_claims_what_is_not_so():
    model = Model("claims")
    model.component("good")
    model.component("bad")
    see = model.function("see")
    see.design("by good", ["good"])
    see.design("by bad", ["bad"])
    kb = KnowledgeBase(model)
    kb.component_failed("bad")
    assert kb.functions["see"].status is Status.FEASIBLE
    assert (
        "nothing that it needs is violated, failed or unfeasible" not in kb.explain("see").sentence
    )


FLOATS = st.floats(allow_nan=False, allow_infinity=False)


def near(number):
    """Numbers that are hardly another one."""
    return st.sampled_from((0.0, 1e-12, -1e-12, 1e-7, -1e-7, 4e-4, -4e-4)).map(
        lambda step: number + step * abs(number)
    )


def side(text, value, bound):
    """Tell on which sides of a bound a written number is, and the number itself."""
    words = text.split(" ")
    if words[:-1] == ["just", "below"]:
        return (True, False) if float(words[-1]) <= bound else (value < bound, value > bound)
    if words[:-1] == ["just", "above"]:
        return (False, True) if float(words[-1]) >= bound else (value < bound, value > bound)
    return float(text) < bound, float(text) > bound


@given(FLOATS, st.lists(FLOATS, max_size=3))
def test_a_number_is_written_on_its_side_of_every_threshold(value, thresholds):
    shown = shortest(value, thresholds)
    for bound in thresholds:
        assert side(shown, value, bound) == (value < bound, value > bound)


@given(
    FLOATS.flatmap(
        lambda value: st.tuples(st.just(value), st.lists(near(value), min_size=1, max_size=3))
    )
)
def test_a_number_is_written_on_its_side_of_every_threshold_near_it(case):
    value, thresholds = case
    shown = shortest(value, thresholds)
    for bound in thresholds:
        assert side(shown, value, bound) == (value < bound, value > bound)


@pytest.mark.parametrize("bound", [0.25, 0.3, 3.25, 1e6])
@pytest.mark.parametrize("noise", [-1e-15, 1e-15, -1e-11, 1e-11])
def test_noise_of_a_number_is_told_in_words(bound, noise):
    value = bound * (1.0 + noise)
    assert value != bound
    assert shortest(value, [bound]) == f"just {'below' if value < bound else 'above'} {bound:g}"
    assert shortest(value, [2.0 * bound]) == f"{bound:g}"


def spelled_out(value, operator, bound):
    model = Model("one")
    light = model.environmental_attribute("light")
    model.action("go", constraints=[compare(light, operator, bound)])
    kb = KnowledgeBase(model)
    kb.measure("light", value)
    (constraint,) = kb.actions["go"].constraints
    found = SPELLED_OUT.search(kb.explain(constraint).sentence)
    assert found, kb.explain(constraint).sentence
    return found, constraint.status


@pytest.mark.parametrize("operator", [">=", ">", "<=", "<"])
@given(st.integers(-20, 20), st.integers(-20, 20))
def test_the_numbers_of_a_sentence_never_contradict_it_for_short_thresholds(operator, value, bound):
    found, status = spelled_out(value / 7, operator, bound / 4)
    truth = holds(float(found["shown"]), operator, float(found["bound"]))
    assert (
        found["word"]
        == ("satisfies" if truth else "violates")
        == str(status).replace("ied", "ies").replace("ed", "es")
    )


def ends(explanation):
    if not explanation.causes:
        yield explanation
    for cause in explanation.causes:
        yield from ends(cause)


def test_a_reason_stays_short_enough_to_read_when_many_things_share_a_fault():
    model = Model("shared")
    model.component("driver")
    for number in range(10):
        function = model.function(f"function {number}")
        for one in range(10):
            function.design(f"design {number}.{one}", ["driver"])
    model.action("all", requires=list(model.functions))
    kb = KnowledgeBase(model)
    kb.component_failed("driver")
    reason = kb.request_action("all").reason
    assert "driver has failed" in reason
    assert len(reason) < 1500
