"""Faults of the file of a store: processes killed while they write, and files that are damaged in every way."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from kept import Life, answers, robot

from kb import KnowledgeBase
from kb.store_file import StoreError
from missions.commands.store import backup, repair

HERE = Path(__file__).parent
ENDS = ("", "-wal", "-mark")


def killed(path, seed, delay):
    """Start a life in a process of its own and kill it; returns the last number that it knew to be on disk."""
    command = [sys.executable, str(HERE / "kept.py"), str(path), str(seed)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE.parents[1]), str(HERE)))}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        told = [int(line) for line in process.stdout.read().split("\n")[:-1]]
    assert process.returncode == -signal.SIGKILL
    return told[-1] if told else 0


def lived(path, seed, until):
    """Live the same life to the end of the call that told a certain fact."""
    life = Life(path, seed)
    moves = life.moves()
    while life.kb.log.last < until:
        next(moves)
    assert life.kb.log.last == until, "what one call told was torn apart"
    return life


def survives_a_kill(folder, number):
    """Kill a life, and have the next one find all that was acknowledged and go on; backups of it hold the same."""
    path = folder / "mission.sqlite3"
    acknowledged = killed(path, number, random.Random(number).uniform(0.0, 0.6))
    backup(path, folder / "backup.sqlite3")
    for place in (path, folder / "backup.sqlite3"):
        again = Life(place, number)
        abandoned = sum(
            one.end == 0.0 for one in (*again.kb.plans, *again.kb.history.attempts)
        )  # as it was opened
        saved = again.kb.log.last - abandoned
        assert saved >= acknowledged
        expected = lived(folder / f"expected of {place.name}", number, saved)
        again.clock.now = expected.clock.now
        assert answers(again.kb) == answers(expected.kb, ended=True)
        again.kb.measure("load", 0.5)
        assert again.kb.flush(120.0)
        assert again.kb.saved == again.kb.log.last > saved
        again.kb.close()
        expected.kb.close()


class Damages:
    """Stores as kills leave them, and damaged copies of them; what is answered is compared with the truth."""

    def __init__(self, folder, seed, lives=4):
        self.folder, self.chance = folder, random.Random(seed)
        self.states = [state for number in range(lives) for state in self._states(number)]
        self.kinds = Counter()

    def _states(self, seed):
        """Return copies of one life: early, late, and closed; with what was acknowledged and all that was told."""
        life = Life(self.folder / f"life {seed}.sqlite3", seed)
        copies, moves = [], life.moves()
        for name, steps in (("early", 150 + 100 * seed), ("late", 150 + 300 * seed)):
            for _ in zip(range(steps), moves, strict=False):
                if self.chance.random() < 0.2:
                    life.kb.flush(120.0)
            assert life.kb.flush(120.0)
            copies.append(self._copied(life.kb.store.path, f"{name} {seed}", life.kb.saved))
        events = life.kb.store.events()
        life.kb.close()
        copies.append(self._copied(life.kb.store.path, f"closed {seed}", life.kb.saved))
        return [
            (*one, copies[0][0], {event.number: plain(event) for event in events}) for one in copies
        ]

    def _copied(self, path, name, saved):
        copy = self.folder / f"{name}.sqlite3"
        for end in ENDS:
            if Path(f"{path}{end}").exists():
                shutil.copy(f"{path}{end}", f"{copy}{end}")
        return copy, saved

    def damage(self, path, early, other):
        """Damage a copy in one way; returns which."""
        chance = self.chance
        there = [end for end in ENDS if Path(f"{path}{end}").exists()]
        end = chance.choice(there)
        victim = Path(f"{path}{end}")
        how = chance.choice(
            ("flip", "flip", "flip", "cut", "missing", "page", "swapped", "older", "foreign", "shm")
        )
        content = bytearray(victim.read_bytes())
        if how == "flip":
            content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        elif how == "cut":
            del content[chance.randrange(len(content)) :]
        elif how == "page":
            begin = 4096 * chance.randrange(len(content) // 4096 + 1)
            filler = bytes([chance.choice((0, 255))])
            content[begin : begin + 4096] = filler * len(content[begin : begin + 4096])
        elif how in ("swapped", "older"):
            of = Path(f"{other if how == 'swapped' else early}{end}")
            content = bytearray(of.read_bytes()) if of.exists() else bytearray()
        elif how == "foreign":
            content = bytearray(chance.randbytes(len(content)))
        if how == "shm":
            Path(f"{path}-shm").write_bytes(chance.randbytes(32768))
        elif how == "missing" and end:
            victim.unlink()
            if chance.random() < 0.3:
                Path(f"{path}-mark").unlink(missing_ok=True)
        else:
            victim.write_bytes(content)
        return f"{how} {end or 'database'}"

    def one(self, number):
        """Damage a copy, open it, and compare; raises AssertionError at a lie."""
        state, acknowledged, early, truth = self.chance.choice(self.states)
        other = self.chance.choice([one[0] for one in self.states if one[3] is not truth])
        place = self.folder / f"damaged {number}"
        place.mkdir()
        path = place / "m.sqlite3"
        for end in ENDS:
            if Path(f"{state}{end}").exists():
                shutil.copy(f"{state}{end}", f"{path}{end}")
        how = self.damage(path, early, other)
        before = {one.name: one.read_bytes() for one in place.iterdir()}
        try:
            kb = KnowledgeBase(robot(), store=path, clock=lambda: 0.0)
        except StoreError as error:
            assert {one.name: one.read_bytes() for one in place.iterdir()} == before, (
                f"{how}: touched"
            )
            word = str(error).partition(": ")[2]
            self.kinds[how.split()[0], "refused: " + " ".join(word.split(";")[0].split()[:4])] += 1
            self.repaired(path, truth, how)
        else:
            if how != "swapped database":  # which is a store as good as this one
                self.is_true(kb, acknowledged, truth, how)
            self.kinds[how.split()[0], "opened, nothing is missing"] += 1
            kb.close()
        shutil.rmtree(place)

    def is_true(self, kb, acknowledged, truth, how):
        told = [plain(event) for event in kb.store.events() if event.number <= max(truth)]
        own = [
            one
            for one in told
            if one[1:3] != (0.0, "finish_plan") and one[1:3] != (0.0, "finish_attempt")
        ]
        assert kb.log.last >= acknowledged, f"{how}: {kb.log.last} of {acknowledged}"
        for one in own:
            assert truth.get(one[0], one) == one, how

    def repaired(self, path, truth, how):
        new = path.with_name("repaired.sqlite3")
        try:
            found = repair(path, new)
        except StoreError:
            self.kinds["repair", "refused"] += 1
            return
        kb = KnowledgeBase(robot(), store=new, clock=lambda: 0.0)
        events = [event for event in kb.store.events() if event.number <= found.last]
        assert kb.log.last > found.last
        if not how.startswith(("swapped", "older")):
            for event in events:
                assert truth.get(event.number, plain(event)) == plain(event), how
        kb.close()
        self.kinds["repair", "made"] += 1


def plain(event):
    return (event.number, event.time, event.verb, repr(event.arguments))
