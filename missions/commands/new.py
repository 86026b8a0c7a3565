"""`rosa new`: write a package for your own robot, which runs and passes its tests at once."""

import keyword
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

from typer import Argument, Option, echo

from missions.engine.mission import MissionError
from missions.views.output import files_tried

TEMPLATE: Final = Path(__file__).parents[1] / "template"
"""Holds what is written, under its place but for a `.txt` that hides it from tools."""


def new(
    name: Annotated[str, Argument(help="Of the robot: a folder and a Python package.")],
    task: Annotated[
        str, Option(help="How it decides what to do: bt (a behaviour tree), pddl, or both.")
    ] = "bt",
    ros2: Annotated[
        bool,
        Option("--ros2", help="As a colcon package, with a bridge.toml for a robot in ROS 2."),
    ] = False,
) -> None:
    """Write a package with model, task logic, world and tests; CHANGE marks what is yours."""
    if task not in ("bt", "pddl", "both"):
        raise MissionError(f"--task is {task!r}; there are bt, pddl and both")
    if not name.isidentifier() or name != name.lower() or keyword.iskeyword(name):
        raise MissionError(
            f"a robot's name is that of a Python package, such as my_robot; {name!r} cannot be one"
        )
    folder = Path(name)
    if folder.exists() or find_spec(name) is not None:
        raise MissionError(f"there is something named {name} already; give the robot another name")
    parts = ({"bt", "pddl"} if task == "both" else {task}) | ({"ros2"} if ros2 else set())
    with files_tried(f"write {folder}"):
        for template in sorted(TEMPLATE.rglob("*.*")):
            text = filled(template.read_text(encoding="utf-8"), name, parts)
            if text:
                place = template.relative_to(TEMPLATE).as_posix().removesuffix(".txt")
                file = folder / place.replace("my_robot", name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
    echo(f"{folder}/README.md says what is where; it runs and is tested by\n  cd {name}")
    echo(f"  rosa run {name}:MISSION\n  pytest")


def filled(text: str, name: str, parts: set[str]) -> str:
    """Put the name into a template, and drop each block `#if PART` ... `#fi` of other parts."""
    lines = []
    kept = [True]
    for line in text.splitlines(keepends=True):
        if line.startswith("#if "):
            *negated, part = line.split()[1:]
            kept.append(kept[-1] and (part in parts) is not bool(negated))
        elif line == "#fi\n":
            kept.pop()
        elif kept[-1]:
            lines.append(line)
    return "".join(lines).replace("my_robot", name)
