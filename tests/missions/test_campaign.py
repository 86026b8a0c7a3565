"""Campaigns: what they unfold into, the same results whoever does them, and nothing lost however they end."""

import csv
import json
import os
import resource
import shlex
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import asdict
from functools import cache
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from missions import cli
from missions.baselines import MANAGERS
from missions.engine.mission import MissionError
from missions.experiments.campaign import (
    FILE,
    Campaign,
    Outcome,
    PlannedRun,
    Store,
    from_data,
    paper_table,
    provenance,
    read_store,
)
from missions.experiments.workers import do
from missions.views.console import CampaignProgress

ROOT = Path(__file__).parents[2]
SMALL = """
name = "small"
missions = ["suave"]
managers = ["none", "bt", "ours"]
runs = 2
rules = "2024"

[settings]
duration_s = 20

[sweep]
bias = [0, 1.0]
"""
RUNS = 3 * 2 * 2
TABLES = ("runs.csv", "reactions.csv")


@pytest.fixture
def quick(capsys, monkeypatch):
    """Run the command line in this process; returns exit status, output and errors."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["rosa", *map(str, arguments)])
        monkeypatch.setattr(sys, "path", [*sys.path])
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        captured = capsys.readouterr()
        return code, captured.out, " ".join(captured.err.split())

    return run


NEVER_SYNCED = """
from missions.cli import main
from missions.experiments import campaign

campaign.SYNC_S = float("inf")
main()
"""
"""On a slow machine each run would be synced before the next, and the file beside the store would never be full."""


def rosa(*arguments, cwd, most_bytes=None):
    """Start the command line in a process of its own, perhaps on a disk with little room."""

    def limit():
        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))

    program = ["-m", "missions"] if most_bytes is None else ["-c", NEVER_SYNCED]
    command = [sys.executable, *program, *map(str, arguments)]
    settings = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, preexec_fn=limit, env=settings, cwd=cwd, **pipes)


def finish(running, code=0):
    """Wait until a command has ended, as it should, and return what it printed."""
    out, err = running.communicate()
    assert running.returncode == code, out + err
    return out


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Return the file of a small campaign, and what two workers made of it."""
    folder = tmp_path_factory.mktemp("campaign")
    file = folder / "small.toml"
    file.write_text(SMALL)
    finish(rosa("campaign", file, "--workers", 2, "--out", folder / "two", cwd=folder))
    return file, folder / "two"


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


def lines(folder):
    return list(read_store(folder).records) if (folder / FILE).exists() else []


def begun_with(folder):
    """Return what a campaign that is perhaps about to begin holds."""
    try:
        return lines(folder)
    except MissionError:
        return []


def timings(folder):
    return {record["run"]: timing for record, timing in read_store(folder).rows()}


WORDS = st.lists(st.sampled_from("abcdefgh"), min_size=1, max_size=3, unique=True).map(tuple)
CAMPAIGNS = st.builds(
    Campaign,
    name=st.just("any"),
    missions=WORDS,
    managers=st.lists(st.sampled_from(["ours", "bt", "none"]), min_size=1, unique=True).map(tuple),
    tasks=st.sampled_from([("bt",), ("pddl",), ("bt", "pddl")]),
    runs=st.integers(1, 3),
    first_seed=st.integers(0, 5),
    settings=st.dictionaries(st.sampled_from(["a", "b"]), st.sampled_from(["1", "x"])),
    cases=st.lists(
        st.fixed_dictionaries({"c": st.sampled_from("123")}), max_size=3, unique_by=repr
    ).map(tuple),
    sweep=st.dictionaries(
        st.sampled_from(["d", "e"]), st.lists(st.sampled_from("123"), min_size=1, unique=True)
    ),
)


@given(CAMPAIGNS)
def test_every_run_has_a_name_of_its_own_and_managers_meet_the_same_seeds(campaign):
    planned = list(campaign.planned())
    assert len({run.name for run in planned}) == len(planned)
    assert [run.place for run in planned] == list(range(len(planned)))
    layers = len(campaign.managers) + ("ours" in campaign.managers) * (len(campaign.tasks) - 1)
    assert len(planned) == len(campaign.missions) * len(campaign.variants) * layers * campaign.runs
    by_manager = {}
    for run in planned:
        by_manager.setdefault(run.manager, set()).add(run.seed)
    assert len(set(map(frozenset, by_manager.values()))) == 1


