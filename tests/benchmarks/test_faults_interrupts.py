"""Random interrupts at any instruction of any call of a knowledge base, for long; `INTERRUPTS` says how many."""

import os
import sys
from collections import Counter
from itertools import count
from pathlib import Path

import pytest
from figures import table

sys.path.append(
    str(Path(__file__).parents[1] / "kb")
)  # the lives and their twins are those of the tests there

from interrupted_lives import Interrupted, spent

pytestmark = pytest.mark.benchmark(group="faults")

INTERRUPTS = int(os.environ.get("INTERRUPTS", "100000"))
HEAD = ("calls are interrupted", "lives", "calls", "interrupts", "in", "out", "lies", "leaks")


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    tables["faults of calls"] = lambda: table("Faults of calls", HEAD, found)
    return found


@pytest.mark.parametrize(
    ("where", "harsher", "most"), [("as by a signal", False, 10), ("anywhere", True, 1)]
)
def test_interrupted_lives_are_those_of_their_twins_for_long(rows, where, harsher, most):
    totals, first = Counter(), None
    for seed in count(1000):
        life = Interrupted(seed, harsher=harsher)
        totals += spent(life, 100) + Counter(lives=1)
        first = first or next(iter(life.lies), None)
        if totals["interrupts"] >= INTERRUPTS * most // 10:
            break
    rows.append((where, *(totals[one] for one in HEAD[1:])))
    # where Python looks for no signal nothing comes in truth; what is found there is printed, for whoever wants more
    assert harsher or totals["lies"] == totals["leaks"] == 0, first
