"""`rosa effort` as a person uses it: tables, marks, files, and one clear message for each mistake."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from py_trees.display import ascii_tree
from running import called

from kb import KnowledgeBase, Model
from missions import suave
from missions.baselines.modes import FUNCTIONS
from missions.engine.mission import MISSIONS, MissionError, Percepts, find_mission
from missions.experiments import effort
from missions.experiments.effort import (
    MODELS,
    MOST_ADAPTATIONS,
    TASK_NODES,
    TREES,
    count,
    count_tree,
    survey,
)
from missions.suave.model import suave_model

OWN = """
from dataclasses import replace
from missions import suave
from missions.experiments import effort

def fails(*given):
    raise RuntimeError("not today")

COPY = replace(suave.MISSION, name="copy")
NO_MODEL = replace(suave.MISSION, model=fails)
NO_TREE = replace(suave.MISSION, tree=fails)
OTHER = replace(suave.MISSION, model=lambda: 3)
"""


@pytest.fixture(scope="module")
def everything():
    return survey()


@pytest.fixture
def rosa(capsys, monkeypatch, tmp_path):
    """Run `rosa effort` in a folder with missions of one's own; returns exit status, output and errors."""
    (tmp_path / "effort_own.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)

    return partial(called, capsys, monkeypatch, "effort")


def row(text, name, *, table):
    """Return the cells of a row of the table that begins with a word."""
    lines = text[text.index(f"\n{table}" if table != "model" else table) :].splitlines()[1:]
    return next(line.split() for line in lines if line.split()[:1] == [name])


def published(parts):
    return f"{parts[0]} + {parts[1]} = {sum(parts)}"


def test_every_mission_is_counted_beside_what_is_published(rosa):
    code, out, _ = rosa()
    assert code == 0
    assert set(MODELS) == set(MISSIONS)
    for name, parts in MODELS.items():
        assert row(out, name, table="model") == [
            name,
            *map(str, (*parts, sum(parts))),
            *published(parts).split(),
        ]
    assert "entities: actions, functions" in out
    assert "relations: functional requirements" in out
    assert "agv: the vehicle's model, as in the paper" in out
    points = (MOST_ADAPTATIONS + 1) ** 2
    assert f"of {points} generated models, {points} have just that" in out


def test_counts_of_trees_that_differ_are_marked_and_explained(rosa):
    _, out, _ = rosa()
    for name, parts in TREES.items():
        cells = row(out, name, table="managed by")
        assert cells[3] == f"({TASK_NODES[name]})"
        assert " ".join(cells[7:12]) == published(parts)
        assert (cells[12:] == ["*"]) == (cells[4:6] != [*map(str, parts)])
    assert "* nodes: the published tree" in out
    assert "* modes: recharging adds 8" in out


def test_model_that_differs_from_the_published_one_is_marked(rosa, monkeypatch):
    monkeypatch.setattr(effort, "MODELS", {"uav": (24, 15)})
    code, out, _ = rosa("uav")
    assert code == 0
    assert "24 + 15 = 39 *" in out
    assert "* differs from the published count" in out


def test_tree_of_the_manager_is_counted_as_it_is_built(everything):
    for one in everything["trees"]:
        mission = find_mission(one["name"])
        task = mission.tree(KnowledgeBase(mission.model()), Percepts())
        assert one.items() >= count_tree(mission).items()
        assert one["task_nodes"] == len(ascii_tree(task).splitlines())
        assert one["total"] == one["nodes"] - one["task_nodes"] + one["modes"]
    assert [one["nodes"] for one in everything["trees"]] == [32, 32]
    assert [one["task_nodes"] for one in everything["trees"]] == [10, 14]


def test_modes_are_those_of_the_functions_that_the_mission_needs(everything):
    base, extended = (one["modes"] for one in everything["trees"])
    altitudes = 4  # only searching has a value beside `active`
    names = sum(len(modes) for _, modes in FUNCTIONS.values())
    assert extended == 2 * names + altitudes
    assert extended - base == 2 * len(FUNCTIONS["f_generate_recharge_path"][1])
    first, second = (TREES[one["name"]][1] for one in everything["trees"])
    assert extended - base == second - first


def test_missions_out_of_the_sea_have_no_tree_that_manages(rosa):
    _, out, _ = rosa("agv", "uav")
    assert "managed by a tree" not in out
    assert "by hand" not in out


def test_json_says_what_is_counted(rosa, everything):
    code, _, _ = rosa("--json", "effort.json")
    assert code == 0
    data = json.loads(Path("effort.json").read_text())
    assert data == json.loads(json.dumps(everything))
    assert [one["name"] for one in data["models"]] == list(MISSIONS)
    for one in data["models"]:
        assert sum(one["of_entities"].values()) == one["entities"] == one["published"]["entities"]
        assert (
            sum(one["of_relations"].values()) == one["relations"] == one["published"]["relations"]
        )
    assert len(data["generated"]) == (MOST_ADAPTATIONS + 1) ** 2
    assert all(one["total"] == one["law"] for one in data["generated"])


def test_models_in_files_and_missions_of_ones_own_are_counted(rosa):
    suave_model().save("saved.tql")
    suave_model().save("saved.owl")
    code, out, _ = rosa("saved.tql", "saved.owl", "effort_own:COPY")
    assert code == 0
    for name in ("saved.tql", "saved.owl", "effort_own:COPY"):
        assert row(out, name, table="model")[1:] == ["18", "12", "30", "-"]
    assert row(out, "effort_own:COPY", table="managed by")[-2:] == ["50", "-"]


def test_file_name_with_brackets_is_printed_as_it_is(rosa):
    suave_model().save("a[b].tql")
    _, out, _ = rosa("a[b].tql")
    assert row(out, "a[b].tql", table="model")[1:4] == ["18", "12", "30"]


def test_files_of_one_model_are_joined_by_commas(rosa):
    Path("base.tql").write_text("insert $f isa Function, has function-name 'see';\n")
    Path("more.tql").write_text(
        "match $f isa Function, has function-name 'see';\n"
        "insert $a isa Action, has action-name 'look';\n"
        "(action: $a, required-function: $f) isa functional-requirement;\n"
    )
    code, out, _ = rosa("base.tql,more.tql")
    assert code == 0
    assert row(out, "base.tql,more.tql", table="model")[1:4] == ["2", "1", "3"]


def test_model_asked_for_twice_is_counted_once(everything):
    assert survey(["uav", "uav"])["models"] == [
        one for one in everything["models"] if one["name"] == "uav"
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["suaev"], "unknown mission 'suaev'; there are suave"),
        (["missing.tql"], "missing.tql: there is no such file"),
        (["effort_own:NONE"], "cannot import mission 'effort_own:NONE'"),
        (
            ["effort_own:NO_MODEL"],
            "cannot build the model of effort_own:NO_MODEL: RuntimeError: not today",
        ),
        (["effort_own:NO_TREE"], "cannot build the tree of suave: RuntimeError: not today"),
        (["effort_own:OTHER"], "the model of effort_own:OTHER is 3, not a Model"),
        (["uav", "--json", "nowhere/effort.json"], "cannot write nowhere/effort.json"),
        (["--frobnicate"], "No such option"),
    ],
)
def test_mistake_is_one_clear_message(rosa, arguments, message):
    code, _, err = rosa(*arguments)
    assert code == 2
    assert message in err.replace("\n", " ")


def test_nothing_is_written_when_a_model_cannot_be_read(rosa, tmp_path):
    before = sorted(tmp_path.iterdir())
    code, _, _ = rosa("uav", "missing.tql", "--json", "effort.json")
    assert code == 2
    assert sorted(tmp_path.iterdir()) == before


def test_mission_that_the_sea_cannot_open_is_a_clear_error():
    with pytest.raises(MissionError, match="unknown setting 'no_such_setting'"):
        count_tree(replace(suave.MISSION, fixed={"no_such_setting": "1"}))


def test_empty_model_is_counted(tmp_path):
    Model("empty").save(tmp_path / "empty.tql")
    found = survey([str(tmp_path / "empty.tql")])
    assert found["models"][0].items() >= count(Model("empty")).items()