@given(CAMPAIGNS)
def test_campaign_is_the_same_after_it_was_written_and_read(campaign):
    data = json.loads(json.dumps(asdict(campaign)))
    assert list(from_data(data, "here").planned()) == list(campaign.planned())
    assert json.loads(json.dumps(asdict(from_data(data, "here")))) == data


def test_seed_of_a_run_stands_in_its_name_and_in_what_does_it_again():
    run = PlannedRun("suave", "ours", "pddl", 7, (("bias", "0"), ("start_y", "2.8")))
    assert run.name == "suave/ours/pddl/bias=0,start_y=2.8/7"
    assert (
        run.command
        == "rosa run suave --manager ours --task pddl --seed 7 --set bias=0 --set start_y=2.8"
    )


def test_paper_table_has_both_missions_under_every_manager_a_hundred_times():
    planned = list(paper_table().planned())
    layers = {(run.manager, run.task) for run in planned}
    assert layers == {*((name, None) for name in MANAGERS), ("ours", "bt"), ("ours", "pddl")}
    assert len(planned) == 100 * 2 * len(layers)
    assert {run.mission for run in planned} == {"suave", "suave_extended"}


def test_results_are_the_same_to_the_byte_on_any_number_of_workers(quick, small, tmp_path):
    file, two = small
    assert quick("campaign", file, "--workers", 1, "--out", tmp_path)[0] == 0
    assert tables(tmp_path) == tables(two)
    assert len(lines(tmp_path)) == RUNS


def test_tables_hold_what_the_runs_gave(small):
    _, folder = small
    records = {one["run"]: one for one in lines(folder)}
    with (folder / "runs.csv").open(newline="") as file:
        rows = {row["run"]: row for row in csv.DictReader(file)}
    assert list(rows) == [run.name for run in read_store(folder).campaign.planned()]
    for name, row in rows.items():
        record = records[name]
        assert row["set_bias"] == record["settings"]["bias"]
        assert row["search_time_s"] == (
            "" if record["search_time_s"] is None else str(record["search_time_s"])
        )
        assert float(row["violation_s"]) == record["violation_s"]
    assert [run["run"] for run in json.loads((folder / "runs.json").read_text())] == list(rows)
    with (folder / "reactions.csv").open(newline="") as file:
        assert (
            len(list(csv.DictReader(file)))
            == sum(len(record["reactions"]) for record in records.values())
            > 0
        )


def test_record_of_a_run_is_what_its_command_line_gives(quick, small, tmp_path):
    record = next(one for one in lines(small[1]) if one["manager"] == "bt" and one["seed"] == 1)
    run = next(run for run in read_store(small[1]).campaign.planned() if run.name == record["run"])
    found = 0 if record["search_time_s"] else 1
    assert (
        quick(*shlex.split(run.command)[1:], "--no-progress", "--json", tmp_path / "again.json")[0]
        == found
    )
    again = json.loads((tmp_path / "again.json").read_text())
    assert {key: again[key] for key in ("seed", "violation_s", "switches", "energy_j")} == {
        key: record[key] for key in ("seed", "violation_s", "switches", "energy_j")
    }


def assert_gone_on_with(quick, folder, two, *given):
    """Go on with a campaign that something has stopped: nothing is lost, repeated or other than without that."""
    before = timings(folder)
    code, out, err = quick("campaign", *given, "--resume", "--workers", 1, "--out", folder)
    assert (code, f"{RUNS - len(before)} of them now" in out) == (0, True), out + err
    after = timings(folder)
    assert len(after) == RUNS
    assert {run: after[run] for run in before} == before  # not done again
    assert tables(folder) == tables(two)
    return len(before)


def test_killed_campaign_goes_on_without_losing_or_repeating_a_run(quick, small, tmp_path):
    file, two = small
    folder = tmp_path / "killed"
    running = rosa("campaign", file, "--workers", 2, "--out", folder, cwd=tmp_path)
    while running.poll() is None and len(begun_with(folder)) <= 2:
        time.sleep(0.02)
    running.kill()
    running.communicate()  # returns when its workers have ended, too
    assert assert_gone_on_with(quick, folder, two) > 2


def test_campaign_on_a_full_disk_says_so_and_goes_on_when_there_is_room(quick, small, tmp_path):
    file, two = small
    folder = tmp_path / "full"
    _, said = rosa(
        "campaign", file, "--workers", 1, "--out", folder, cwd=tmp_path, most_bytes=33_000
    ).communicate()
    assert "make room, then go on with --resume" in " ".join(said.split())
    assert "Traceback" not in said
    assert 0 < assert_gone_on_with(quick, folder, two, file) < RUNS


