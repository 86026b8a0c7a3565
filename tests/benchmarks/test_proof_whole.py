"""All mutants, all correct variants, 300 random missions explored in two ways, and how fast a mission is explored."""

import sys
from pathlib import Path
from time import process_time

import pytest

sys.path.append(str(Path(__file__).parents[1] / "missions"))
from proof_mutants import CORRECT, FULL, MUTANTS
from proof_replay import replayed
from proof_twin import agree

from missions.engine.mission import find_mission
from missions.proof import verify
from missions.proof.exploration import Exploration
from missions.proof.verification import setup_of

pytestmark = pytest.mark.benchmark(group="proof")


@pytest.mark.parametrize("case", MUTANTS, ids=lambda case: case.name)
def test_seeded_bug_is_found(case):
    assert len(MUTANTS) >= 40
    proof = verify(case.build, case.model, wanted=case.wanted, **{**FULL, **case.given})
    found = [one for one in proof.broken if case.broken in one.name]
    assert found, proof
    for one in proof.broken:
        story = proof.story(one)
        assert story is None or replayed(proof.setup, story, one.trail) == story.trace


@pytest.mark.parametrize("case", CORRECT, ids=lambda case: case.name)
def test_correct_variant_is_silent(case):
    assert len(CORRECT) >= 20
    proof = verify(case.build, case.model, wanted=case.wanted, **{**FULL, **case.given})
    assert proof.found.is_finished
    assert not proof.broken, proof


@pytest.mark.parametrize("seed", range(300))
def test_twin_agrees(seed):
    assert agree(seed) > 20


@pytest.mark.parametrize(
    ("name", "slow"), [("suave_extended", False), ("suave_extended", True), ("uav", False)]
)
def test_mission_is_explored_at_a_rate(name, slow):
    found = Exploration(setup_of(find_mission(name), slow=slow))
    begun = process_time()
    found.explore(seconds=300.0)
    took = process_time() - begun
    print(
        f"{name}: {len(found.situations)} situations, {found.transitions} transitions in {took:.1f} s of a processor"
    )
    assert found.is_finished
