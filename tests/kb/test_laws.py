"""The laws of a knowledge base: whatever happens, it answers as its naive twin does.

Facts, time, interrupts and a store that is closed and opened happen in any order. At the end the
log is replayed on another base, which answers the same.
"""

import tempfile
from pathlib import Path

from clocks import Clock
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from interrupting import interrupted_at, is_free
from kept import stored
from models import NUMBERS, Twins, events, models

from kb import KnowledgeBase

KEPT = 50


def record(base, what, *arguments):
    """Record a fact in one call."""
    calls = {
        "measure": base.measure,
        "failed": base.component_failed,
        "recovered": base.component_recovered,
        "active": base.component_active,
        "cancel": base.cancel_action,
        "request": base.request_action,
        "select": base.select,
    }
    calls[what](*arguments)


class ByName:
    """A naive twin that records facts by the names of the methods of a knowledge base."""

    def __init__(self, twins):
        self.naive = twins.naive
        self.measure = self.naive.measure
        self.component_failed = self.naive.failed.add
        self.cancel_action = self.naive.open_actions.discard
        self.request_action = self.naive.open_actions.add
        self.select = self.naive.select

    def component_recovered(self, name):
        self.naive.failed.discard(name)
        if self.naive.asserted.get(("component", name)) == "failure":
            del self.naive.asserted["component", name]

    def component_active(self, name, active):
        (self.naive.active.add if active else self.naive.active.discard)(name)


class Laws(RuleBasedStateMachine):
    """A knowledge base with a store, and its naive twin."""

    @initialize(model=models(aging=True, debounced=True))
    def begin(self, model):
        self.folder = tempfile.TemporaryDirectory()
        self.openings = 0
        self.path = Path(self.folder.name, "log.sqlite3")
        self.twins = Twins(model)
        self.twins.kb = self.opened()

    def opened(self):
        self.openings += 1
        return KnowledgeBase(self.twins.model, clock=self.twins.clock, store=self.path, keep=KEPT)

    @rule(data=st.data())
    def happen(self, data):
        self.twins.happen(data.draw(events(self.twins.model)))

    @rule(number=st.integers(0, 1), value=st.sampled_from(NUMBERS), halves=st.integers(0, 3))
    def measure(self, number, value, halves):
        attributes = list(self.twins.model.attributes)
        self.twins.pass_time(halves / 2)
        self.twins.kb.measure(attributes[number % len(attributes)], value)
        self.twins.naive.measure(attributes[number % len(attributes)], value)

    @rule(halves=st.integers(1, 8))
    def pass_time(self, halves):
        self.twins.pass_time(halves / 2)

    @rule(data=st.data(), place=st.integers(1, 600))
    def interrupt(self, data, place):
        """A call that is interrupted anywhere has recorded its event, or has not."""
        twins = self.twins
        what, *arguments = data.draw(events(twins.model, asserting=False))
        if what in ("adapt", "carry_out_pending", "finish"):
            return
        if what == "select":
            arguments = twins.possible(arguments[0])
        is_refused = what == "request" and arguments[0] not in twins.naive.selectable_actions()
        _ = twins.kb.revision  # records what is due
        before = twins.kb.log.last
        interrupted_at(place, lambda: record(twins.kb, what, *arguments))
        assert is_free(twins.kb)
        _ = twins.kb.revision  # completes what was interrupted
        is_in = twins.kb.log.last > before
        assert twins.kb.log.last - before <= 1
        if is_in and not is_refused:
            record(ByName(twins), what, *arguments)

    @precondition(lambda self: self.openings < 3)
    @rule()
    def reopen(self):
        """A store that is closed and opened has all that was known."""
        last = self.twins.kb.log.last
        self.twins.kb.close()
        self.twins.kb = self.opened()
        assert self.twins.kb.log.last >= last

    @invariant()
    def agree(self):
        self.twins.agree()

    def teardown(self):
        if not hasattr(self, "twins"):
            return
        self.twins.kb.close()
        self.replay(stored(self.path))
        self.folder.cleanup()

    def replay(self, recorded):
        """A replay has each event in its place, those that time caused too."""
        clock = Clock(0.0)
        again = KnowledgeBase(self.twins.model, clock=clock, is_timed=False)
        for event in recorded:
            clock.now = event.time
            again.replay(event)
        clock.now = self.twins.clock.now
        self.twins.agree(again)
        assert [event[1:4] for event in again.log] == [event[1:4] for event in recorded]


TestLaws = Laws.TestCase
TestLaws.settings = settings(max_examples=40, stateful_step_count=50, deadline=None)
