"""A week of measurements at 10 Hz, with requests and plans in between: what it takes of memory, and of time.

`MEASUREMENTS` says how many, by default all of them; memory is that of the whole process.
"""

import os
import time
from pathlib import Path

import pytest
from figures import shown, table

from kb import ConfigurationManager, KnowledgeBase
from missions.suave_extended.model import suave_extended_model

pytestmark = pytest.mark.benchmark(group="week")

MEASUREMENTS = int(os.environ.get("MEASUREMENTS", str(7 * 24 * 3600 * 10)))
EVERY = 500
"""Measurements between two requests."""
MOST = 200e6


class Managed:
    """A robot that does what it is asked."""

    def activate(self, component): ...

    def deactivate(self, component): ...

    def set_parameters(self, component, parameters): ...


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def quickest(call, times=500):
    """Return the shortest of the means of ten calls [s]."""
    found = []
    for _ in range(times // 10):
        start = time.perf_counter()
        for _ in range(10):
            call()
        found.append((time.perf_counter() - start) / 10)
    return min(found)


def test_a_week_takes_no_more_memory_and_no_more_time_at_its_end(tables):
    now, found = 0.0, []
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: now)
    manager = ConfigurationManager(kb, Managed())
    kb.measure("battery_level", 1.0)

    def look(part):
        tell = quickest(lambda: kb.measure("water_visibility", 3.5))
        ask = quickest(
            lambda: (kb.is_feasible("search_pipeline"), kb.revision, kb.adaptable_functions())
        )
        story = quickest(lambda: str(kb.explain("search_pipeline")), 50)
        figures = (len(kb.log), len(kb.plans), len(kb.history.actions))
        found.append((part, kb.log.last, *figures, resident(), tell, ask, story))

    marks = {MEASUREMENTS * parts // 8: f"{parts}/8" for parts in (1, 2, 4, 8)}
    for number in range(1, MEASUREMENTS + 1):
        now += 0.1
        kb.measure(
            "water_visibility",
            3.5 - number % 7 / 2.0 if number % EVERY < 3 else 3.25 + number % 11 / 100,
        )
        if number % EVERY == 0:
            kb.measure("battery_level", 1.0 - number % 1000 / 2000)
            action = ("search_pipeline", "inspect_pipeline")[number // EVERY % 2]
            for one in kb.required_actions:
                kb.cancel_action(one.action, "completed")
            kb.request_action(action)
        if number % EVERY < 5:
            manager.update()
        if number in marks:
            look(marks[number])
    head = ("part", "events", "in the log", "plans", "requests", "memory", "tell", "ask", "explain")
    rows = [(*one[:5], f"{one[5] / 1e6:.0f} MB", *map(shown, one[6:])) for one in found]
    tables["week"] = lambda: table("A week at 10 Hz", head, rows)
    assert kb.log.last > MEASUREMENTS
    assert len(kb.plans) > 100
    assert all(one[5] < MOST for one in found)
