"""Judging models for the command line: from files or of a mission, with the trees and domains that use them."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from kb import Model
from kb.judge.findings import RULES, Finding, Severity
from missions.engine.mission import Mission, MissionError
from missions.names import Names, names_in_pddl, names_in_tree, tree_builder
from missions.planning.declared import planned_names

__all__ = ["Judgement", "inconsistencies", "judge", "print_judgement"]

COLOURS = {Severity.ERROR: "red", Severity.WARNING: "yellow"}


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was found about a model.

    Attributes:
        model: what the model is called.
        findings: the errors first.
    """

    model: str
    findings: tuple[Finding, ...]

    def of(self, severity: Severity) -> list[Finding]:
        """Return the findings that are as bad as that."""
        return [one for one in self.findings if one.severity is severity]

    def as_json(self) -> str:
        """Return it as JSON text."""
        counts = {f"{severity}s": len(self.of(severity)) for severity in Severity}
        return json.dumps({"model": self.model, **counts, "findings": [asdict(one) for one in self.findings]}, indent=2)


def judge(files: Sequence[Path], mission: Mission | None, trees: Iterable[str], pddl: Sequence[Path]) -> Judgement:
    """Judge a model.

    Args:
        files: what the model is read from, in order; without any it is the mission's.
        mission: whose tree and PDDL files use the model.
        trees: further trees that use it, each as module:callable.
        pddl: further PDDL files that use it.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: something cannot be read or built; the message says where.
    """
    model = _model(files, mission)
    used = [names_in_tree(tree_builder(tree), model, f"tree {tree}") for tree in trees]
    if pddl:
        used.append(names_in_pddl(pddl))
    if mission is not None:
        used.append(names_in_tree(mission.tree, model, f"the tree of {mission.name}"))
        planned = planned_names(mission)
        used += [] if planned is None else [planned]
    if not used:
        return Judgement(model.name, model.check())
    names = used[0]
    for more in used[1:]:
        names |= more
    return Judgement(model.name, tuple(_placed(model.check(names.places), names)))


def inconsistencies(files: Sequence[Path], mission: Mission | None) -> list[str]:
    """Have a reasoner of OWL judge a model: OWL files as they stand, anything else as the ontology that it makes.

    Returns:
        What is wrong, each with the file or model that it is in.

    Raises:
        KnowledgeBaseError: there is no Java for the reasoner; the message says so.
    """
    from kb.files import read_text
    from kb.owl import inconsistency
    from kb.rdfxml import owl_text

    model = _model(files, mission)
    texts = {str(file): read_text(file) for file in files if file.suffix.lower() == ".owl"}
    found = {where: inconsistency(text) for where, text in (texts or {model.name: owl_text(model)}).items()}
    return [f"{where}: {what}" for where, what in found.items() if what]


def _model(files: Sequence[Path], mission: Mission | None) -> Model:
    if files:
        return Model.load(files)
    if mission is None:
        raise MissionError("nothing to check; name the files of a model, or a mission with --mission NAME")
    return mission.model()


def _placed(findings: Iterable[Finding], names: Names) -> Iterable[Finding]:
    """Yield the findings about names with their places; what a tree may be given later is no finding."""
    for one in findings:
        if one.code == "unknown-action":
            first, *others = names.places[one.element]
            more = f" and {len(others)} more" if others else ""
            yield replace(one, place=f"{first}{more}")
        elif one.code != "unmentioned-action" or names.complete:
            yield one


def print_judgement(console: Console, judgement: Judgement) -> None:
    """Print the findings by severity and code, with what to do about each code."""
    for severity in Severity:
        findings = sorted(judgement.of(severity), key=lambda one: list(RULES).index(one.code))
        for code, group in groupby(findings, key=lambda one: one.code):
            console.print(f"[bold {COLOURS[severity]}]{severity}[/] {code}", highlight=False)
            for one in group:
                console.print(f"  {escape(one.where_and_what)}", highlight=False, soft_wrap=True)
            console.print(f"  -> {escape(RULES[code].advice)}", highlight=False, soft_wrap=True)
    told = [_counted(len(judgement.of(severity)), severity) for severity in Severity if judgement.of(severity)]
    console.print(f"model {escape(judgement.model)}: {' and '.join(told) or 'nothing found'}", highlight=False)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number > 1 else ''}"
