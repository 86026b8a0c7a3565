"""When conditions and effects of a PDDL action hold: what a durative action says, and a plain one must not."""

from rosa_pddl.reading.sections import start_of
from rosa_pddl.reading.syntax import Node, Source

__all__ = ["check_times", "is_timed"]

_TIMES = (("at", "start"), ("at", "end"), ("over", "all"))


def is_timed(node: Node) -> bool:
    """Whether a formula says when it holds, such as `(at start (lit hall))`."""
    if len(node.children) != 3 or not node.children[2].is_list:
        return False
    return _time(node) in _TIMES


def check_times(source: Source, schema: Node, part: Node, *, is_effect: bool) -> None:
    """Assure that conditions or effects say when they hold if, and only if, the action takes time.

    Args:
        source: the file.
        schema: the section of the action.
        part: what it needs, or what it does.
        is_effect: which of both.

    Raises:
        PddlError: one does not.
        UnsupportedPddlError: an effect at one time depends on a condition at another.
    """
    if schema.head == ":action":
        _refuse_times(source, schema, part)
    else:
        _expect_times(source, schema, part, is_effect=is_effect)


def _refuse_times(source: Source, schema: Node, node: Node) -> None:
    if is_timed(node):
        message = f"found {start_of(node)!r} in (:action {schema.children[1]}, which takes no time; "
        raise source.error(node, f"{message}leave out '{' '.join(_time(node))}', or write (:durative-action")
    for child in node.children:
        _refuse_times(source, schema, child)


def _expect_times(source: Source, schema: Node, node: Node, *, is_effect: bool) -> None:
    if is_timed(node) and not (is_effect and _time(node) == _TIMES[-1]):
        return
    if not node.is_list or not node.children:
        return
    if node.head == "and":
        inner = node.children[1:]
    elif node.head == "forall" and len(node.children) == 3:
        inner = node.children[2:]
    elif is_effect and node.head == "when" and len(node.children) == 3:
        _expect_one_time(source, node)
        return
    else:
        times = _TIMES[:-1] if is_effect else _TIMES
        expected = " or ".join(f"'({' '.join(time)} ...)'" for time in times)
        message = f"found {start_of(node)!r} in (:durative-action {schema.children[1]}, expected {expected} around it"
        raise source.error(node, message)
    for child in inner:
        _expect_times(source, schema, child, is_effect=is_effect)


def _expect_one_time(source: Source, when: Node) -> None:
    condition, effect = when.children[1:]
    if not (is_timed(condition) and is_timed(effect) and _time(condition) == _time(effect)):
        message = f"found {start_of(when)!r}: an effect at one time that depends on another is not supported by any "
        message += "engine of unified-planning. Write (when (at end ...) (at end ...)), or two actions"
        raise source.unsupported(when, message)


def _time(node: Node) -> tuple[str, str]:
    return node.head, node.children[1].lower
