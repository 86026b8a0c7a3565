"""Maps of the ground vehicle: what can be read, what is refused with which words, and what is generated."""

import math

import pytest
from agv_worlds import building_from, generated_building
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng

from missions.agv import PAPER
from missions.engine.mission import MissionError


def told(**changes):
    """Return a map of two places."""
    return {
        "name": "small",
        "start": "a",
        "goal": "b",
        "places": {"a": [0, 0], "b": [3, 4]},
        "corridors": {"c1": {"from": "a", "to": "b"}},
        **changes,
    }


def corridor(**changes):
    return told(corridors={"c1": {"from": "a", "to": "b", **changes}})


@given(st.integers(2, 200), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_generated_building_is_a_map_and_the_same_for_the_same_seed(places, more, seed):
    try:
        building = generated_building(default_rng(seed), places, places - 1 + more)
    except MissionError as error:
        assert "corridors" in str(error)  # noqa: PT017  # both ends are judged
        return
    assert len(building.places) == places
    assert len(building.corridors) == places - 1 + more
    assert building == generated_building(default_rng(seed), places, places - 1 + more)
    for one in building.corridors.values():
        assert one.length_m == pytest.approx(math.dist(*(building.places[end] for end in one.ends)))


def test_generated_building_is_as_large_as_the_published_one():
    building = generated_building(default_rng(0))
    assert (len(building.places), len(building.corridors)) == (58, 70)
    assert {one.obstacles > 0.1 for one in building.corridors.values()} == {True, False}
    assert {one.light < 0.3 for one in building.corridors.values()} == {True, False}


def test_paper_map_has_a_straight_way_and_a_way_round():
    building = PAPER
    assert building.corridors["c1"].ends == ("a", "b")
    assert {name for name, one in building.corridors.items() if one.obstacles > 0} == {"c1"}


def test_corridor_is_as_long_as_its_places_are_apart():
    assert building_from(told()).corridors["c1"].length_m == 5.0


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            corridor(length_m=-2.0),
            "length_m of corridor c1 is -2.0; it must be a number from 0.001 to 1e",
        ),
        (corridor(obstacles=-1), "obstacles of corridor c1 is -1; it must be a number from 0"),
        (corridor(light=1.5), "from 0 to 1"),
        (corridor(length_m="long"), "length_m of corridor c1 is 'long'; it must be a number"),
        (corridor(length_m=math.nan), "it must be a number"),
        (
            told(places={"a": [0, 0], "b": [0, 0]}),
            "length_m of corridor c1 is 0.0; it must be a number",
        ),
        (
            told(places={"a": [0, 0], "b": [0, math.inf]}),
            "y of place b is inf; it must be a number",
        ),
        (corridor(to="d"), "names the place 'd', which map small lacks"),
        (corridor(to="a"), "leads from a to itself"),
        (
            told(places={"a": [0, 0], "b": [3, 4], "z": [9, 9]}),
            "disconnected: no way from a to z; add a corridor",
        ),
        (told(places={"A b": [0, 0]}), "'A b' in map small is not a name"),
        (told(goal="c"), "goal names the place 'c'"),
    ],
)
def test_bad_map_is_refused_in_words_that_say_what_to_do(data, words):
    with pytest.raises(MissionError, match=words):
        building_from(data)


def test_too_many_or_too_few_corridors_are_refused():
    for corridors in (4, 13):
        with pytest.raises(MissionError, match="9 places take 8 to 12 corridors"):
            generated_building(default_rng(0), 9, corridors)
