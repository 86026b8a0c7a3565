"""What is told is in the store, and a base that is made of it goes on; whatever else a file is, it stays as it is."""

import gc
import itertools
import logging
import os
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies
from kept import Life, answers, robot
from models import Clock, Twins, stories
from test_files import odd_models

from kb import InvalidValue, KnowledgeBase, KnowledgeBaseError, Model, PriorityPlanner
from kb.store_file import FORMAT, StoreError

FEW = settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stores")


HERE = str(Path(__file__).parent)
numbers = itertools.count()


def fresh(folder):
    return folder / f"{next(numbers)}.sqlite3"


@contextmanager
def kept(model, path, **settings):
    kb = KnowledgeBase(model, store=path, **{"clock": Clock(5.0), **settings})
    try:
        yield kb
    finally:
        kb.close()


def dead(path, folder):
    """Return a copy of what a process that is killed now would leave."""
    copy = fresh(folder)
    for end in ("", "-wal", "-mark"):
        shutil.copy(f"{path}{end}", f"{copy}{end}")
    return copy


@given(story=stories(aging=True))
@FEW
def test_reopened_base_answers_as_before(story, folder):
    model, events = story
    path, twins = fresh(folder), Twins(model)
    twins.kb = KnowledgeBase(model, clock=twins.clock, store=path)
    for event in events:
        twins.happen(event)
    before = answers(twins.kb, ended=True)
    twins.kb.close()
    twins.kb = KnowledgeBase(model, clock=twins.clock, store=path)
    assert answers(twins.kb) == before
    twins.agree()
    twins.kb.close()


