"""Parsers of other packages in a child process, bounded in time and memory.

pyulog can loop for ever on a damaged log, polars ends the process where a damaged Parquet file claims more
memory than there is, and both print. In a child none of that reaches the caller: it answers, or it is ended.
One child serves all files of a process, so that it is started once; it leaves when its parent does.
"""

import atexit
import functools
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, ParamSpec, TypeVar, cast

from imucal.errors import ReadError
from imucal.resources import memory_limit

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

#: Seconds that a file may take: some, and more for each megabyte. Usual ones take 0.02 s for each.
PATIENCE, PATIENCE_PER_MB = 20.0, 2.0

#: Bytes that a child may take beyond the file's, twice, and what samples may: for the packages themselves.
_OVERHEAD = 4 << 30

_LENGTH = struct.Struct("<Q")
_START = "import sys; sys.path[:] = {path!r}; from imucal.readers.isolation import serve; serve()"


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
        question = pickle.dumps((memory_limit() + _OVERHEAD + 2 * size, function, args, kwargs))
        done, answer = _child(os.getpid()).ask(question, seconds)
        if not done:
            msg = f"{path}: not a readable {kind} file: {answer}"
            raise ReadError(msg)
        return cast("Result", answer)

    return call


@functools.cache
def _child(parent: int) -> "_Child":
    """Return the child of a process; a forked process gets one of its own."""
    del parent
    child = _Child()
    atexit.register(child.end)
    return child


class _Child:
    """A process that answers one question at a time; started at the first one, and anew where it ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def ask(self, question: bytes, seconds: float) -> tuple[bool, object]:
        """Return whether it was answered, and the answer, or why there is none."""
        with self._lock:
            process = self._started()
            late = threading.Event()

            def end() -> None:
                late.set()
                process.kill()

            timer = threading.Timer(seconds, end)
            timer.start()
            try:
                _send(cast("BinaryIO", process.stdin), question)
                answer = _receive(cast("BinaryIO", process.stdout))
            except OSError:
                answer = None
            except BaseException:
                # Interrupted: what the child answers now nobody waits for.
                self.end()
                raise
            finally:
                timer.cancel()
            if answer is not None:
                done, result = pickle.loads(answer)  # noqa: S301 - from this package's own process
                return bool(done), result
            self.end()
            if late.is_set():
                return False, f"reading it takes more than {seconds:.0f} s, so it is damaged"
            return False, "reading it ends the process or takes too much memory"

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.end()
            start = _START.format(path=sys.path)
            try:
                self._process = subprocess.Popen(  # noqa: S603 - this very interpreter
                    [sys.executable, "-c", start],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                )
            except OSError as error:
                msg = f"{sys.executable}: can't be started to read this format: {error.strerror or error}"
                raise ReadError(msg) from error
        return self._process

    def end(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            self._process.kill()
            # Closes the pipes and takes the exit code.
            self._process.communicate()
            self._process = None


def serve() -> None:
    """Answer questions on standard input until it ends: the child's side."""
    # An interrupt is the parent's to handle: it ends the child.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What the packages print is nobody's.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    while (question := _receive(sys.stdin.buffer)) is not None:
        try:
            memory, function, args, kwargs = pickle.loads(question)  # noqa: S301 - from this package's own process
            _limit_memory(memory)
            answer = pickle.dumps((True, function(*args, **kwargs)), protocol=5)
        except BaseException as error:  # noqa: BLE001 - panics of Rust are no Exceptions
            text = " ".join(str(error).split())[:300]
            answer = pickle.dumps((False, f"{type(error).__name__}: {text}"))
        _send(answers, answer)


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.RLIM_INFINITY))


def _send(stream: BinaryIO, data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _receive(stream: BinaryIO) -> bytes | None:
    """Return the next message; None where the stream has ended."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (size,) = _LENGTH.unpack(head)
    data = stream.read(size)
    return data if len(data) == size else None
