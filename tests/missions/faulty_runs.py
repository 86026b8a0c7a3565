"""Whole missions and campaigns under faults; the twin of each is the same run, without them."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from running import text

from kb import KnowledgeBase, Model
from missions.baselines import open_run
from missions.engine.mission import MissionError, find_mission
from missions.engine.runner import Listener
from missions.experiments.campaign import FILE, read_store
from missions.views.output import as_json, summary

CAMPAIGN = """
missions = ["suave"]
managers = ["bt", "ours"]
runs = 5
[settings]
duration_s = 40
"""


def opened(name, task, seed=0):
    return open_run(find_mission(name), task=task, seed=seed)


@contextmanager
def interrupted_after(seconds):
    """Interrupt what is done in this block, as Ctrl-C does, once it has taken that time of the processor."""

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGPROF, interrupt)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def children():
    """Return the processes that this one has started and that have not ended."""
    me, count = str(os.getpid()), 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            state, parent, *_ = path.read_text().rpartition(")")[2].split()
            count += parent == me and state != "Z"
    return count


def told(run):
    return [(one.number, one.time, one.verb, one.arguments) for one in run.kb.log]


def interrupted(name, task, seconds, whole):
    """Run a mission that is interrupted after that time; returns what is untrue of it then, and whether it was.

    Args:
        name: of the mission.
        task: the kind of its task layer.
        seconds: of the processor, when it is interrupted.
        whole: what the run without an interrupt has told, see `told`.
    """
    threads, processes = threading.active_count(), children()
    run, was, lies = opened(name, task), False, []
    closed, close = [], run.world.close
    run.world.close = lambda: (closed.append(True), close())
    try:
        with interrupted_after(seconds):
            run.run()
    except KeyboardInterrupt:
        was = True
    mine = told(run)
    at_end = run.world.now
    acted = [one for one in mine if one[1] < at_end]
    if acted != whole[: len(acted)]:
        lies.append(
            f"{next(pair for pair in zip(acted, whole, strict=False) if pair[0] != pair[1])} differ"
        )
    if run.kb.required_actions:
        lies.append(f"still open: {run.kb.required_actions}")
    if not closed:
        lies.append("the world is not closed")
    done = threading.Event()
    threading.Thread(
        target=lambda: (run.kb.is_feasible(next(iter(run.kb.actions))), done.set()), daemon=True
    ).start()
    if not done.wait(60.0):
        lies.append("another thread waits for the knowledge base")
    end = time.monotonic() + 60.0
    while (threading.active_count() > threads or children() > processes) and time.monotonic() < end:
        time.sleep(0.01)
    if threading.active_count() > threads or children() > processes:
        lies.append(
            f"left: {threading.active_count() - threads} threads, {children() - processes} processes"
        )
    return lies, was


class Hostile(Listener):
    """Puts subscribers to a run's knowledge base, and threads beside it, that do what nobody should."""

    def __init__(self):
        model = Model("other")
        model.action("rest")
        self.other, self.heard, self.calls, self.is_over = (
            KnowledgeBase(model, clock=lambda: 0.0),
            [],
            0,
            False,
        )
        self.threads = []

    def beset(self, run):
        kb = run.kb

        def fail(event):
            raise ValueError("I do not like that")

        def tell_back(event):
            if event.verb == "measure" and self.calls < 200:
                self.calls += 1
                kb.component_started(next(iter(kb.components)), 1)

        def dawdle(event):
            if event.verb == "request_action":
                time.sleep(0.02)

        def ask_another(event):
            self.other.request_action("rest")
            self.other.cancel_action("rest")
            kb.is_feasible(next(iter(kb.actions)))

        def answer(event):  # the other base asks ours
            kb.explain(next(iter(kb.actions)))

        def ask():
            while not self.is_over:
                kb.selectable_actions()
                kb.component_started(next(iter(kb.components)), 1)
                time.sleep(0.01)

        self.other.subscribe(answer)
        for one in (
            fail,
            tell_back,
            dawdle,
            ask_another,
            lambda event: self.heard.append(event.number),
        ):
            kb.subscribe(one)
        self.threads = [threading.Thread(target=ask) for _ in range(3)]
        for one in self.threads:
            one.start()


def beset(name, task, seed):
    """Run a mission among hostile subscribers and threads; returns what is untrue of it."""
    run, hostile = opened(name, task, seed), Hostile()
    hostile.beset(run)
    try:
        verdict = run.run()
    finally:
        hostile.is_over = True
        for one in hostile.threads:
            one.join()
    lies = (
        []
        if as_json(summary(run, verdict, seed, {})) == text(name, task, seed)
        else ["it decides otherwise"]
    )
    if hostile.heard != sorted(set(hostile.heard)) or len(hostile.heard) < 100:
        lies.append(f"one that does no harm heard {len(hostile.heard)} events")
    return lies


def campaign(folder, *options, most_bytes=None):
    """Start a campaign as a person does, perhaps on a disk with little room."""

    def limit():
        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))

    command = [
        sys.executable,
        "-m",
        "missions",
        "campaign",
        *map(str, options),
        "--out",
        str(folder),
    ]
    # each is a group of its own, so that all of it can be killed
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, preexec_fn=limit, start_new_session=True, **pipes)


def tables(folder):
    return {name: (folder / name).read_bytes() for name in ("runs.csv", "reactions.csv")}


def kept(folder):
    """Return the records of a campaign that is perhaps about to begin, by the names of runs."""
    try:
        return {record["run"]: record for record in read_store(folder).records}
    except MissionError:
        return {}


def gone_on_with(folder, file, whole):
    """Go on with a campaign that something has stopped; returns what is untrue of it after that."""
    begun, before = (folder / FILE).exists(), kept(folder)
    running = campaign(folder, file, "--workers", 1, *(["--resume"] if begun else []))
    said, _ = running.communicate(timeout=300)
    if running.returncode:
        return [said]
    lies = [] if tables(folder) == whole else ["the tables are others"]
    after = kept(folder)
    if any(after.get(name) != record for name, record in before.items()):
        lies.append("what was kept has changed")
    return lies
