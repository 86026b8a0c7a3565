"""Operating-system processes as components: `programs` says what to run, `components` runs it, `guardian` tidies up."""

from kb.processes.components import ProcessComponents
from kb.processes.programs import Program

__all__ = ["ProcessComponents", "Program"]
