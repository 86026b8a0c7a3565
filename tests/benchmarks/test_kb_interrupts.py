"""Random interrupts in any call of a knowledge base; `INTERRUPTS` says how many.

A life goes on after each interrupt. Its log is replayed on a twin that nothing interrupts; the twin
must answer the same.
"""

import os
import sys
from collections import Counter
from itertools import count
from pathlib import Path

import pytest
from figures import table

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS), str(TESTS / "kb")]  # the lives and interrupts are those of the tests

from clocks import Clock  # noqa: E402  # the path is set first
from interrupting import interrupted_at, is_free  # noqa: E402  # the path is set first
from kept import KEPT, Life, answers, robot  # noqa: E402  # the path is set first

from kb import KnowledgeBase, KnowledgeBaseError  # noqa: E402  # the path is set first

pytestmark = pytest.mark.benchmark(group="faults")

INTERRUPTS = int(os.environ.get("INTERRUPTS", "20000"))
CALLS_IN_A_LIFE = 150


class Interrupted(Life):
    """A life in which calls are interrupted, and its twin."""

    def __init__(self, seed):
        super().__init__(None, seed)
        self.counts = Counter(lives=1)
        self.heard = []
        self.kb.subscribe(lambda event: self.heard.append(event.number))
        self.twin_clock = Clock(0.0)
        self.twin = KnowledgeBase(robot(), clock=self.twin_clock, keep=KEPT, is_timed=False)

    def live(self):
        while self.counts["calls"] < CALLS_IN_A_LIFE:
            self.clock.now += self.chance.choice((0.1, 0.5, 2.0))
            try:
                for call, *arguments in self.calls(self.chance.randrange(12)):
                    self.interrupt(lambda call=call, given=arguments: call(*given))
            except (KnowledgeBaseError, IndexError):
                self.counts["refused"] += 1  # it is about what an interrupt kept out
            self.compare()
        self.kb.measure("load", 0.5)
        assert self.heard == sorted(set(self.heard))
        assert self.heard[-1] == self.kb.log.last

    def interrupt(self, call):
        self.counts["calls"] += 1
        before = self.kb.log.last
        done = []
        was_interrupted = interrupted_at(self.chance.randint(1, 250), lambda: done.append(call()))
        if not was_interrupted or done:
            return
        assert is_free(self.kb)
        _ = self.kb.revision
        self.counts["interrupts"] += 1
        self.counts["in" if self.kb.log.last > before else "out"] += 1

    def compare(self):
        _ = self.kb.revision  # records what is due
        for event in self.kb.log.since(self.twin.log.last):
            self.twin_clock.now = event.time
            self.twin.replay(event)
        self.twin_clock.now = self.clock.now
        assert answers(self.kb) == answers(self.twin)


def test_interrupted_lives_are_those_of_their_twins(tables):
    totals = Counter()
    for seed in count():
        life = Interrupted(seed)
        life.live()
        totals += life.counts
        if totals["interrupts"] >= INTERRUPTS:
            break
    head = ("lives", "calls", "interrupts", "in", "out")
    tables["interrupts"] = lambda: table("Interrupts", head, [[totals[name] for name in head]])
    assert totals["in"]
    assert totals["out"]
