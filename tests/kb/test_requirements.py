"""What elements need: the conjunctions are exactly the measurements under which an element is possible."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import OPERATORS, models

from kb import Model, Status
from kb.elements import Constraint
from kb.network import Network
from kb.remedies import Interval, Requirements
from kb.state import State

GRID = (-0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""The thresholds of random models, and numbers between and beyond them."""
IMPOSSIBLE = (Status.UNFEASIBLE, Status.FAILURE, Status.VIOLATED)


def alternatives(node, **options):
    return Requirements(**options).of(node)


def measured(network, values):
    state = State(network)
    state.touch(network.present())
    for name, value in values.items():
        state.value[network.attributes[name]] = value
    state.infer()
    return state


def inside(conjunction, values):
    return not conjunction.repairs and all(
        values[name] in interval for name, interval in conjunction.intervals.items()
    )


@given(models())
def test_an_element_is_possible_exactly_within_its_boxes(model):
    network = Network(model)
    requirements = Requirements()
    for numbers in product(GRID, repeat=len(model.attributes)):
        values = dict(zip(model.attributes, numbers, strict=True))
        state = measured(network, values)
        for node in network.present():
            if node.kind == "attribute":
                continue
            found = requirements.of(node)
            assert found.complete
            possible = any(inside(conjunction, values) for conjunction in found.conjunctions)
            assert possible is (state.status[node] not in IMPOSSIBLE)


@given(models())
def test_no_box_lies_within_another(model):
    for node in Network(model).nodes:
        if node.kind != "attribute":
            conjunctions = alternatives(node).conjunctions
            for one in conjunctions:
                assert [other for other in conjunctions if other.covers(one)] == [one]


@given(models(), st.integers(1, 3))
def test_a_limit_leaves_boxes_that_are_right_and_says_that_there_are_more(model, limit):
    network = Network(model)
    for node in network.present():
        if node.kind == "attribute":
            continue
        every, some = alternatives(node), alternatives(node, limit=limit)
        assert len(some.conjunctions) <= limit
        assert all(
            any(one.covers(conjunction) for one in every.conjunctions)
            for conjunction in some.conjunctions
        )
        if some.complete:
            assert set(map(str, some.conjunctions)) == set(map(str, every.conjunctions))


BOUNDS = (st.tuples(st.sampled_from(GRID), st.sampled_from(beside)) for beside in ((0, 1), (0, -1)))
INTERVALS = st.builds(Interval, *BOUNDS)


@given(INTERVALS, INTERVALS)
def test_intervals_meet_and_cover_as_their_numbers_do(one, other):
    fine = [step / 8 for step in range(-3, 12)]
    mine, theirs = ({number for number in fine if number in interval} for interval in (one, other))
    assert {number for number in fine if number in one.meet(other)} == mine & theirs
    assert one.is_empty is (not mine)
    if one.covers(other):
        assert theirs <= mine


@pytest.mark.parametrize(("operator", "bound"), list(product(OPERATORS, (0.5, -1.0))))
def test_an_interval_is_written_as_the_constraint_it_stands_for(operator, bound):
    constraint = Constraint("light", operator, bound, ())
    assert Interval.of(constraint).text("light") == str(constraint)


def test_a_gap_that_holds_no_number_is_empty():
    assert Interval((0.5, 1), (0.5, 0)).is_empty
    assert Interval((0.0, 1), (5e-324, -1)).is_empty
    assert Interval((1.7976931348623157e308, 1)).is_empty
    assert not Interval((0.5, 0), (0.5, 0)).is_empty
    assert not Interval().is_empty


def test_what_contradicts_itself_across_a_chain_has_no_way():
    model = Model("chain")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", constraints=[light >= 0.5])
    model.function("see").design("by camera", [camera])
    look = model.action("look", requires=["see"], constraints=[light < 0.5])
    network = Network(model)
    assert alternatives(network.find(look)) == ((), True)
    assert alternatives(network.functions["see"]).conjunctions[0].intervals == {
        "light": Interval(low=(0.5, 0))
    }


def many_ways(functions, share):
    """An action of many functions, each with two designs of two components; some components serve all of them."""
    model = Model("many")
    attributes = [model.environmental_attribute(f"a{number}") for number in range(functions)]
    shared = model.component("shared", constraints=[attributes[0] >= 0.1])
    for number, attribute in enumerate(attributes):
        function = model.function(f"f{number}")
        for sense in range(2):
            own = model.component(f"c{number}.{sense}")
            own.constrain(attribute >= 0.5 if sense else attribute <= 0.4)
            function.design(f"d{number}.{sense}", [own, shared] if share else [own])
    model.action("all", requires=list(model.functions))
    return Network(model).actions["all"]


@pytest.mark.parametrize("share", [True, False])
def test_more_ways_than_can_be_looked_at_are_cut_off_and_said_to_be(share):
    found = alternatives(many_ways(40, share))
    assert not found.complete
    assert 0 < len(found.conjunctions) <= 64
    few = alternatives(many_ways(3, share))
    assert (len(few.conjunctions), few.complete) == (8, True)
