"""Components as processes of the operating system.

`components` manages them, each of which runs as a `process`; the `guardian` ends what is left over.
"""

from kb.processes.components import ProcessComponents
from kb.processes.process import Program

__all__ = ["ProcessComponents", "Program"]
