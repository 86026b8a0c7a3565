"""What is sensed and what is believed: as if everything was looked at anew each time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pddl_world import FakeKb, load_text

from rosa_pddl.belief import Belief

DOMAIN = """(define (domain signals) (:requirements :typing :action-costs)
  (:types action signal)
  (:predicates (action_feasible ?a - action) (wave_action ?a - action) (on ?s - signal) (seen ?s - signal))
  (:functions (total-cost) - number (far ?s - signal) - number)
  (:action wave :parameters (?a - action ?s - signal)
    :precondition (and (wave_action ?a) (action_feasible ?a) (on ?s))
    :effect (and (seen ?s) (not (on ?s)) (increase (total-cost) (far ?s)))))
"""
PROBLEM = """(define (problem p) (:domain signals) (:objects wave - action red green - signal)
  (:init (wave_action wave) (on red) (= (total-cost) 0) (= (far red) 1) (= (far green) 1))
  (:goal (seen red)) (:metric minimize (total-cost)))
"""
FACTS = ("(on red)", "(ON green)", "(seen red)", "(seen green)", "(action_feasible wave)")
ANSWERS = st.dictionaries(st.sampled_from(FACTS), st.booleans()).flatmap(
    lambda facts: st.dictionaries(
        st.sampled_from(["(far red)", "(far green)"]), st.floats(0, 9)
    ).map(lambda numbers: facts | numbers)
)


@pytest.fixture(scope="module")
def signals(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("signals"), DOMAIN, PROBLEM)


@given(
    moments=st.lists(st.one_of(ANSWERS, st.sampled_from(["wave", "same"])), max_size=12),
    feasible=st.booleans(),
)
def test_what_is_believed_is_what_was_sensed_last_or_what_a_step_left(signals, moments, feasible):
    kb = FakeKb(signals.rosa_actions)
    kb.unfeasible = set() if feasible else {"wave"}
    answer: dict[str, bool | float] = {}
    belief = Belief(signals, kb, lambda: answer)
    facts = {"(wave_action wave)", "(on red)"}
    numbers = {}
    step = signals.step("wave", ("wave", "red"))
    for moment in moments:
        if moment == "wave":
            belief.end("key", step, belief.observe())
            facts = facts - {"(on red)"} | {"(seen red)"}
        elif moment != "same":
            answer = moment
        for text, value in answer.items():
            if isinstance(value, float):
                numbers[text] = value
            elif "feasible" not in text:
                (facts.add if value else facts.discard)(text.lower())
        state = belief.observe()
        assert state == facts | ({"(action_feasible wave)"} if feasible else set())
        assert belief.numbers == numbers
        assert {type(state), type(belief.observe())} == {frozenset}