@given(story=stories(aging=True))
@FEW
def test_base_goes_on_from_what_a_kill_leaves(story, folder):
    model, events = story
    path, twins = fresh(folder), Twins(model)
    twins.kb = KnowledgeBase(model, clock=twins.clock, store=path)
    for event in events[: len(events) // 2]:
        twins.happen(event)
    assert twins.kb.flush(120.0)
    assert twins.kb.saved == twins.kb.log.last
    before = answers(twins.kb, ended=True)
    copy = dead(path, folder)
    twins.kb.close()
    twins.kb = KnowledgeBase(model, clock=twins.clock, store=copy)
    assert answers(twins.kb) == before
    for event in events[len(events) // 2 :]:
        twins.happen(event)
    twins.agree()
    twins.kb.close()


@given(model=odd_models())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_whatever_a_model_states_is_there_again(model, folder):
    path = fresh(folder)
    with kept(model, path) as kb:
        before = answers(kb, ended=True)
    with kept(model, path) as kb:
        again = answers(kb)
        assert again == before
    with kept(model, path) as kb:
        assert answers(kb) == before


def test_open_plans_are_abandoned_when_the_base_goes_on(tmp_path):
    path, clock = tmp_path / "m.sqlite3", Clock(1.0)
    with kept(robot(), path, clock=clock) as kb:
        kb.request_action("explore")
        plan = PriorityPlanner().plan(kb)
        assert plan.end is None
    clock.now = 9.0
    with kept(robot(), path, clock=clock) as kb:
        (plan,) = kb.plans
        assert (plan.result, plan.end, kb.pending_plan) == ("abandoned", 9.0, None)
        assert [one.action for one in kb.required_actions] == ["explore"]
        plan = PriorityPlanner().plan(kb)
        assert plan.activate == ("camera",)
        kb.finish_plan(plan, "completed")
    with kept(robot(), path, clock=clock) as kb:
        assert [one.result for one in kb.plans] == ["abandoned", "completed"]


def test_what_changes_nothing_writes_nothing(tmp_path):
    with kept(robot(), tmp_path / "m.sqlite3") as kb:
        kb.component_active("camera", True)
        assert kb.flush(120.0)
        saved, size = kb.log.last, (tmp_path / "m.sqlite3-wal").stat()
        kb.component_active("camera", True)
        kb.component_recovered("camera")
        kb.cancel_action("rest")
        kb.is_feasible("explore")
        assert kb.flush(120.0)
        assert (kb.saved, kb.log.last) == (saved, saved)
        assert (tmp_path / "m.sqlite3-wal").stat().st_mtime_ns == size.st_mtime_ns


def test_store_holds_the_newest_measurements_and_does_not_grow_beyond_them(tmp_path):
    path = tmp_path / "m.sqlite3"
    clock = Clock(0.0)

    def measure(kb, times):
        for number in range(times):
            clock.now += 0.1
            kb.measure("load", clock.now)
            if (
                number % 200 == 199
            ):  # what is written at once is in the file for a moment, before the old is dropped
                assert kb.flush(120.0)

    with kept(robot(), path, clock=clock, keep=100) as kb:
        measure(kb, 2000)
        kb.close()
        size = path.stat().st_size
    with kept(robot(), path, clock=clock, keep=100) as kb:
        measure(kb, 6000)
        history = kb.attributes["load"].history
    assert path.stat().st_size <= 1.2 * size
    with kept(robot(), path, clock=clock, keep=100) as kb:
        assert kb.attributes["load"].history[-100:] == history[-100:]


@pytest.mark.parametrize("store", [5, "", b"m.sqlite3", True])
def test_store_is_named_by_a_path(store):
    with pytest.raises(InvalidValue, match="a store is the path of a file"):
        KnowledgeBase(robot(), store=store)


@pytest.mark.parametrize("keep", [0, -1, 2.5, True, "many"])
def test_limit_of_measurements_is_a_number(keep, tmp_path):
    with pytest.raises(InvalidValue, match="keep is a whole number"):
        KnowledgeBase(robot(), store=tmp_path / "m.sqlite3", keep=keep)
    assert not list(tmp_path.iterdir())


def amend(model):
    bright = model.attributes["light"] >= 0.9
    model.action("film", requires=["see"], constraints=[bright, bright.steady(dwell=2.0)])
    model.change(model.constraints[-2], value=0.8, hysteresis=0.05)
    model.change(model.attributes["light"], max_age=float("inf"), when_stale="not evaluated")
    model.change(
        model.configurations["day"],
        parameters={"exposure": 1, "mode": ["x", "\u00e9"]},
        priority=None,
    )
    model.remove(model.constraints[0])
    model.remove(model.actions["rest"])
    model.components["lidar"].estimate("energy", 2.0)
    model.change(model.estimations[-1], value=3.0)
    model.remove(model.estimations[0])
    model.constrain(
        [model.actions["film"], model.components["lidar"]], model.attributes["load"] <= 3.0
    )
    model.remove(model.actions["film"])


def test_amendments_are_made_again(tmp_path):
    path, model = tmp_path / "m.sqlite3", robot()
    with kept(model, path) as kb:
        kb.request_action("rest")
        kb.measure("light", 0.4)
        amend(model)
        kb.assert_status(kb.components["lidar"].constraints[-1], "violated")
        kb.component_failed("camera")
        before = answers(kb, ended=True)
    again = robot()
    with kept(again, path) as kb:
        assert again == model
        assert answers(kb) == before
    with kept(again, path) as kb:  # given as it is by now
        assert answers(kb) == before
        again.remove(again.constraints[-1])
        kb.component_active("lidar", True)
        before = answers(kb)
    last = robot()
    with kept(last, path) as kb:
        assert last == again
        assert answers(kb) == before


def test_store_of_another_model_is_refused_with_what_differs(tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path):
        pass
    content = path.read_bytes()
    other = robot()
    other.change(other.configurations["night"], priority=7)
    other.action("sing")
    with pytest.raises(StoreError) as caught:
        KnowledgeBase(other, store=path)
    said = str(caught.value)
    assert re.search(r"component configuration night \([^)]*priority 7\) is not in the store", said)
    assert re.search(r"component configuration night \([^)]*priority 2\) is in the store only", said)
    assert "action sing () is not in the store" in said
    with pytest.raises(StoreError, match="is in the store only"):
        KnowledgeBase(Model("robot"), store=path)
    assert path.read_bytes() == content
    with kept(robot(), path):
        pass


def sqlite_of_something_else(path):
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE notes (text)")
    database.close()


def newer(path):
    with kept(robot(), path):
        pass
    database = sqlite3.connect(path)
    database.execute(f"PRAGMA user_version={FORMAT + 1}")
    database.close()


def damaged(path):
    with kept(robot(), path):
        pass
    content = path.read_bytes()
    path.write_bytes(content[:100] + bytes(len(content) - 100))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path.write_text("my diary, no database at all" * 9), "this is not a store"),
        (lambda path: path.write_bytes(b"SQLite format 3\0"), "this is not a store"),
        (sqlite_of_something_else, "the database of another program"),
        (newer, f"has format {FORMAT + 1}, of a newer version"),
        (damaged, "damaged|malformed|no such|opened"),
        (lambda path: path.mkdir(), "cannot be read|another file"),
    ],
)
def test_other_file_is_refused_and_untouched(make, message, tmp_path):
    path = tmp_path / "m.sqlite3"
    make(path)
    before = {one: one.read_bytes() for one in tmp_path.iterdir() if one.is_file()}
    with pytest.raises(StoreError, match=message) as caught:
        KnowledgeBase(robot(), store=path)
    assert str(path) in str(caught.value)
    assert {one: one.read_bytes() for one in tmp_path.iterdir() if one.is_file()} == before


