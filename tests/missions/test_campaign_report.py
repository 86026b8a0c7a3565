"""The report on a campaign: the published table beside ours, and what it says of runs that are missing or strange."""

import re
import sys
import tracemalloc
import xml.etree.ElementTree

import numpy
import pytest

from missions import cli
from missions.engine.mission import MissionError
from missions.experiments.campaign import (
    Campaign,
    Outcome,
    Store,
    provenance,
    read_store,
    write_tables,
)
from missions.experiments.comparison import comparisons
from missions.experiments.report import Document, write_report
from missions.experiments.workers import crash

TABLE = Campaign("table", ("suave",), ("none", "bt", "rosa", "ours"), runs=20)


def outcome(run, **figures):
    """Return the outcome of a run with figures as the paper has them; ours are those of the tree, but 1 m further."""
    rng = numpy.random.default_rng(run.seed)
    slow = run.manager == "none"
    search = (
        (round(rng.normal(130 if run.seed % 2 else 210, 5))) if slow else round(rng.normal(84, 20))
    )
    record = {
        **{
            "run": run.name,
            "mission": run.mission,
            "manager": run.manager,
            "task": run.task,
            "seed": run.seed,
        },
        **{
            "settings": dict(run.settings),
            "outcome": "time_limit",
            "duration_s": 300.0,
            "search_time_s": search,
        },
        "distance_inspected_m": 33.0 if slow else 62.0 + rng.normal() + (run.manager == "ours"),
        "reactions": []
        if slow
        else [["U1", 35.0, 1.25 if run.manager == "rosa" else 0.05 + rng.random() / 20]],
        **({"input_from_paper_service_s": 0.17} if run.manager == "rosa" else {}),
    }
    timing = {"run": run.name, "wall_s": 0.5, "reactions": [] if slow else [["U1", 0.002]]}
    return Outcome(run, provenance()["code"], record | figures, timing)


def kept(folder, change=lambda run: outcome(run), campaign=TABLE):
    with Store(folder, campaign) as store:
        for run in campaign.planned():
            found = change(run)
            if found is not None:
                store.keep(found)
    return read_store(folder)


