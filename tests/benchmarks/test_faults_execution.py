"""Slow, lying, failing and interrupted managed systems, for long; `PLANS` says how many reconfigurations."""

import os
import sys
from collections import Counter
from itertools import count
from pathlib import Path

import pytest
from figures import table

sys.path.append(
    str(Path(__file__).parents[1] / "kb")
)  # the faulty system and its twin are those of the tests there

from faulty import Interrupted, Life, interrupted_at, lived

pytestmark = pytest.mark.benchmark(group="faults")

PLANS = int(os.environ.get("PLANS", "100000"))


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    head = ("what", "reconfigurations", "commands", "failed", "abandoned", "interrupts", "lies")
    tables["faults of execution"] = lambda: table("Faults of execution", head, found)
    return found


def live(first, most, **options):
    """Live life after life until there were enough reconfigurations; what must be true is looked at at each turn."""
    totals, lives = Counter(), count(first)
    while totals["plans"] < most:
        life = lived(next(lives), 400, **options)
        results = Counter(one.result for one in life.kb.history.attempts)
        totals += Counter(
            plans=len(life.kb.plans), interrupts=life.interrupted, lies=len(life.lies), **results
        )
    return totals


@pytest.mark.parametrize("interrupts", [0.0, 0.03])
@pytest.mark.parametrize("faults", [0.05, 0.3])
def test_faults_are_survived_for_long(rows, faults, interrupts):
    totals = live(int(faults * 1e6), PLANS // 4, faults=faults, interrupts=interrupts)
    names = ("plans", "completed", "failed", "abandoned", "interrupts", "lies")
    rows.append(
        (f"{faults:.0%} faults, {interrupts:.0%} interrupts", *(totals[name] for name in names))
    )
    assert totals["plans"] >= PLANS // 4
    assert totals["lies"] == 0


def test_every_instruction_of_a_turn_is_interrupted(rows):
    passed = []
    life = Life(0, faults=0.0)
    life.kb.request_action("take")
    interrupted_at(0, life.manager.update, passed)
    for step in range(1, passed[0] + 1):
        life = Life(0, faults=0.0)
        life.kb.request_action("take")
        with pytest.raises(Interrupted):
            interrupted_at(step, life.manager.update)
        life.update()
        life.look()
        assert [plan.result for plan in life.kb.plans] == ["completed"], step
        assert (
            life.system.running
            == {"eye", "arm"}
            == {one.name for one in life.kb.components.values() if one.is_active}
        )
        assert all(one.end is not None for one in life.kb.history.attempts)
    rows.append(("each instruction of a turn interrupted", passed[0], 0, 0, 0, passed[0], 0))
