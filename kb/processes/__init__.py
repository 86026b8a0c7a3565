"""Components as processes of the operating system; a guardian ends what is left over of them."""

from kb.processes.components import ProcessComponents, Program

__all__ = ["ProcessComponents", "Program"]