def test_folder_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be made"):
        KnowledgeBase(robot(), store=tmp_path / "nowhere" / "m.sqlite3")


def test_empty_file_becomes_a_store(tmp_path):
    (tmp_path / "m.sqlite3").touch()
    with kept(robot(), tmp_path / "m.sqlite3") as kb:
        kb.measure("load", 1.0)
        assert kb.flush(120.0)


def test_store_has_one_user_at_a_time(tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path) as kb:
        with pytest.raises(StoreError, match="in use by another"):
            KnowledgeBase(robot(), store=path)
        code = f"""
import sys; sys.path.insert(0, {HERE!r})
from kept import robot
from kb import KnowledgeBase
KnowledgeBase(robot(), store={str(path)!r})"""
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert "StoreError" in done.stderr
        assert "in use by another knowledge base or process" in done.stderr
        kb.measure("load", 2.0)
        assert kb.flush(120.0)
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 2.0


def test_store_that_others_lock_is_left_alone(tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path):
        pass
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(StoreError, match="in use by another"):
        KnowledgeBase(robot(), store=path)
    other.close()


def test_closed_base_can_be_asked_and_is_told_nothing_more(tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path) as kb:
        kb.measure("load", 1.0)
        kb.component_failed("camera")
        kb.close()
        with pytest.raises(KnowledgeBaseError, match="closed"):
            kb.measure("load", 2.0)
        assert kb.attributes["load"].value == 1.0
        assert kb.query("SELECT ?s { ?f a :Failure ; :start ?s }") == [(5.0,)]
        assert (kb.flush(0.1), kb.saved, kb.store.error) == (True, kb.log.last, None)
        kb.close()
    assert [one.name for one in tmp_path.iterdir()] == ["m.sqlite3"]
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 1.0


def test_base_that_is_dropped_gives_its_store_back(tmp_path):
    path = tmp_path / "m.sqlite3"
    kb = KnowledgeBase(robot(), store=path)
    kb.measure("load", 4.0)
    del kb
    gc.collect()
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 4.0


def test_end_of_the_program_saves_what_was_told(tmp_path):
    path = tmp_path / "m.sqlite3"
    code = f"""
import sys; sys.path.insert(0, {HERE!r})
from kept import robot
from kb import KnowledgeBase
kb = KnowledgeBase(robot(), store={str(path)!r})
for number in range(500): kb.measure("load", float(number))"""
    subprocess.run([sys.executable, "-c", code], check=True)
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 499.0


