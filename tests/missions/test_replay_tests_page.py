"""The page on replay tests is a test file that passes."""

import re
from pathlib import Path

from _pytest.fixtures import FixtureFunctionDefinition
from test_pytest_plugin import BATTERY_DROP, PLUGINS

pytest_plugins = "pytester"

PAGE = (Path(__file__).parents[2] / "docs" / "replay_tests.md").read_text()


def blocks(language):
    found = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert found
    return found


def test_page_is_a_test_file_that_passes(pytester):
    pytester.path.joinpath("battery_drop.jsonl").write_bytes(BATTERY_DROP.read_bytes())
    pytester.path.joinpath("test_of_the_page.py").write_text("\n".join(blocks("python")))
    written = pytester.runpytest_inprocess(*PLUGINS, "--update-traces")
    count = len(re.findall(r"^def test_", "\n".join(blocks("python")), re.MULTILINE))
    written.assert_outcomes(passed=count)
    pytester.runpytest_inprocess(*PLUGINS).assert_outcomes(passed=count)


def test_page_explains_everything_that_the_plugin_offers():
    from missions.testing import Decisions, ScriptedManaged, plugin

    fixtures = [
        name for name, one in vars(plugin).items() if isinstance(one, FixtureFunctionDefinition)
    ]
    assertions = [name for name in vars(Decisions) if name.startswith("assert_")]
    scripted = ScriptedManaged.script.__kwdefaults__
    assert len(fixtures) == 4
    assert len(assertions) == 6
    assert len(scripted) == 5
    for name in [*fixtures, *assertions]:
        assert name in PAGE, name
    for name in scripted:
        assert f"`{name}=" in PAGE, name
