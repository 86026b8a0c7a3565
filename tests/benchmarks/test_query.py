"""How long a query takes after an event, and again while nothing happens.

Run it on two versions to compare.
"""

import pytest

from kb import KnowledgeBase
from missions.suave_extended.model import suave_extended_model

pytestmark = pytest.mark.benchmark
STATUSES = "SELECT ?name ?status { ?x a :Action ; :name ?name ; :status ?status }"


@pytest.fixture
def kb():
    """A base of 32 elements that has heard a hundred measurements."""
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: 0.0)
    for number in range(100):
        kb.measure("battery_level", 0.5 + number / 1000)
    kb.query(STATUSES)
    return kb


def test_query_after_an_event(benchmark, kb):
    levels = (level for _ in range(1_000_000) for level in (0.1, 0.9))

    def ask():
        kb.measure("battery_level", next(levels))
        return kb.query(STATUSES)

    assert len(benchmark(ask)) == 3


def test_query_while_nothing_happens(benchmark, kb):
    assert len(benchmark(lambda: kb.query(STATUSES))) == 3