@contextmanager
def files_no_longer_than(size):
    """Have every write beyond a size fail, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def soon(condition):
    """Wait until something is so that another thread does."""
    deadline = time.monotonic() + 120.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def fill(kb):
    for number in range(3000):
        kb.measure("load", float(number))
    kb.assert_required("see", True)
    assert not kb.flush(120.0)


def test_full_disk_is_said_and_the_mission_goes_on(tmp_path, caplog):
    path, told = tmp_path / "m.sqlite3", []
    failures = "SELECT ?start { ?f a :Failure ; :start ?start }"
    with caplog.at_level(logging.ERROR), kept(robot(), path) as kb:
        kb.subscribe(lambda event: told.append(event.text))
        kb.component_failed("camera")
        assert kb.flush(120.0)
        saved = kb.saved
        assert kb.query(failures) == [(5.0,)]
        kb.component_failed("lidar")
        assert kb.flush(120.0)
        with files_no_longer_than(100_000):
            fill(kb)
            assert kb.query(failures) == [(5.0,), (5.0,)]
            assert kb.query(
                "SELECT ?n { ?x a :AssertedRequirement ; :about ?f . ?f :name ?n }"
            ) == [("see",)]
            assert "nothing has been saved since event" in kb.store.error
            assert soon(
                lambda: any("nothing has been saved" in text for text in told)
            )  # the writer tells it
            assert "it is tried again every second" in caplog.text
            kb.component_recovered("camera")
            assert kb.request_action("explore")
            assert PriorityPlanner().plan(kb).activate == ("camera",)
            assert kb.query("SELECT (MAX(?v) AS ?most) { ?m a :Measurement ; :value ?v }") == [
                (2999.0,)
            ]
            assert kb.query("SELECT ?end { ?f a :Failure ; :end ?end }") == [(5.0,)]
            for _ in range(2):
                with pytest.raises(
                    StoreError, match=r"\d+ events are not saved; make room, and close it again"
                ):
                    kb.close()
            with pytest.raises(KnowledgeBaseError, match="closed"):
                kb.measure("load", 1.0)
            last = kb.log.last
        kb.close()  # there is room again
        assert kb.query("SELECT ?end { ?f a :Failure ; :end ?end }") == [(5.0,)]
        assert kb.query("SELECT (MAX(?v) AS ?most) { ?m a :Measurement ; :value ?v }") == [
            (2999.0,)
        ]
        assert kb.saved == kb.log.last >= last > saved
    with kept(robot(), path) as kb:
        assert kb.log.last > last
        assert kb.attributes["load"].value == 2999.0
        assert kb.components["camera"].status != "failure"


def test_all_that_waited_is_saved_in_order_once_the_disk_has_room_again(tmp_path):
    path, other, told = tmp_path / "m.sqlite3", tmp_path / "other.sqlite3", []
    with kept(robot(), path, keep=100) as kb, kept(robot(), other, keep=100) as untroubled:
        kb.subscribe(lambda event: told.append(event.text))
        with files_no_longer_than(100_000):
            fill(kb)
            kb.component_failed("camera", "rain")
            assert kb.saved < kb.log.last
        for number in range(3000):
            untroubled.measure("load", float(number))
        untroubled.assert_required("see", True)
        untroubled.component_failed("camera", "rain")
        assert soon(lambda: kb.store.error is None and kb.flush(1.0))
        assert soon(lambda: any(text.endswith("everything is saved again") for text in told))
        kb.component_recovered("lidar")
        untroubled.component_recovered("lidar")
        assert kb.flush(120.0)
        expected = answers(untroubled)
    with kept(robot(), path, keep=100) as kb:
        assert answers(kb) == expected


def test_waiting_for_room_is_given_up_when_too_much_waits(tmp_path, monkeypatch):
    monkeypatch.setattr("kb.store._MOST_WAITING", 1000)
    with kept(robot(), tmp_path / "m.sqlite3") as kb:
        with files_no_longer_than(100_000):
            fill(kb)
            assert soon(lambda: "any more" in kb.store.error)
        kb.measure("load", 5000.0)
        assert not kb.flush(1.5)
        assert "nothing will be saved any more" in kb.store.error
        assert kb.query("SELECT (MAX(?v) AS ?most) { ?m a :Measurement ; :value ?v }") == [
            (5000.0,)
        ]
        with pytest.raises(StoreError, match=r"\d+ events are lost; the file is sound"):
            kb.close()


def test_disk_that_is_full_from_the_start_is_an_error(tmp_path):
    with files_no_longer_than(10_000), pytest.raises(StoreError, match="cannot be made"):
        KnowledgeBase(robot(), store=tmp_path / "m.sqlite3")
    assert not list(tmp_path.iterdir())


@contextmanager
def nobody():
    """Be someone who may write only what everybody may; the superuser may write anything."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(before)


