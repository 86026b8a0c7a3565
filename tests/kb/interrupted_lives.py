"""Random lives of a knowledge base under random interrupts; the twin is told the log, and nothing interrupts it."""

from collections import Counter
from functools import partial

from interrupting import interrupted_at, is_free
from kept import KEPT, Life, answers, robot
from models import Clock

from kb import KnowledgeBase, KnowledgeBaseError

FIRST_GUESS, UNTOUCHED = 200, 0.4


class Stuck(Exception):
    """Another thread waits for what the interrupted one has not given back."""


class Interrupted(Life):
    """Calls are interrupted at an instruction of chance; what comes of it must be all of an event, or nothing.

    Args:
        seed: of all chance.
        harsher: whether at any instruction, not only where Python looks for signals.

    Attributes:
        lies: what was answered otherwise by the twin, or was acknowledged and is not in the log, in words.
        counts: calls, interrupts, and after how many of these the event was in or out.
    """

    def __init__(self, seed, *, harsher=False):
        super().__init__(None, seed)
        self.at_chance = partial(interrupted_at, harsher=harsher)
        self.twin_clock, self.told = Clock(0.0), 0
        self.twin = KnowledgeBase(robot(), clock=self.twin_clock, keep=KEPT)
        self.heard, self.lies, self.counts = [], [], Counter()
        self.lengths = Counter()
        self.kb.subscribe(self.hear)

    def hear(self, event):
        if self.heard and event.number <= self.heard[-1]:
            self.lies.append(f"{event.text} was heard after event {self.heard[-1]}")
        self.heard.append(event.number)

    def turn(self):
        """Do what chance has come up with; some of it is interrupted."""
        self.clock.now += self.chance.choice((0.1, 0.5, 2.0))
        self.interrupt("time", lambda: self.kb.revision)
        try:
            for call, *arguments in self.calls(self.chance.randrange(12)):
                name = getattr(getattr(call, "func", call), "__name__", "call")
                self.interrupt(name, partial(call, *arguments))
        except (KnowledgeBaseError, IndexError):
            self.counts["refused"] += 1  # it was about what an interrupt has kept from being there

    def interrupt(self, name, call):
        self.counts["calls"] += 1
        if self.chance.random() < UNTOUCHED:
            call()
            return
        before, answered = self.kb.log.last, []
        guess = self.lengths[name] or FIRST_GUESS
        found = self.at_chance(self.chance.randint(1, guess), lambda: answered.append(call()))
        self.lengths[name] = max(20, int(guess * (1.1 if found else 0.6)))
        if found and not answered:
            self.counts["interrupts"] += 1
            self.counts["in" if self.kb.log.last > before else "out"] += 1
            if not is_free(self.kb):
                self.counts["leaks"] += 1
                raise Stuck

    def compare(self):
        """Tell the twin what is in the log, and note whatever it answers otherwise."""
        _ = self.kb.revision  # what time has done
        for event in list(self.kb.log.since(self.told)):
            self.twin_clock.now = event.time
            self.twin.tell(event)
            self.told = event.number
        self.twin_clock.now = self.clock.now
        mine, others = answers(self.kb), answers(self.twin)
        self.lies += [
            f"{key}: {mine[key]} is {others[key]}" for key in mine if mine[key] != others[key]
        ]


def spent(life, turns):
    """Live for so many turns, or until another thread waits in vain; returns the counts, the lies among them."""
    try:
        for _ in range(turns):
            life.turn()
            life.compare()
        life.kb.measure("load", 0.5)
        if life.heard[-1:] != [life.kb.log.last]:
            life.lies.append("a subscriber hears nothing any more")
    except Stuck:
        pass
    return life.counts + Counter(lies=len(life.lies))
