"""1,000 random cases: deciding by worth violates nothing that reacting keeps, though all that is told is wrong."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "rosa_bt"))
from wrong_worlds import wrong_case

pytestmark = pytest.mark.benchmark


def test_wrong_forecasts_cost_worth_and_never_safety(tables):
    found = {case: wrong_case(case) for case in range(1000)}
    waited = [put_off for _, put_off in found.values() if put_off]
    tables["wrong"] = lambda: (
        f"{len(waited)} of 1000 cases put work off, {sum(waited)} times in 20,000 steps"
    )
    assert {case: only for case, (only, _) in found.items() if only} == {}
    assert len(waited) > 100
