"""The tutorial is its examples: every line of theirs, in order, and everything that they print."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text()
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]_*.py"))
SECTIONS = re.split(r"^## (?=\d\. )", TUTORIAL, flags=re.MULTILINE)[1:]


def lines(text):
    return [line for line in text.splitlines() if line.strip()]


def shown(section, language):
    return lines("\n".join(re.findall(rf"^```{language}\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)))


def test_there_is_a_section_for_each_numbered_example():
    assert len(SECTIONS) == len(EXAMPLES) == 6
    for number, (section, example) in enumerate(zip(SECTIONS, EXAMPLES, strict=True), start=1):
        assert section.startswith(f"{number}. ")
        assert example.name.startswith(f"{number}_")


@pytest.mark.parametrize("number", range(6))
def test_section_shows_the_whole_example_and_what_it_prints(number):
    source, printed = EXAMPLES[number].read_text(), EXAMPLES[number].with_suffix(".txt").read_text()
    first, *rest = lines(source)
    assert first.startswith('"""')
    assert first.endswith('"""')
    assert shown(SECTIONS[number], "python") == rest
    assert shown(SECTIONS[number], "text") == lines(printed)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_numbered_example_fits_on_a_page(path):
    assert len(path.read_text().splitlines()) < 60


def test_every_example_has_a_robot_of_its_own():
    names = [name for path in EXAMPLES for name in re.findall(r'Model\("(\w+)"\)', path.read_text())]
    assert len(set(names)) == len(EXAMPLES)
