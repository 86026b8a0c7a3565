"""What keeping costs: of a call, until it is acknowledged, and in the size of the file."""

import threading
import time
from collections import deque

import pytest
from figures import percentiles, shown, table

from kb import KnowledgeBase
from missions.suave_extended.model import suave_extended_model

pytestmark = pytest.mark.benchmark(group="store")

EVENTS, RATE = 5000, 1000.0
DAY = 24 * 3600 * 10


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    tables["store"] = lambda: table("The store", ("extended SUAVE", "p50", "p90", "p99"), found)
    return found


def at_a_steady_rate(kb):
    """Tell at a rate; returns the time of each call, and when each fact had been told by."""
    calls, told = [], deque()
    start = time.perf_counter()
    for number in range(EVENTS):
        while (now := time.perf_counter()) < start + number / RATE:
            time.sleep(max(0.0, start + number / RATE - now))
        begin = time.perf_counter()
        kb.measure("water_visibility", 3.5 + number % 2 / 10)
        end = time.perf_counter()
        calls.append(end - begin)
        told.append((kb.log.last, end))
    return calls, told


def acknowledgements(kb, done):
    """Note when each number was seen to be on disk."""
    seen, last = [], -1
    while not done.is_set() or kb.saved < kb.log.last:
        if kb.saved > last:
            last = kb.saved
            seen.append((last, time.perf_counter()))
        time.sleep(0.0005)
    return [*seen, (kb.saved, time.perf_counter())]


def test_cost_of_a_call_and_time_until_it_is_acknowledged(tmp_path, rows):
    plain, _ = at_a_steady_rate(KnowledgeBase(suave_extended_model()))
    kb, done, seen = (
        KnowledgeBase(suave_extended_model(), store=tmp_path / "m.sqlite3"),
        threading.Event(),
        [],
    )
    watcher = threading.Thread(target=lambda: seen.extend(acknowledgements(kb, done)))
    watcher.start()
    calls, told = at_a_steady_rate(kb)
    done.set()
    watcher.join()
    waits, acknowledged = [], iter(seen)
    saved, when = next(acknowledged)
    for number, moment in told:
        while saved < number:
            saved, when = next(acknowledged)
        waits.append(when - moment)
    kb.close()
    rows.append(("a measurement, in memory, 1,000 a second", *map(shown, percentiles(plain))))
    rows.append(("the same with the store", *map(shown, percentiles(calls))))
    rows.append(("until it is acknowledged", *map(shown, percentiles(waits))))


def test_a_day_of_measurements_stays_below_the_limit(tmp_path, rows):
    path, now = tmp_path / "m.sqlite3", 0.0
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: now, store=path)
    sizes, start = [], time.perf_counter()
    for number in range(DAY):
        now += 0.1
        kb.measure("battery_level", 1.0 - number / DAY)
        if number % 20_000 == 19_999:
            assert kb.flush(60.0)
            sizes.append(path.stat().st_size)
    took = time.perf_counter() - start
    kb.close()
    megabytes = path.stat().st_size / 1e6
    assert path.stat().st_size <= 1.3 * sizes[2]
    begin = time.perf_counter()
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: now, store=path)
    opened = time.perf_counter() - begin
    assert len(kb.attributes["battery_level"].history) >= 10_000
    begin = time.perf_counter()
    assert kb.query("SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }")[0][0] >= 10_000
    asked = time.perf_counter() - begin
    kb.close()
    rows.append(
        (f"24 h at 10 a second, told in {took:.0f} s: {megabytes:.1f} MB", None, None, None)
    )
    rows.append(("opened again with 10,000 measurements", shown(opened), None, None))
    rows.append(("a query over them", shown(asked), None, None))


def test_ten_thousand_facts_of_eight_threads(tmp_path, rows):
    kb, each = KnowledgeBase(suave_extended_model(), store=tmp_path / "m.sqlite3"), 1250
    tellers = [
        threading.Thread(
            target=lambda: [kb.measure("water_visibility", turn % 5) for turn in range(each)]
        )
        for _ in range(8)
    ]
    start = time.perf_counter()
    for teller in tellers:
        teller.start()
    for teller in tellers:
        teller.join()
    assert kb.flush(60.0)
    took = time.perf_counter() - start
    assert kb.saved == kb.log.last
    kb.close()
    rows.append((f"10,000 facts of 8 threads, all on disk after {took:.2f} s", None, None, None))
