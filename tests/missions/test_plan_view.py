"""The picture of a plan: which step makes true what another one needs."""

from itertools import permutations
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_worlds import GOALS, house

from missions.views.plan import Link, causal_links, svg_of
from rosa_pddl import Step
from rosa_pddl.validate import flaw


def links_of(goal):
    domain, steps, state = house(goal)
    return steps, causal_links(domain, steps, state, domain.goal)


@pytest.mark.parametrize("goal", GOALS)
def test_order_that_breaks_no_link_is_among_those_that_reach_the_goal(goal):
    domain, steps, state = house(goal)
    _, links = links_of(goal)
    assert links
    for link in links:
        assert link.source < link.target <= len(steps)
        assert link.needs
    for numbers in permutations(range(len(steps))):
        if flaw(domain, [steps[number] for number in numbers], state) is None:
            places = {number: place for place, number in enumerate(numbers)} | {len(steps): 99}
            assert all(places[link.source] < places[link.target] for link in links), numbers


def test_step_for_the_goal_alone_has_one_link():
    steps, links = links_of("(forall (?x - room) (scanned ?x))")
    (alone,) = (number for number, step in enumerate(steps) if "rita" in step.arguments)
    assert [link for link in links if alone in (link.source, link.target)] == [
        Link(alone, len(steps), ("(scanned attic)",))
    ]


def test_need_of_a_false_fact_is_negated():
    _, links = links_of("(scanned kitchen)")
    needs = {need for link in links for need in link.needs}
    assert "(not (broken kitchen))" in needs
    assert "(scanned kitchen)" in needs


@st.composite
def plans(draw):
    count = draw(st.integers(0, 7))
    pairs = [(source, target) for target in range(count + 1) for source in range(target)]
    chosen = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    links = [
        Link(source, target, (f"(fact{source} {'x' * draw(st.integers(1, 60))} <&>)",))
        for source, target in chosen
    ]
    return [Step(f"step{number}", ("a", "b & c")) for number in range(count)], links


@given(plans())
def test_picture_shows_each_step_inside_apart_and_below_its_needs(plan):
    steps, links = plan
    root = ElementTree.fromstring(svg_of(steps, links, "a plan <&>"))
    rectangles = [element for element in root if element.tag.endswith("rect")][1:]
    boxes = [
        tuple(float(element.get(key)) for key in ("x", "y", "width", "height"))
        for element in rectangles
    ]
    assert len(boxes) == len(steps) + 1
    for number, (x, y, width, height) in enumerate(boxes):
        assert 0 < x < x + width < float(root.get("width"))
        assert 0 < y < y + height < float(root.get("height"))
        for x2, y2, width2, height2 in boxes[:number]:
            assert x + width <= x2 or x2 + width2 <= x or y + height <= y2 or y2 + height2 <= y
    for link in links:
        assert boxes[link.source][1] + boxes[link.source][3] < boxes[link.target][1]
    assert len([element for element in root if element.tag.endswith("path")]) == len(links)
