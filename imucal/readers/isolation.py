"""Parsers of other packages in a child process, bounded in time and memory.

pyulog can loop for ever on a damaged log, polars ends the process where a damaged Parquet file claims more
memory than there is, and both print. In a child none of that reaches the caller: it answers, or it is ended.
One child serves all files of a process, so that it is started once.
"""

import atexit
import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

from imucal.errors import ReadError
from imucal.processes import ChildProcess
from imucal.resources import memory_limit

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

#: Seconds that a file may take: some, and more for each megabyte. Usual ones take 0.02 s for each.
PATIENCE, PATIENCE_PER_MB = 20.0, 2.0

#: Bytes that a child may take beyond the file's, twice, and what samples may: for the packages themselves.
_OVERHEAD = 4 << 30


def isolated(path: Path, function: Callable[Parameters, Result], kind: str) -> Callable[Parameters, Result]:
    """Return a function of a module that runs in the child process, to read the file `path` of some `kind`.

    Raises
    ------
    ReadError
        When it is called: if the function raises anything, takes too long, or ends the child.
    """

    @functools.wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        size = path.stat().st_size
        seconds = PATIENCE + PATIENCE_PER_MB * size / 1e6
        question = functools.partial(function, *args, **kwargs)
        try:
            answer = _child(os.getpid()).ask(
                question, seconds=seconds, memory=memory_limit() + _OVERHEAD + 2 * size
            )
        except OSError as error:
            msg = f"{sys.executable}: can't be started to read this format: {error.strerror or error}"
            raise ReadError(msg) from error
        if answer.outcome == "done":
            return cast("Result", answer.value)
        why = {
            "failed": answer.words,
            "late": f"reading it takes more than {seconds:.0f} s, so it is damaged",
            "ended": "reading it ends the process or takes too much memory",
        }
        msg = f"{path}: not a readable {kind} file: {why[answer.outcome]}"
        raise ReadError(msg)

    return call


@functools.cache
def _child(parent: int) -> ChildProcess:
    """Return the child of a process; a forked process gets one of its own."""
    del parent
    child = ChildProcess()
    atexit.register(child.end)
    return child