def test_campaign_that_is_done_is_done(quick, small):
    file, two = small
    before = tables(two)
    assert (
        f"{RUNS} of {RUNS} runs done, 0 of them now"
        in quick("campaign", file, "--resume", "--out", two)[1]
    )
    assert tables(two) == before


CLUMSY = """
import os, sys

from missions.baselines import Manager


class Clumsy(Manager):
    def update(self):
        if self.robot.now > 1:
            {trouble}
"""
TROUBLE = """[lambda: None, lambda: 1 / 0, lambda: os._exit(9), lambda: sys.exit("enough")][
                int(self.robot.settings.start_y_m)
            ]()"""


def test_run_that_crashes_is_recorded_and_the_others_go_on(quick, tmp_path, monkeypatch):
    (tmp_path / "clumsy.py").write_text(CLUMSY.format(trouble=TROUBLE))
    (tmp_path / "c.toml").write_text(
        'missions = ["suave"]\nmanagers = ["clumsy:Clumsy"]\nruns = 1\nfirst_seed = 1\n'
        "[settings]\nduration_s = 5\n[sweep]\nstart_y = [0, 1, 2, 3]\n"
    )
    out = finish(rosa("campaign", "c.toml", "--workers", 2, "--out", "c", cwd=tmp_path), 1)
    assert "4 of 4 runs done" in out
    folder = tmp_path / "c"
    crashed = {record["run"]: record["error"] for record in read_store(folder).crashed}
    divided = "ZeroDivisionError: division by zero; clumsy.py, line 10"
    raised = (
        f"MissionError: mission suave under manager clumsy:Clumsy failed after 1.02 s: {divided}"
    )
    errors = {1: raised, 2: "the process that ran it died", 3: "SystemExit: enough"}
    assert crashed == {
        f"suave/clumsy:Clumsy/duration_s=5,start_y={y}/1": error for y, error in errors.items()
    }
    assert (
        "rosa run suave --manager clumsy:Clumsy --seed 1 --set duration_s=5 --set start_y=2" in out
    )
    with closing(sqlite3.connect(folder / FILE)) as file:
        tracebacks = [
            text for (text,) in file.execute("SELECT traceback FROM runs WHERE outcome = 'crashed'")
        ]
    assert sum("ZeroDivisionError" in text for text in tracebacks) == 1
    assert len(lines(folder)) == 4

    (tmp_path / "clumsy.py").write_text(CLUMSY.format(trouble="pass"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "clumsy", raising=False)
    for options, now in (([], 0), (["--retry"], 3)):  # a run that crashed is done too
        code, out, err = quick(
            "campaign", "c.toml", "--resume", *options, "--workers", 1, "--out", "c"
        )
        assert (code, f"4 of 4 runs done, {now} of them now" in out) == (0, True), out + err
    assert not read_store(folder).crashed


def test_folder_of_results_imports_nothing_by_itself(tmp_path, quick, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.py").write_text("open('imported', 'w').close()\nMANAGER = object\n")
    given = Campaign("theirs", ("suave",), ("theirs:MANAGER",))
    with Store(tmp_path / "c", given):
        pass
    code, _, err = quick("campaign", "--resume", "--out", "c")
    assert code == 2
    assert "would import theirs, because a file of results says so" in err
    assert "rosa campaign FILE.toml --resume --out c" in err
    assert quick("report", "c")[0] == 2
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('mission = ["suave"]', "unknown key 'mission'; did you mean missions?"),
        (
            'missions = ["suave"]\nquux = 1',
            "unknown key 'quux'; there are name, missions, managers",
        ),
        ("runs = 3", "says no missions"),
        ('missions = "suave"', "missions is 'suave'; expected is a list"),
        ("missions = []", "missions is []; expected is a list of one name or more"),
        ('missions = ["suaf"]', "unknown mission 'suaf'; there are suave"),
        ('missions = ["suave"]\nmanagers = ["bd"]', "unknown manager 'bd'; there are ours"),
        ('missions = ["suave"]\ntasks = ["xml"]', "unknown task layer 'xml'"),
        ('missions = ["suave"]\nruns = 0', "runs is 0; expected is a whole number from 1"),
        ('missions = ["suave"]\nruns = true', "runs is True"),
        (
            'missions = ["suave"]\nfirst_seed = -1',
            "first_seed is -1; expected is a whole number from 0",
        ),
        ('missions = ["suave", "suave"]', "missions has suave twice"),
        ('missions = ["suave"]\n[sweep]\nbias = []', "sweep is {'bias': []}"),
        (
            'missions = ["suave"]\n[sweep]\nbias = 1',
            "sweep is {'bias': 1}; expected is a table of names, each with a list",
        ),
        ('missions = ["suave"]\n[sweep]\nbias = [[1]]', "sweep is {'bias': [[1]]}; expected"),
        (
            'missions = ["suave"]\n[settings]\nbais = 1',
            "unknown setting 'bais' of mission suave; did you mean bias",
        ),
        ('missions = ["suave"]\n[settings]\nduration_s = -1', "duration_s is '-1'"),
        ('missions = ["suave"]\n[sweep]\nmass_kg = [1, -1]', "mass_kg"),
        ('missions = ["suave"]\nrules = "2023"', "there are no rules '2023'"),
        (
            'missions = ["suave"]\n[settings]\nbias = 0\n[sweep]\nbias = [1]',
            "bias is given in settings and in sweep",
        ),
        (
            'missions = ["suave"]\n[sweep]\nbias = [1]\n[[cases]]\nbias = 0',
            "bias is given in sweep and in cases",
        ),
        ('missions = ["suave"]\nname = "../up"', "name is '../up'"),
        ('missions = ["suave"', "c.toml is no TOML"),
    ],
)
def test_file_that_is_wrong_is_refused_before_anything_runs(
    tmp_path, monkeypatch, quick, text, message
):
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(text)
    code, out, err = quick("campaign", "c.toml")
    assert code == 2
    assert message in err
    assert out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.toml"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.toml"], "cannot read none.toml: No such file"),
        ([], "say what to run: FILE.toml or --paper-table, or --resume --out DIR"),
        (["--resume"], "say what to run"),
        (["--runs", "3"], "--runs goes with FILE.toml or --paper-table"),
        (["--paper-table", "--runs", "0"], "a campaign of 0 runs does nothing"),
        (["c.toml", "--paper-table"], "give either FILE.toml or --paper-table"),
        (["c.toml", "--workers", "2", "--cluster", "x:1"], "not both"),
        (["c.toml", "--retry"], "--retry goes with --resume"),
        (["--resume", "--out", "nowhere"], "there is no folder nowhere"),
        (["--resume", "--out", "."], ". holds no campaign: there is no campaign.sqlite3"),
        (["c.toml", "--out", "c.toml/in"], "cannot make c.toml/in: Not a directory"),
        (["c.toml", "--workers", "0"], "--workers"),
    ],
)
def test_wrong_use_is_one_clear_message(tmp_path, monkeypatch, quick, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(SMALL)
    code, _, err = quick("campaign", *arguments)
    assert code == 2
    assert message in err


def begun(folder, text=SMALL):
    """Begin a campaign and keep one run of it."""
    file = folder.with_suffix(".toml")
    file.write_text(text)
    data = Campaign("small", ("suave",), ("none",), runs=2, settings={"duration_s": "1"})
    with Store(folder, data) as store:
        store.keep(first())
    return data


@cache
def first() -> Outcome:
    return do(
        next(
            Campaign("small", ("suave",), ("none",), runs=2, settings={"duration_s": "1"}).planned()
        )
    )


def test_folder_that_holds_another_campaign_is_left_alone(tmp_path, quick):
    data = begun(tmp_path / "c")
    code, _, err = quick("campaign", tmp_path / "c.toml", "--out", tmp_path / "c")
    assert code == 2
    assert "holds a campaign already; go on with it by --resume" in err
    code, _, err = quick("campaign", tmp_path / "c.toml", "--resume", "--out", tmp_path / "c")
    assert code == 2
    assert "holds another campaign: its managers is ['none'], not ['none', 'bt', 'ours']" in err
    assert read_store(tmp_path / "c").campaign == data
    assert len(lines(tmp_path / "c")) == 1


def test_folder_is_held_by_one_program_at_a_time(tmp_path, quick):
    begun(tmp_path / "c")
    with Store(tmp_path / "c", None, resume=True):
        code, _, err = quick("campaign", "--resume", "--out", tmp_path / "c")
    assert code == 2
    assert "another program is running the campaign" in err


def test_results_of_different_code_are_never_mixed(tmp_path, quick):
    begun(tmp_path / "c")
    with Store(tmp_path / "c", None, resume=True) as store:
        strange = Outcome(next(store.campaign.planned()), "other", {"run": "x", "outcome": "y"})
        with pytest.raises(
            MissionError, match=r"was run by other code \(other\) than the campaign"
        ):
            store.keep(strange)
    with closing(sqlite3.connect(tmp_path / "c" / FILE)) as file, file:
        file.execute("UPDATE about SET provenance = json_set(provenance, '$.code', 'older')")
    code, _, err = quick("campaign", "--resume", "--out", tmp_path / "c")
    assert code == 2
    assert f"was begun with code older, here is {provenance()['code']}" in err
    assert "results of different versions cannot be mixed" in err


def test_what_npm_has_installed_is_no_code_of_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "missions.experiments.campaign.__file__",
        str(tmp_path / "missions" / "experiments" / "it.py"),
    )
    installed = tmp_path / "missions" / "node_modules"
    installed.mkdir(parents=True)
    before = provenance.__wrapped__()
    (installed / "theirs.js").touch()
    assert provenance.__wrapped__() == before
    (tmp_path / "missions" / "ours.py").touch()
    assert provenance.__wrapped__()["code"] != before["code"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.write_bytes(b"nonsense" * 1000), "is damaged: file is not a database"),
        (lambda path: path.write_bytes(b""), "is damaged: no such table"),
        (lambda path: altered(path, "DELETE FROM about"), "is damaged"),
        (lambda path: altered(path, "UPDATE about SET format = 9"), "has format 9; this version"),
    ],
)
def test_damaged_file_is_told(tmp_path, damage, message):
    begun(tmp_path / "c")
    damage(tmp_path / "c" / FILE)
    with pytest.raises(MissionError, match=message):
        read_store(tmp_path / "c")


