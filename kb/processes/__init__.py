"""Components as processes of the operating system: `components` manages them, each a `process`; `guardian` tidies up."""

from kb.processes.components import ProcessComponents
from kb.processes.process import Program

__all__ = ["ProcessComponents", "Program"]