@pytest.fixture
def open_folder():
    """Return a folder that everybody may reach."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        yield Path(name)
        Path(name).chmod(0o777)


@pytest.mark.parametrize(
    ("of_folder", "of_file", "message"),
    [
        (
            0o777,
            0o444,
            "cannot be opened for writing: attempt to write a readonly database; see who may write it",
        ),
        (
            0o555,
            0o444,
            "cannot be opened for writing: attempt to write a readonly database; see who may write it",
        ),
        (
            0o555,
            0o666,
            "cannot be opened for writing: attempt to write a readonly database; see who may write it",
        ),
        (0o777, 0o000, "cannot be read: Permission denied"),
        (0o555, None, "cannot be made: Permission denied; see who may write in that folder"),
    ],
)
def test_file_that_may_not_be_written_is_an_error_and_untouched(
    of_folder, of_file, message, open_folder
):
    path = open_folder / "m.sqlite3"
    with kept(robot(), path):
        pass
    content = path.read_bytes()
    if of_file is None:
        path.unlink()
    else:
        path.chmod(of_file)
    open_folder.chmod(of_folder)
    with nobody(), pytest.raises(StoreError, match=message):
        KnowledgeBase(robot(), store=path)
    assert [one.read_bytes() for one in open_folder.iterdir()] == (
        [] if of_file is None else [content]
    )


@pytest.fixture(scope="module")
def lived(tmp_path_factory):
    """Return the content of a store in which something happened."""
    path = tmp_path_factory.mktemp("lived") / "m.sqlite3"
    life = Life(path, 1)
    for _ in zip(range(200), life.moves(), strict=False):
        pass
    life.kb.close()
    return path.read_bytes()


@given(data=strategies.data())
@FEW
def test_damaged_file_is_refused_and_untouched(data, lived, folder):
    path, page = folder / f"damaged {next(numbers)}.sqlite3", 4096
    number = data.draw(strategies.integers(1, len(lived) // page - 1))
    if data.draw(strategies.booleans(), "cut off there, or overwritten there"):
        content = lived[: number * page - data.draw(strategies.integers(0, page - 100))]
    else:
        content = lived[: number * page] + bytes([255]) * page + lived[number * page + page :]
    path.write_bytes(content)
    with pytest.raises(
        StoreError,
        match=r"the store is damaged: .*; `rosa store repair .* writes what is sound to a new file",
    ):
        KnowledgeBase(robot(), store=path)
    assert path.read_bytes() == content
    assert [one for one in folder.iterdir() if one.name.startswith(f"{path.name}-")] == []
    path.unlink()


def test_log_beside_the_file_stays_small(tmp_path):
    path, sizes = tmp_path / "m.sqlite3", []
    with kept(robot(), path) as kb:
        for number in range(400):  # each in a commit of its own
            kb.measure("load", float(number))
            assert kb.flush(120.0)
            sizes.append(path.with_name("m.sqlite3-wal").stat().st_size)
    assert 500_000 < max(sizes) < 1_500_000


def test_facts_of_many_threads_are_all_saved(tmp_path):
    path, each = tmp_path / "m.sqlite3", 300
    asked = []
    with kept(robot(), path, clock=time.time) as kb:
        done = threading.Event()

        def tell(number):
            for turn in range(each):
                kb.measure(("light", "energy", "load")[number % 3], turn / each)
                if turn % 50 == number:
                    kb.component_failed("lidar")
                    kb.component_recovered("lidar")

        def ask():
            is_last = False
            while not is_last:
                is_last = done.is_set()
                asked.append(kb.query("SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }")[0][0])

        tellers = [threading.Thread(target=tell, args=(number,)) for number in range(8)]
        askers = [threading.Thread(target=ask) for _ in range(2)]
        for thread in (*tellers, *askers):
            thread.start()
        for thread in tellers:
            thread.join()
        done.set()
        for thread in askers:
            thread.join()
        assert kb.flush(120.0)
        before = answers(kb)
    assert asked[-1] == 8 * each
    with kept(robot(), path, clock=time.time) as kb:
        assert sum(len(one.history) for one in kb.attributes.values()) == 8 * each
        after = answers(kb)
    assert {key: after[key] for key in ("selected", "active", "plans")} == {
        key: before[key] for key in ("selected", "active", "plans")
    }


def test_base_without_a_store_saves_nothing():
    kb = KnowledgeBase(robot())
    kb.measure("load", 1.0)
    assert (kb.saved, kb.store, kb.flush(0.1)) == (0, None, False)
    kb.close()
    assert issubclass(StoreError, KnowledgeBaseError)


def test_life_in_a_store_is_the_life_in_memory(tmp_path):
    life, memory = Life(tmp_path / "m.sqlite3", 3), Life(None, 3)
    for _ in zip(range(400), life.moves(), memory.moves(), strict=False):
        pass
    assert answers(life.kb) == answers(memory.kb)
    life.kb.close()


def test_store_is_opened_from_its_last_snapshot_and_goes_on_with_the_tail(tmp_path):
    path, clock = tmp_path / "m.sqlite3", Clock(0.0)
    with kept(robot(), path, clock=clock, keep=100) as kb:
        for number in range(2500):
            clock.now += 0.1
            kb.measure(("light", "energy", "load")[number % 3], number % 10 / 10)
        kb.request_action("explore")
        assert kb.flush(120.0)
        kb.component_failed("lidar", "rain")
        expected, last = answers(kb), kb.log.last
    database = sqlite3.connect(path)
    ((snapshot,),) = database.execute("SELECT MAX(number) FROM snapshots").fetchall()
    database.close()
    assert 1000 <= snapshot < last
    with kept(robot(), path, clock=clock, keep=100) as kb:
        assert kb.log.last == last
        assert answers(kb) == expected
        assert [one.verb for one in kb.store.events(last - 2)] == [
            "request_action",
            "component_failed",
        ]


def test_store_that_is_closed_at_rest_keeps_what_is_known_and_no_tail(tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path) as kb:
        for number in range(1500):
            kb.measure("load", number % 10 / 10)
        assert kb.flush(120.0)
        last = kb.log.last
    database = sqlite3.connect(path)
    assert database.execute("SELECT MAX(number) FROM snapshots").fetchall() == [(last,)]
    database.close()


@pytest.mark.parametrize(
    "forge",
    [
        "UPDATE events SET data = '[[\"load\",9.0],null,[]]' WHERE number = 2",
        "UPDATE events SET time = 7.0 WHERE number = 2",
        "DELETE FROM events WHERE number = 1; UPDATE events SET number = number - 1",
    ],
)
def test_record_that_is_not_as_it_was_written_is_noticed(forge, tmp_path):
    path = tmp_path / "m.sqlite3"
    with kept(robot(), path) as kb:
        for value in (1.0, 2.0, 3.0):
            kb.measure("load", value)
    database = sqlite3.connect(path)
    database.executescript(forge)
    database.close()
    with pytest.raises(StoreError, match="is not as it was written"):
        KnowledgeBase(robot(), store=path)


FORKED = """
import os, sys, threading; sys.path.insert(0, {here!r})
from kept import robot
from kb import KnowledgeBase, KnowledgeBaseError
kb = KnowledgeBase(robot(), store={path!r})
done = threading.Event()
def tell():
    while not done.wait(0.001): kb.measure("load", 1.0)
