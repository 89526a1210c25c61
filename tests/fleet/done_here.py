"""Work on logs of a fleet in this process, because a child takes longer to import modules than for a log."""

import contextlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from unittest import mock

from imucal.child_process import Answer, ChildProcess
from imucal.fleet import engines

__all__ = ["logs_done_here"]

_ONE_AT_A_TIME = threading.Lock()


class DoneHere(ChildProcess):
    """Answers like a child process, in its environment and folder, but without limits of time and memory.

    Questions and answers are pickled, as for a child process.
    """

    def ask(self, function: Callable[..., object], *args: object, seconds: float, memory: int) -> Answer:
        """Call the function."""
        del seconds, memory
        self._refuse_closed()
        there, here = {k: v for k, v in self._environment.items() if v is not None}, os.environ
        with _ONE_AT_A_TIME, mock.patch.dict(here, there), contextlib.chdir(self._folder or "."):
            for name in self._environment.keys() - there.keys():
                here.pop(name, None)
            try:
                asked, given = pickle.loads(pickle.dumps((function, args)))  # noqa: S301 - our own
                answer = Answer(outcome="done", value=asked(*given))
            except Exception as error:  # noqa: BLE001 - a child reports every exception
                answer = Answer(outcome="failed", words=f"{type(error).__name__}: {error}")
        back: Answer = pickle.loads(pickle.dumps(answer, protocol=5))  # noqa: S301 - our own
        return back


@contextlib.contextmanager
def logs_done_here() -> Iterator[None]:
    """Do the work on logs of fleets in this process."""
    with mock.patch.object(engines, "ChildProcess", DoneHere):
        yield
