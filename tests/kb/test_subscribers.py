"""A subscriber hinders nobody: not when interrupted, not by asking another base."""

import gc
import os
import threading
import weakref

import pytest
from models import Clock

from kb import KnowledgeBase, Model


def base(**given):
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=5.0)
    model.action("explore", constraints=[light >= 0.5])
    model.component("camera")
    return KnowledgeBase(model, clock=Clock(1.0), **given)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, GeneratorExit])
def test_others_go_on_hearing_when_one_is_interrupted(error):
    kb = base()
    heard = []
    interrupted = []

    def interrupting(event):
        interrupted.append(event.number)
        if event.number == 1:
            raise error

    kb.subscribe(interrupting)
    kb.subscribe(lambda event: heard.append(event.number))
    with pytest.raises(error):
        kb.measure("light", 0.1)
    assert kb.attributes["light"].value == 0.1
    kb.measure("light", 0.2)
    kb.component_failed("camera")
    assert heard == interrupted == [1, 2, 3]


def test_bases_that_ask_each_other_never_deadlock():
    bases = one, other = base(), base()
    one.subscribe(lambda _: (other.is_feasible("explore"), other.explain("explore"), other.now))
    other.subscribe(lambda _: (one.is_feasible("explore"), one.explain("explore"), one.now))

    def tell(kb):
        for turn in range(300):
            kb.measure("light", turn % 2)
            kb.model.change("light", max_age=5.0 + turn)
            with kb.reading():
                kb.component_active("camera", turn % 2 == 1)

    threads = [
        threading.Thread(target=tell, args=(kb,), daemon=True) for kb in bases for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120.0)
    assert not any(thread.is_alive() for thread in threads)


@pytest.mark.parametrize("where", ["clock", "subscriber"])
def test_no_lock_is_held_while_the_code_of_others_runs(where):
    kb = base()
    answered = []

    def asks_by_another_thread(*_):
        if not answered:
            answered.append(None)
            thread = threading.Thread(
                target=lambda: answered.append(kb.is_feasible("explore")), daemon=True
            )
            thread.start()
            thread.join(60.0)
        return 1.0

    if where == "clock":
        kb._clock = asks_by_another_thread
    else:
        kb.subscribe(asks_by_another_thread)
    kb.measure("light", 0.7)
    assert answered[0] is None
    assert len(answered) == 2


def in_a_fork(child):
    """Run something in a child of fork; returns its exit code, 0 if it returned True."""
    pid = os.fork()
    if not pid:
        try:
            os._exit(0 if child() else 1)
        except BaseException:
            os._exit(2)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def test_forked_child_never_waits_for_a_missing_thread():
    kb = base()
    done = threading.Event()

    def tell():
        while not done.is_set():
            kb.measure("light", 0.7)
            kb.component_active("camera", not kb.components["camera"].is_active)

    thread = threading.Thread(target=tell)
    thread.start()

    def child():
        kb.measure("light", 0.9)
        return kb.is_feasible("explore")

    codes = [in_a_fork(child) for _ in range(20)]
    done.set()
    thread.join()
    assert codes == [0] * 20


def test_dropped_base_leaves_no_lock_for_forks():
    lock = weakref.ref(base()._lock)
    gc.collect()
    assert lock() is None