teller = threading.Thread(target=tell)
teller.start()
for number in range(8):
    if (child := os.fork()) == 0:
        told = 0
        tells = (lambda: kb.measure("load", -1.0), lambda: kb.component_failed("camera"))
        for call in (*tells, kb.flush, kb.store.events):
            try: call()
            except KnowledgeBaseError as error: told += "of its own here" in str(error) or "of your own" in str(error)
        kb.close()
        if number % 2: os._exit(told)
        del kb
        done.set()
        sys.exit(told)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 4, status
done.set()
teller.join()
kb.measure("load", 2.0)
print(kb.flush(120.0), kb.saved == kb.log.last, len(kb.store.events()) > 0)
kb.close()
"""


def test_child_of_a_fork_is_told_to_open_its_own_store_and_neither_hangs_nor_writes(tmp_path):
    path = tmp_path / "m.sqlite3"
    code = FORKED.format(here=HERE, path=str(path))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.stdout, done.returncode) == ("True True True\n", 0), done.stderr
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 2.0
        assert -1.0 not in [value for _, value in kb.attributes["load"].history]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_fork_waits_for_the_file_since_sqlite_has_locks_that_a_child_would_inherit(tmp_path):
    with kept(robot(), tmp_path / "m.sqlite3") as kb:
        begun, done = threading.Event(), []

        def use():
            with kb.store.using:
                begun.set()
                time.sleep(0.05)
                done.append(True)

        user = threading.Thread(target=use)
        user.start()
        assert begun.wait(60.0)
        child = os.fork()
        if child == 0:
            os._exit(0 if done else 1)
        user.join()
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_history_that_is_too_long_to_be_checked_at_once_is_checked_as_it_is_read(
    tmp_path, monkeypatch
):
    path = tmp_path / "m.sqlite3"
    with kept(
        robot(), path, keep=20_000
    ) as kb:  # however many are written together, none is dropped
        kb.component_failed("camera", "rain")
        for number in range(12_000):
            kb.measure("load", float(number))
        assert kb.flush(120.0)
        kb.measure("load", 7.0)
    content = path.read_bytes()
    place = content.index(b'["load",700.0]')
    path.write_bytes(content[:place] + b'["load",701.0]' + content[place + 14 :])
    with pytest.raises(StoreError, match="event 702 is not as it was written"):
        KnowledgeBase(robot(), store=path)
    monkeypatch.setattr("kb.store_file.WHOLE_CHECK", 1000)
    with kept(robot(), path) as kb:
        assert kb.attributes["load"].value == 7.0
        with pytest.raises(StoreError, match="event 702 is not as it was written"):
            kb.store.events()