def rows(text, heading):
    """Return the cells of the first table after a heading."""
    table = text.split(heading, 1)[1].split("\n\n|", 1)[1].split("\n\n", 1)[0]
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in table.splitlines()]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Write a report, and return its folder."""
    folder = tmp_path_factory.mktemp("report")
    write_report(kept(folder / "c"), folder / "report")
    return folder / "report"


def test_published_table_stands_beside_ours_with_intervals(report):
    table = {row[0]: row for row in rows((report / "report.md").read_text(), "## suave")}
    assert table["none"][2] == "174.75 ± 36.00"
    assert table["bt"][5] == "62.70 ± 7.78"
    assert table["ours (bt)"][2] == "-"
    for name in ("none", "bt", "rosa*", "ours (bt)"):
        mean, low, high = map(
            float, re.fullmatch(r"(\S+) \[(\S+), (\S+)\]", table[name][3]).groups()
        )
        assert low < mean < high


def test_what_was_taken_from_the_paper_is_marked_wherever_it_shows(report):
    text = (report / "report.md").read_text()
    assert "rosa*: service_s = 0.17 is an input taken from the paper's own figures" in text
    assert not re.search(
        r"\brosa\b(?!\*|_)", text.split("## suave")[1].split("## How it was computed")[0]
    )
    assert "* figures of the paper are put in" in text_of(report / "suave_search_time_s.svg")


def text_of(path):
    """Return what a picture says; its letters are shapes, each text stands before them as a comment."""
    return "\n".join(re.findall(r"<!-- (.*?) -->", path.read_text()))


def test_difference_of_runs_with_the_same_seed_is_found(report):
    table = {row[0]: row for row in rows((report / "report.md").read_text(), "### Differences")}
    row = table["distance inspected [m]: ours (bt) - bt"]
    assert row[1:3] == ["20", "+1.00 [+1.00, +1.00]"]
    assert table["search time [s]: ours (bt) - bt"][2:] == ["+0.00 [+0.00, +0.00]", "1.000"]
    assert table["search time [s]: ours (bt) - none"][3] == "< 0.001"
    assert not any("rosa* - bt" in name for name in table)


def test_two_clusters_of_search_times_are_told_and_shown(report):
    table = {
        row[0]: row
        for row in rows((report / "report.md").read_text(), "### Distribution: search time [s]")
    }
    earlier, later = (float(re.match(r"\d+", cell).group()) for cell in table["none"][1:3])
    assert (earlier, later) == pytest.approx((130, 210), abs=4)
    assert table["none"][4].endswith(", clear")
    said = text_of(report / "suave_search_time_s.svg")
    assert "50% around" in said
    assert "search time [s]" in said


def test_reactions_are_told_in_two_parts(report):
    table = {row[0]: row for row in rows((report / "report.md").read_text(), "### Reaction times")}
    assert table["U1, rosa*"][2:4] == ["1.24", "1.250 [1.250, 1.250]"]
    assert table["U1, bt"][6] == "2.00"
    assert "U1, none" not in table


def test_pictures_stand_beside_the_text_and_the_page_needs_none_of_them(report):
    names = {path.stem for path in report.glob("*.svg")}
    assert names == {"suave_search_time_s", "suave_distance_inspected_m", "suave_reactions"}
    text, page = (report / "report.md").read_text(), (report / "report.html").read_text()
    assert all(f"({name}.svg)" in text for name in names)
    assert page.count('src="data:image/svg+xml;base64,') == len(names)
    for path in report.glob("*.svg"):
        xml.etree.ElementTree.parse(path)


def test_same_results_give_the_same_report_to_the_byte(report, tmp_path):
    write_report(kept(tmp_path / "c"), tmp_path / "report")
    for path in report.iterdir():
        assert path.read_bytes() == (tmp_path / "report" / path.name).read_bytes()


def test_runs_that_are_missing_crashed_or_never_found_are_told(tmp_path):
    def change(run):
        if run.manager == "ours" and run.seed > 2:
            return None
        if run.manager == "bt" and run.seed == 1:
            return crash(run, "ValueError: a | b")
        return outcome(run, **({"search_time_s": None} if run.seed == 0 else {}))

    write_report(kept(tmp_path / "c", change), tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "63 of 80 runs are done, 1 of them crashed" in text
    assert "17 runs are still to be done" in text
    assert "- suave/bt/1: ValueError: a | b" in text
    assert "rosa run suave --manager bt --seed 1" in text
    table = {row[0]: row for row in rows(text, "## suave")}
    assert (table["bt"][1], table["bt"][-1], table["ours (bt)"][1]) == ("19", "1", "3")


def test_mission_of_ones_own_is_reported_by_its_own_figures(tmp_path):
    campaign = Campaign("own", ("rover:MISSION",), runs=3, sweep={"energy": ("1", "2")})

    def change(run):
        record = {
            **{
                "run": run.name,
                "mission": run.mission,
                "manager": "ours",
                "task": "bt",
                "seed": run.seed,
            },
            **{
                "settings": dict(run.settings),
                "outcome": "explored_all",
                "duration_s": 90.0 + run.seed,
            },
            **{"explored_m": 100.0, "done_s": 50.0 if run.seed else None, "reactions": []},
        }
        return Outcome(run, provenance()["code"], record, {})

    write_report(kept(tmp_path / "c", change, campaign), tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert text.count("## rover:MISSION with energy = ") == 2
    assert "100.00 ± 0.00 |" in text
    assert "50.00 ± 0.00 (2) |" in text
    assert "search time" not in text.split("## How it was computed")[0]
    assert (tmp_path / "rover_MISSION_with_energy_1_explored_m.svg").exists()
    store = read_store(tmp_path / "c")
    write_report(store, tmp_path, figures=["done_s"])
    assert (
        "| manager | runs | goal reached | done_s: mean [95 %] | sd [95 %] |"
        in (tmp_path / "report.md").read_text()
    )
    with pytest.raises(
        MissionError, match="no run has a figure 'done'; there are duration_s, explored_m, done_s"
    ):
        write_report(store, tmp_path, figures=["done"])


def test_a_run_takes_few_bytes_while_tables_and_report_are_made_of_a_million(tmp_path):
    campaign = Campaign("many", ("suave",), ("bt", "ours"), runs=600)
    store = kept(tmp_path, campaign=campaign)
    tracemalloc.start()
    try:
        again = read_store(tmp_path)
        places, _ = tracemalloc.get_traced_memory()
        parts = comparisons(again)
        whole, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        write_tables(again, tmp_path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    runs = len(again.done())
    assert runs == 1200
    assert [group.runs for part in parts for group in part.groups] == [600, 600]
    assert places / runs < 40
    assert whole / runs < 200
    assert (most - whole) / runs < 300  # of it 150 kB for the files that are open
    assert list(store.rows()) == list(again.rows())


def test_single_run_has_no_spread(tmp_path):
    campaign = Campaign("one", ("suave",), ("bt",), runs=1)
    write_report(kept(tmp_path / "c", campaign=campaign), tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert rows(text, "## suave")[2][1] == "1"
    assert "| sd [95 %]" not in text
    assert "nan" not in text


def test_nothing_to_report_is_said(tmp_path):
    with pytest.raises(MissionError, match="none of its runs is done"):
        write_report(kept(tmp_path / "a", lambda run: None), tmp_path)
    with pytest.raises(MissionError, match="all of its 80 runs crashed"):
        write_report(kept(tmp_path / "b", lambda run: crash(run, "no")), tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["nowhere"],
            "there is no folder nowhere; `rosa campaign FILE.toml --out nowhere` makes one",
        ),
        (["."], ". holds no campaign"),
        (["c", "--out", "c/campaign.sqlite3/x"], "cannot make c/campaign.sqlite3/x"),
    ],
)
def test_wrong_use_is_one_clear_message(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    kept(tmp_path / "c", campaign=Campaign("one", ("suave",), ("bt",), runs=1))
    monkeypatch.setattr(sys, "argv", ["rosa", "report", *arguments])
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_results_are_reported_as_far_as_they_go_while_runs_are_done(tmp_path):
    planned = list(TABLE.planned())
    with Store(tmp_path / "c", TABLE) as store:
        for run in planned[30], planned[0]:
            store.keep(outcome(run))
        write_report(read_store(tmp_path / "c"), tmp_path)
    assert "2 of 80 runs are done" in (tmp_path / "report.md").read_text()
    records = read_store(tmp_path / "c").records
    assert [record["run"] for record in records] == [planned[0].name, planned[30].name]


def test_document_escapes_what_would_be_taken_for_markup():
    document = Document("a < b")
    document.table(["x|y", "<z>"], [["1", "2"]])
    assert "&#124;" in document.as_markdown()
    page = document.as_html()
    assert "<h1>a &lt; b</h1>" in page
    assert "&lt;z&gt;</th>" in page
    assert "<z>" not in page


def test_runs_that_stand_out_have_pages_that_the_report_links_to(tmp_path):
    campaign = Campaign("small", ("suave",), ("none", "ours"), runs=3, settings={"duration": "20"})
    written = write_report(kept(tmp_path / "c", campaign=campaign), tmp_path / "report", pages=True)
    text = (
        (tmp_path / "report" / "report.md")
        .read_text()
        .split("## Runs that stand out")[1]
        .split("\n#")[0]
    )
    links = re.findall(
        r"\[(suave/\S+)\]\((\w+\.html)\): search_time_s (\S+), the (lowest|highest) of", text
    )
    assert len(links) == 4
    for name, target, _, _ in links:
        assert tmp_path / "report" / target in written
        page = (tmp_path / "report" / target).read_text()
        assert f'"seed":{name.rsplit("/")[-1]}' in page
    assert float(links[0][2]) < float(links[1][2])
