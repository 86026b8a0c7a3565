"""`rosa store`: what is in a store, and a copy of it."""

from typer.testing import CliRunner

from kb import KnowledgeBase, Model
from missions.commands import store as app


def test_store_command_copies_a_store_and_shows_it(tmp_path):
    model = Model("meter")
    model.quality_attribute("level")
    kb = KnowledgeBase(model, clock=lambda: 3.0, store=tmp_path / "log")
    kb.measure("level", 1.0)
    kb.close()
    copied = CliRunner().invoke(app, ["backup", str(tmp_path / "log"), str(tmp_path / "copy")])
    assert copied.exit_code == 0, copied.output
    shown = CliRunner().invoke(app, ["info", str(tmp_path / "copy")])
    lines = shown.output.splitlines()
    assert {"model: meter", "state: closed", "last event: 1"} <= set(lines)


def test_store_command_says_why_a_file_is_no_store(tmp_path):
    (tmp_path / "text").write_text("no database" * 100)
    shown = CliRunner().invoke(app, ["info", str(tmp_path / "text")])
    assert shown.exit_code != 0
    assert "damaged" in str(shown.exception)
    assert (tmp_path / "text").read_text() == "no database" * 100
