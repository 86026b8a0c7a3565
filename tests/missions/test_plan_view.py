"""The causal order of a plan: what it leaves open may be done the other way round, and the picture shows it all."""

from itertools import permutations
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_worlds import GOALS, house

from missions.views.plan import CausalOrder, Link, causal_order, svg_of
from rosa_pddl import Step
from rosa_pddl.validate import flaw


def order_of(goal):
    domain, steps, state = house(goal)
    return causal_order(domain, steps, state, domain.goal)


def respects(order, places):
    """Whether a permutation keeps every pair of steps that the order speaks of."""
    pairs = [(link.source, link.target) for link in order.links] + list(order.orders)
    return all(places[one] < places[other] for one, other in pairs if other < len(places))


@pytest.mark.parametrize("goal", GOALS)
def test_every_way_to_do_the_steps_that_keeps_the_order_reaches_the_goal(goal):
    domain, steps, state = house(goal)
    order = order_of(goal)
    kept = 0
    for numbers in permutations(range(len(steps))):
        if respects(order, {number: place for place, number in enumerate(numbers)}):
            kept += 1
            assert flaw(domain, [steps[number] for number in numbers], state) is None
    assert kept >= 1


@pytest.mark.parametrize("goal", GOALS)
def test_every_link_is_needed_and_orders_are_only_told_where_no_link_says_so(goal):
    order = order_of(goal)
    assert order.links
    for link in order.links:
        assert link.source < link.target <= len(order.steps)
        assert link.needs
    linked = {(link.source, link.target) for link in order.links}
    assert not linked & set(order.orders)


def test_steps_that_have_nothing_to_do_with_one_another_may_come_in_any_order():
    order = order_of("(forall (?x - room) (scanned ?x))")
    (alone,) = (number for number, step in enumerate(order.steps) if "rita" in step.arguments)
    assert [link for link in order.links if alone in (link.source, link.target)] == [
        Link(alone, len(order.steps), ("(scanned attic)",))
    ]
    assert not any(alone in pair for pair in order.orders)


def test_step_that_would_spoil_what_another_one_needs_comes_after_it():
    domain, _, state = house("(not (broken kitchen)) (at robby attic)")
    steps = [
        domain.step("scan", ["look", "robby", "hall"]),
        domain.step("move", ["go", "robby", "hall", "kitchen"]),
    ]
    order = causal_order(domain, steps, state, [])
    assert order.links == ()
    assert order.orders == ((0, 1),)
    assert causal_order(domain, steps[:1], state, []) == CausalOrder((steps[0],), (), ())


def test_need_of_what_is_false_is_told_so():
    order = order_of("(scanned kitchen)")
    needs = {need for link in order.links for need in link.needs}
    assert "(not (broken kitchen))" in needs
    assert "(scanned kitchen)" in needs


@st.composite
def orders(draw):
    count = draw(st.integers(0, 7))
    pairs = [(index, other) for other in range(count + 1) for index in range(other)]
    chosen = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    links = [
        Link(one, other, (f"(fact{one} {'x' * draw(st.integers(1, 60))} <&>)",))
        for one, other in chosen[::2]
    ]
    steps = tuple(Step(f"step{number}", ("a", "b & c")) for number in range(count))
    return CausalOrder(steps, tuple(links), tuple(pair for pair in chosen[1::2] if pair[1] < count))


def boxes(root):
    found = [element for element in root if element.tag.endswith("rect")][1:]
    return [
        tuple(float(element.get(key)) for key in ("x", "y", "width", "height")) for element in found
    ]


@given(orders())
def test_picture_of_any_order_shows_every_step_and_arrow_inside_and_no_box_over_another(order):
    root = ElementTree.fromstring(svg_of(order, "a plan <&>"))
    width = float(root.get("width"))
    height = float(root.get("height"))
    drawn = boxes(root)
    assert len(drawn) == len(order.steps) + 1
    for number, (x, y, w, h) in enumerate(drawn):
        assert 0 < x < x + w < width
        assert 0 < y < y + h < height
        for x2, y2, w2, h2 in drawn[:number]:
            assert x + w <= x2 or x2 + w2 <= x or y + h <= y2 or y2 + h2 <= y
    arrows = [element for element in root if element.tag.endswith("path")]
    assert len(arrows) == len(order.links) + len(order.orders)
    assert sum("stroke-dasharray" in arrow.attrib for arrow in arrows) == len(order.orders)


@given(orders())
def test_picture_is_the_same_each_time_and_later_steps_are_never_above_what_they_wait_for(order):
    assert svg_of(order, "plan") == svg_of(order, "plan")
    drawn = boxes(ElementTree.fromstring(svg_of(order, "plan")))
    for one, other in [(link.source, link.target) for link in order.links] + list(order.orders):
        assert drawn[one][1] + drawn[one][3] < drawn[other][1]
