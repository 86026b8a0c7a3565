"""`rosa store` says what is in a store, copies it while it is written to, repairs it, and gives it a new model."""

import threading

import pytest
from typer.testing import CliRunner

from kb import KnowledgeBase, Model, PriorityPlanner
from kb.store_file import StoreError
from missions.cli import app


def rover(*, changed=False):
    model = Model("rover")
    light = model.environmental_attribute("light")
    if not changed:
        model.quality_attribute("energy")
    camera = model.component(
        "camera", kind="lifecycle", always_improve=True, constraints=[light >= 0.05]
    )
    camera.configuration(
        "day", {"exposure": 0.01}, priority=1, constraints=[light >= (0.6 if changed else 0.5)]
    )
    camera.configuration("night", {"exposure": 0.2}, priority=3 if changed else 2)
    lidar = model.component("radar" if changed else "lidar")
    model.function("see").design("by camera", [camera], priority=1)
    model.function("range").design("by beam", [lidar], priority=1)
    model.action("inspect", requires=["see"])
    model.action("film" if changed else "chart", requires=["range"])
    return model


def store(*arguments):
    done = CliRunner().invoke(app, ["store", *map(str, arguments)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, " ".join(done.output.split())


@pytest.fixture
def path(tmp_path):
    """Return a store of a rover in the midst of something."""
    now, path = [0.0], tmp_path / "m.sqlite3"
    kb = KnowledgeBase(rover(), clock=lambda: now[0], store=path)
    for now[0] in (1.0, 2.0, 3.0):
        kb.measure("light", now[0] / 10)
        kb.measure("energy", now[0])
    kb.request_action("inspect")
    kb.request_action("chart")
    plan = PriorityPlanner().plan(kb)
    kb.component_active("camera", True)
    kb.component_active("lidar", True)
    kb.finish_plan(plan, "completed")
    kb.component_failed("lidar", "dust")
    kb.close()
    return path


def test_info_says_what_is_in_a_store(path):
    status, said = store("info", path)
    assert status == 0
    assert "model: rover" in said
    assert "last sound event: 13" in said
    assert "state: closed" in said
    assert "damage: none" in said
    assert "6 measure, " in said
    assert said.endswith("first time [s]: 1.0 last time [s]: 3.0")


def test_check_finds_a_flipped_bit_and_repair_writes_what_is_sound(path, tmp_path):
    assert store("check", path)[0] == 0
    content = path.read_bytes()
    place = content.rindex(b'["energy",3.0]')
    path.write_bytes(content[:place] + b'["energy",9.0]' + content[place + 14 :])
    damaged = path.read_bytes()
    status, said = store("check", path)
    assert status == 1
    assert "event 6 is not as it was written" in said
    assert store("info", path)[0] == 1
    with pytest.raises(
        StoreError, match=r"sound up to event 5, and 8 that were acknowledged after it are missing"
    ):
        KnowledgeBase(rover(), store=path)
    new = tmp_path / "new.sqlite3"
    status, said = store("repair", path, new)
    assert status == 0
    assert "up to event 5; 8 acknowledged events after it are missing" in said
    assert path.read_bytes() == damaged
    kb = KnowledgeBase(rover(), clock=lambda: 9.0, store=new)
    assert (kb.attributes["energy"].value, kb.attributes["light"].value) == (2.0, 0.3)
    assert (
        kb.store.events()[-1].text
        == "repaired: sound up to event 5; 8 acknowledged ones are missing"
    )
    kb.close()
    with pytest.raises(StoreError, match="there is a file already"):
        store("repair", path, new)


def test_log_that_is_deleted_after_a_kill_is_missed(path, tmp_path):
    kb = KnowledgeBase(rover(), clock=lambda: 9.0, store=path)
    kb.measure("energy", 4.0)
    assert kb.flush(10.0)
    killed = tmp_path / "killed.sqlite3"
    for end in ("", "-mark"):
        killed.with_name(f"killed.sqlite3{end}").write_bytes(
            path.with_name(f"m.sqlite3{end}").read_bytes()
        )
    kb.close()
    with pytest.raises(
        StoreError, match=r"event 14 was acknowledged, and is missing.*and 1 that were acknowledged"
    ):
        KnowledgeBase(rover(), store=killed)
    killed.with_name("killed.sqlite3-mark").unlink()
    with pytest.raises(
        StoreError, match="the mark of what was acknowledged, a file beside it, is missing"
    ):
        KnowledgeBase(rover(), store=killed)


def test_backup_while_it_is_written_to_has_all_that_was_acknowledged_by_then(path, tmp_path):
    kb = KnowledgeBase(rover(), store=path)
    done = threading.Event()

    def tell():
        number = 0
        while not done.is_set():
            kb.measure("energy", float(number := number + 1))
            if number % 50 == 0:
                kb.flush(10.0)

    teller = threading.Thread(target=tell)
    teller.start()
    try:
        for number in range(5):
            acknowledged, copy = kb.saved, tmp_path / f"copy {number}.sqlite3"
            assert store("backup", path, copy)[0] == 0
            with KnowledgeBaseOf(copy) as other:
                assert other.log.last >= acknowledged
                assert (
                    other.attributes["energy"].history
                    == kb.attributes["energy"].history[: len(other.attributes["energy"].history)]
                )
        assert store("check", path)[0] == 0
    finally:
        done.set()
        teller.join()
        kb.close()
    assert sorted(one.name for one in tmp_path.iterdir()) == [
        *(f"copy {number}.sqlite3" for number in range(5)),
        "m.sqlite3",
    ]


class KnowledgeBaseOf:
    def __init__(self, path):
        self.kb = KnowledgeBase(rover(), store=path)

    def __enter__(self):
        return self.kb

    def __exit__(self, *_):
        self.kb.close()


def test_migration_tells_what_changed_and_takes_over_the_rest(path, tmp_path):
    model = tmp_path / "rover.owl"
    rover(changed=True).save(model)
    before = path.read_bytes()
    status, said = store("migrate", path, model, "--dry-run")
    assert status == 0
    assert path.read_bytes()[:24] == before[:24]
    for words in (
        "component radar (",
        "attribute energy (",
        "priority 3) is not in the store",
        "priority 2) is in the store only",
        "constraint (attribute light, operator >=, value 0.6, constrained",
        "dropped: that component lidar is failed",
        "dropped: that action chart is requested",
        "dropped: what was measured of energy",
    ):
        assert words in said, said
    with pytest.raises(
        StoreError,
        match=r"of another model: .*action film .*is not in the store.*rosa store migrate",
    ):
        KnowledgeBase(Model.load(model), store=path)
    assert store("migrate", path, model)[0] == 0
    kb = KnowledgeBase(Model.load(model), clock=lambda: 9.0, store=path)
    assert kb.attributes["light"].history == ((1.0, 0.1), (2.0, 0.2), (3.0, 0.3))
    assert [one.action for one in kb.required_actions] == ["inspect"]
    assert [(one.action, one.result) for one in kb.history.actions] == [
        ("inspect", None),
        ("chart", "abandoned"),
    ]
    assert kb.components["camera"].is_active
    assert kb.components["camera"].selected_configuration == "night"
    assert kb.configurations["day"].status == "unfeasible"
    assert "the model was changed; " in kb.store.events()[-1].text
    kb.measure("light", 0.7)
    kb.close()
    assert "the model is that of the store" in store("migrate", path, model)[1]
    assert store("check", path)[0] == 0
    with pytest.raises(StoreError, match="of another model"):
        KnowledgeBase(rover(), store=path)


def test_what_is_no_store_is_an_error(tmp_path):
    (tmp_path / "diary").write_text("my diary" * 50)
    for command in ("info", "check"):
        with pytest.raises(StoreError, match="this is not a store"):
            store(command, tmp_path / "diary")
        with pytest.raises(StoreError, match=r"cannot be read: No such file or directory$"):
            store(command, tmp_path / "nowhere")