def altered(path, query):
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(query)


def test_folder_that_cannot_be_written_can_be_read(tmp_path, monkeypatch):
    campaign, path = begun(tmp_path / "c"), tmp_path / "c" / FILE
    before = lines(tmp_path / "c")
    for one in (path, path.parent):
        one.chmod(0o444 if one is path else 0o555)
    monkeypatch.setattr(
        "missions.experiments.campaign.os.access", lambda *_: False
    )  # as nobody's, whoever tests
    assert read_store(tmp_path / "c").campaign == campaign
    assert lines(tmp_path / "c") == before
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(
        MissionError, match=r"cannot write to .*: attempt to write a readonly database"
    ):
        Store(tmp_path / "c", None, resume=True)
    path.parent.chmod(0o755)


def test_damaged_run_is_told_when_it_is_read(tmp_path):
    begun(tmp_path / "c")
    content = (tmp_path / "c" / FILE).read_bytes()
    (tmp_path / "c" / FILE).write_bytes(content[:8192] + bytes(len(content) - 8192))
    with pytest.raises(
        MissionError, match=r"cannot read .*campaign.sqlite3: database disk image is malformed"
    ):
        lines(tmp_path / "c")


def test_results_are_put_on_disk_once_a_second_and_at_the_end(tmp_path, monkeypatch):
    synced, now = [], [0.0]
    monkeypatch.setattr("missions.experiments.campaign.monotonic", lambda: now[0])
    opened = sqlite3.connect

    def watched(*given, **named):
        file = opened(*given, **named)
        file.set_trace_callback(
            lambda said: synced.append(now[0]) if "checkpoint" in said else None
        )
        return file

    monkeypatch.setattr(sqlite3, "connect", watched)
    campaign = Campaign("many", ("suave",), runs=50)
    with Store(tmp_path / "c", campaign) as store:
        for run in campaign.planned():
            now[0] += 0.1
            store.keep(
                Outcome(
                    run, provenance()["code"], {"run": run.name, "outcome": "x"}, {"run": run.name}
                )
            )
            assert lines(tmp_path / "c")[-1]["run"] == run.name  # what a kill cannot take any more
    each = dict.fromkeys(synced)
    assert 5 <= len(each) <= 7
    assert len(lines(tmp_path / "c")) == 50


def test_bar_shows_how_far_how_fast_and_how_long():
    shown = StringIO()
    teller = CampaignProgress(Console(file=shown, force_terminal=True, width=120))
    with teller.progress:
        teller.begin(1, 4)
        teller.done(first().record)
        teller.note("no worker is left")
        teller.progress.refresh()
    text = shown.getvalue()
    for part in ("2/4", "a second", "left", first().run.name, "no worker is left"):
        assert part in text
