"""The report on a campaign: the published table beside ours."""

import re
import xml.etree.ElementTree

import numpy as np
import pytest
from running import called

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign
from missions.experiments.comparison import holm, mean_of
from missions.experiments.report import write_report
from missions.experiments.results import Outcome, Results, Store, provenance
from missions.experiments.workers import crash

TABLE = Campaign("table", ("suave",), ("none", "bt", "rosa", "ours"), runs=12)


def outcome(run, **figures):
    """Return the outcome of a run; ours are those of the tree, but 1 m further."""
    rng = np.random.default_rng(run.seed)
    is_none = run.manager == "none"
    same = {name: getattr(run, name) for name in ("mission", "manager", "task", "seed")}
    delay_s = 1.25 if run.manager == "rosa" else 0.05 + rng.random() / 20
    record = {
        "run": run.name,
        **same,
        "settings": dict(run.settings),
        "outcome": "time_limit",
        "duration_s": 300.0,
        "search_time_s": round(rng.normal(175 if is_none else 84, 20)),
        "distance_inspected_m": 33.0 if is_none else 62.0 + rng.normal() + (run.manager == "ours"),
        "reactions": [] if is_none else [["U1", 35.0, delay_s]],
        **({"input_from_paper_service_s": 0.17} if run.manager == "rosa" else {}),
    }
    return Outcome(run.place, provenance()["code"], record | figures)


def results(folder, change=outcome, campaign=TABLE):
    with Store(folder, campaign) as store:
        for run in campaign.planned():
            if (done := change(run)) is not None:
                store.keep(done)
    return Results(folder)


def rows(text, heading):
    """Return the rows of the first table after a heading, by their first cells."""
    table = text.split(heading, 1)[1].split("\n\n|", 1)[1].split("\n\n", 1)[0]
    cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in table.splitlines()]
    return {first: rest for first, *rest in cells}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Write a report, and return its folder and its text."""
    folder = tmp_path_factory.mktemp("report")
    write_report(results(folder / "c"), folder / "report")
    return folder / "report", (folder / "report" / "report.md").read_text()


def test_published_table_stands_beside_ours_with_intervals(report):
    table = rows(report[1], "## suave")
    assert table["none"][2] == "174.75 ± 36.00"
    assert table["bt"][5] == "62.70 ± 7.78"
    assert table["ours (bt)"][2] == "-"
    assert "rosa*: service_s = 0.17 is an input taken from the paper's own figures" in report[1]
    for name in ("none", "bt", "rosa*", "ours (bt)"):
        numbers = re.fullmatch(r"(\S+) \[(\S+), (\S+)\]", table[name][3]).groups()
        mean, low, high = map(float, numbers)
        assert low < mean < high


def test_difference_of_runs_with_the_same_seed_is_shown(report):
    table = rows(report[1], "### Differences")
    row = table["distance inspected [m]: ours (bt) - bt"]
    assert row == ["12", "+1.00 [+1.00, +1.00]", "< 0.001"]
    assert table["search time [s]: ours (bt) - bt"][1:] == ["+0.00 [+0.00, +0.00]", "1.000"]
    assert not any("rosa* - bt" in name for name in table)


def test_reactions_stand_beside_the_published_ones(report):
    table = rows(report[1], "### Reaction times")
    assert table["U1, rosa*"] == ["12", "1.24", "1.250 [1.250, 1.250]", "1.250"]
    assert "U1, none" not in table


def test_pictures_are_files_and_part_of_the_page(report):
    folder, text = report
    names = {path.name for path in folder.glob("*.svg")}
    assert names == {"suave_search_time_s.svg", "suave_distance_inspected_m.svg"}
    assert all(f"({name})" in text for name in names)
    page = (folder / "report.html").read_text()
    assert page.count('src="data:image/svg+xml;base64,') == len(names)
    for name in names:
        xml.etree.ElementTree.parse(folder / name)


def test_runs_that_are_missing_or_crashed_are_counted(tmp_path):
    def change(run):
        if run.manager == "ours" and run.seed > 3:
            return None
        if run.manager == "bt" and run.seed == 1:
            return crash(run, "ValueError: a | b")
        return outcome(run, **({"search_time_s": None} if run.seed == 0 else {}))

    write_report(results(tmp_path / "c", change), tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "40 of 48 runs are done, 1 of them crashed" in text
    assert "- suave/bt/1: ValueError: a | b" in text
    assert "rosa run suave --manager bt --seed 1" in text
    table = rows(text, "## suave")
    assert (table["bt"][0], table["ours (bt)"][0]) == ("11", "4")
    assert "### Differences" not in text  # four runs are not compared
    assert re.fullmatch(r"[\d.]+", table["ours (bt)"][3])  # nor have they an interval


def test_own_mission_is_reported_by_its_own_figures(tmp_path):
    campaign = Campaign("own", ("rover:MISSION",), runs=3, sweep={"energy": ("1", "2")})

    def change(run):
        whole = outcome(run)
        names = ("run", "mission", "manager", "task", "seed", "settings")
        own = {name: whole.record[name] for name in names}
        own |= {"outcome": "explored_all", "duration_s": 90.0, "reactions": []}
        own["done_s"] = 50.0 if run.seed else None
        return Outcome(run.place, whole.code, own)

    store = results(tmp_path / "c", change, campaign)
    write_report(store, tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert text.count("## rover:MISSION with energy = ") == 2
    assert "50.00 ± 0.00 (2) |" in text
    assert "search time" not in text.split("## How it was computed")[0]
    write_report(store, tmp_path, figures=["done_s"])
    assert "done_s: mean [95 %]" in (tmp_path / "report.md").read_text()
    with pytest.raises(MissionError, match="no run has a figure 'done'; there are"):
        write_report(store, tmp_path, figures=["done"])


def test_nothing_to_report_is_an_error(tmp_path):
    with pytest.raises(MissionError, match="no run is done without a crash"):
        write_report(results(tmp_path / "b", lambda run: crash(run, "no")), tmp_path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere holds no campaign"),
        (["c", "--out", "c/campaign.json/x"], "cannot make c/campaign.json/x"),
    ],
)
def test_report_command_in_wrong_use_says_why(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    results(tmp_path / "c", campaign=Campaign("one", ("suave",), ("bt",), runs=1))
    code, _, err = called(capsys, monkeypatch, "report", *words)
    assert code == 2
    assert message in " ".join(err.split())


# ------------------------------------------------------------- statistics


def test_interval_holds_the_true_mean_as_often_as_it_says():
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        found = mean_of(rng.normal(1.0, 3.0, 8))
        hits += found.low <= 1.0 <= found.high
        assert (found.p < 0.05) is not (found.low <= 0.0 <= found.high)
    assert 180 <= hits <= 198
    assert mean_of([0.0, 0.0]) == (0.0, 0.0, 0.0, 1.0, 2)
    assert mean_of([2.0, 2.0]) == (2.0, 2.0, 2.0, 0.0, 2)


def test_holm_corrects_as_in_a_worked_example():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
