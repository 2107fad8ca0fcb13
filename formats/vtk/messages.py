"""What VTK has to say while it reads or writes: caught, instead of printed to stderr while it goes on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow

# "ERROR: In file, line n", then "vtkClass (0x...): message".
_ERROR = re.compile(r"ERROR: In [^\n]*\n(?:\w+ \((?:0x)?\w+\): )?(.*?)(?:\n\n|\Z)", re.DOTALL)


@contextmanager
def vtk_errors() -> Iterator[list[str]]:
    """Yield a list that holds, after the block, the errors VTK reported inside it."""
    errors: list[str] = []
    window, verbosity = vtkOutputWindow.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    messages = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(messages)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield errors
    finally:
        vtkOutputWindow.SetInstance(window)
        vtkLogger.SetStderrVerbosity(verbosity)
    errors.extend(" ".join(text.split()) for text in _ERROR.findall(messages.GetOutput()))
