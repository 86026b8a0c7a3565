"""Threads that tell and ask at once, for long: no fact is lost, no answer is torn, nobody waits for ever."""

import os
import threading
import time

import pytest
from figures import table

from kb import KnowledgeBase, Model

pytestmark = pytest.mark.benchmark(group="threads")

TELLERS, ASKERS = 8, 2
IN_MEMORY = int(os.environ.get("EVENTS", "1000000"))
STORED = 10_000
PATIENCE = 1800.0


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    head = ("8 threads tell, 2 ask", "facts", "seconds", "facts a second", "questions")
    tables["threads"] = lambda: table("Threads", head, found)
    return found


def pairs():
    """Return a model in which each thread has two eyes to look with."""
    model = Model("pairs")
    for number in range(TELLERS):
        see = model.function(f"see {number}")
        for eye in ("left", "right"):
            light = model.environmental_attribute(f"{eye} light {number}")
            see.design(
                f"by {eye} {number}",
                [model.component(f"{eye} eye {number}", constraints=[light >= 0.5])],
            )
        model.action(f"look {number}", requires=[see])
    return model


def tell(kb, number, turns):
    """Light one eye before the other is blinded, so that looking is possible at every moment."""
    for turn in range(turns // 2):
        good, bad = ("left", "right") if turn % 2 else ("right", "left")
        kb.measure(f"{good} light {number}", 1.0 + turn)
        kb.measure(f"{bad} light {number}", -1.0 - turn)


def ask(kb, done, asked):
    everything = tuple(f"look {number}" for number in range(TELLERS))
    while not done.is_set():
        assert kb.selectable_actions() == everything
        for number, action in enumerate(everything):
            assert kb.is_feasible(action)
            view = kb.designs[f"by left {number}"]
            assert str(view.status) in ("feasible", "unfeasible")
        asked.append(1)


def run(kb, events):
    """Tell and ask; returns the time it took [s], and how many rounds of questions were answered."""
    done, asked, troubles = threading.Event(), [], []

    def guarded(job, *arguments):
        try:
            job(*arguments)
        except BaseException as error:
            troubles.append(error)

    each = events // TELLERS
    tellers = [
        threading.Thread(target=guarded, args=(tell, kb, number, each), daemon=True)
        for number in range(TELLERS)
    ]
    askers = [
        threading.Thread(target=guarded, args=(ask, kb, done, asked), daemon=True)
        for _ in range(ASKERS)
    ]
    start = time.perf_counter()
    for thread in (*tellers, *askers):
        thread.start()
    for thread in tellers:
        thread.join(PATIENCE)
    took = time.perf_counter() - start
    done.set()
    for thread in askers:
        thread.join(PATIENCE)
    assert not any(thread.is_alive() for thread in (*tellers, *askers)), "somebody waits for ever"
    if troubles:
        raise troubles[0]
    assert asked
    return took, len(asked) * (1 + 2 * TELLERS)


def check_all_told(kb, events):
    turns = events // TELLERS // 2
    for number in range(TELLERS):
        left, right = (kb.attributes[f"{eye} light {number}"].history for eye in ("left", "right"))
        assert (
            [abs(value) for _, value in left]
            == [abs(value) for _, value in right]
            == [1.0 + t for t in range(turns)]
        )
        assert all(
            (one > 0) != (other > 0) for (_, one), (_, other) in zip(left, right, strict=True)
        )


def test_a_million_facts_in_memory(rows):
    kb = KnowledgeBase(pairs())
    took, questions = run(kb, IN_MEMORY)
    check_all_told(kb, IN_MEMORY)
    rows.append(
        ("in memory", f"{IN_MEMORY:,}", f"{took:.1f}", f"{IN_MEMORY / took:,.0f}", f"{questions:,}")
    )


def test_ten_thousand_facts_with_the_store(rows, tmp_path):
    kb = KnowledgeBase(pairs(), store=tmp_path / "m.sqlite3")
    took, questions = run(kb, STORED)
    assert kb.flush(60.0)
    assert kb.saved == kb.log.last >= STORED
    kb.close()
    again = KnowledgeBase(pairs(), store=tmp_path / "m.sqlite3")
    check_all_told(again, STORED)
    count = "SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }"
    assert again.query(count) == [(STORED,)]
    again.close()
    rows.append(
        ("with the store", f"{STORED:,}", f"{took:.1f}", f"{STORED / took:,.0f}", f"{questions:,}")
    )
